"""Parametric furniture: every piece is a handful of boxes in a frame whose x axis runs along its front."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely
from shapely import affinity

from drivers.simulated.world import Surface
from drivers.simulated.worlds.builder import MeshBuilder

Solid = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Lower and upper corner of a box in the piece's frame; y points to its front, z = 0 is its foot."""
Size = tuple[float, float, float]
"""Length (along the front), depth, height in metres."""

ROBOT_TOP = 1.4
BOARD = 0.03


@dataclass(frozen=True)
class Piece:
    """A piece of furniture that stands (or hangs) somewhere.

    Args:
        kind: name of its shape, one of :data:`SIZES`.
        x, y: centre of the footprint, metres.
        yaw: direction of its x axis, radians; its front looks to the left of that.
        z: height of its foot above the floor, metres.
        size: length, depth and height.
        detail: seed of what varies within one kind.
    """

    kind: str
    x: float
    y: float
    yaw: float
    z: float
    size: Size
    detail: int = 0

    @cached_property
    def footprint(self) -> shapely.Polygon:
        """Its outline from above, with any leaf that stands open in front of it."""
        length, depth, _ = self.size
        front = depth / 2 + (length / 2 if self.kind == "cupboard" else 0.0)
        local = shapely.box(-length / 2, -depth / 2, length / 2, front)
        return affinity.translate(affinity.rotate(local, self.yaw, origin=(0, 0), use_radians=True), self.x, self.y)

    @property
    def hinders(self) -> bool:
        """Whether it is in the way of a robot on the floor."""
        return self.z < ROBOT_TOP and self.kind not in ("curtain", "board")

    def solids(self) -> list[Solid]:
        """The boxes it is made of, in its frame, above its foot."""
        return _SHAPES[self.kind](self.size, np.random.default_rng(self.detail))

    def build(self, mesh: MeshBuilder) -> None:
        """Add its triangles."""
        surface = Surface.CEILING if self.kind == "beam" else Surface.FURNITURE
        for lower, upper in self.solids():
            foot, top = (*lower[:2], lower[2] + self.z), (*upper[:2], upper[2] + self.z)
            mesh.add_box(foot, top, surface, (self.x, self.y, self.yaw))


SIZES: dict[str, Size] = {
    "desk": (1.4, 0.7, 0.74),
    "table": (1.8, 0.9, 0.74),
    "chair": (0.45, 0.45, 0.85),
    "shelf": (1.2, 0.35, 2.0),
    "cabinet": (1.0, 0.45, 1.9),
    "cupboard": (0.9, 0.5, 2.0),
    "box": (0.5, 0.4, 0.4),
    "lamp": (1.3, 0.2, 0.5),
    "beam": (4.0, 0.25, 0.3),
    "column": (0.35, 0.35, 3.0),
    "curtain": (1.2, 0.1, 2.5),
    "board": (2.4, 0.03, 1.2),
    "radiator": (1.4, 0.1, 0.6),
    "bar": (1.0, 0.04, 0.02),
}
"""The usual size of each kind."""


def _box(length: float, depth: float, z0: float, z1: float, x: float = 0.0, y: float = 0.0) -> Solid:
    return (x - length / 2, y - depth / 2, z0), (x + length / 2, y + depth / 2, z1)


def _whole(size: Size, _: np.random.Generator) -> list[Solid]:
    return [_box(size[0], size[1], 0.0, size[2])]


def _legs(size: Size, width: float, top: float) -> list[Solid]:
    x, y = (size[0] - width) / 2, (size[1] - width) / 2
    return [_box(width, width, 0.0, top, sx * x, sy * y) for sx in (-1, 1) for sy in (-1, 1)]


def _desk(size: Size, _: np.random.Generator) -> list[Solid]:
    top = size[2] - BOARD
    panel = _box(size[0] - 0.1, 0.02, 0.25, top, 0.0, -size[1] / 2 + 0.06)
    return [_box(size[0], size[1], top, size[2]), panel, *_legs(size, 0.05, top)]


def _chair(size: Size, _: np.random.Generator) -> list[Solid]:
    seat = 0.45
    back = _box(size[0], 0.03, seat, size[2], 0.0, -size[1] / 2 + 0.015)
    return [_box(size[0], size[1], seat - BOARD, seat), back, *_legs(size, 0.035, seat - BOARD)]


def _case(size: Size) -> list[Solid]:
    """Sides, back, top and bottom of something one can open."""
    length, depth, height = size
    side = (length - BOARD) / 2
    return [
        _box(BOARD, depth, 0.0, height, -side),
        _box(BOARD, depth, 0.0, height, side),
        _box(length, 0.015, 0.0, height, 0.0, -depth / 2 + 0.0075),
        _box(length, depth, 0.06, 0.06 + BOARD),
        _box(length, depth, height - BOARD, height),
    ]


def _shelf(size: Size, rng: np.random.Generator) -> list[Solid]:
    solids = _case(size)
    for z in np.arange(0.09 + 0.35, size[2] - 0.2, 0.35):
        solids.append(_box(size[0], size[1], z, z + BOARD))
        filled = rng.uniform(0.2, 0.9) * (size[0] - 2 * BOARD)
        books = _box(filled, size[1] * 0.7, z + BOARD, z + rng.uniform(0.2, 0.3), (filled - size[0]) / 2 + BOARD)
        solids.append(books)
    return solids


def _cupboard(size: Size, rng: np.random.Generator) -> list[Solid]:
    """An empty case whose two leaves stand open at right angles: a door, to the careless eye."""
    length, depth, height = size
    leaf = length / 2 * rng.uniform(0.9, 1.0)
    leaves = [_box(0.02, leaf, 0.06, height, side * (length / 2 - 0.01), (depth + leaf) / 2) for side in (-1, 1)]
    return [*_case(size), *leaves]


def _lamp(size: Size, _: np.random.Generator) -> list[Solid]:
    """A tube on two rods below the ceiling; its foot is the underside."""
    rods = [_box(0.02, 0.02, 0.08, size[2], side * size[0] * 0.35) for side in (-1, 1)]
    return [_box(size[0], size[1], 0.0, 0.08), *rods]


def _curtain(size: Size, _: np.random.Generator) -> list[Solid]:
    """Folds of cloth: strips that stand alternately nearer to and farther from the wall."""
    folds = max(2, round(size[0] / 0.12))
    width, depth = size[0] / folds, size[1] / 2
    return [
        _box(width, depth, 0.0, size[2], (k + 0.5) * width - size[0] / 2, (k % 2 - 0.5) * depth) for k in range(folds)
    ]


_SHAPES: dict[str, Callable[[Size, np.random.Generator], list[Solid]]] = {
    "desk": _desk,
    "table": lambda size, _: [_box(size[0], size[1], size[2] - BOARD, size[2]), *_legs(size, 0.06, size[2] - BOARD)],
    "chair": _chair,
    "shelf": _shelf,
    "cabinet": _whole,
    "cupboard": _cupboard,
    "box": _whole,
    "lamp": _lamp,
    "beam": _whole,
    "column": _whole,
    "curtain": _curtain,
    "board": _whole,
    "radiator": _whole,
    "bar": _whole,
}
