"""Furnishes a room at random, but so that a robot can still come in by every door and move about."""

from dataclasses import dataclass

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray

from drivers.simulated.worlds.free_space import clearance, mask_of
from drivers.simulated.worlds.furniture import SIZES, Piece
from perception.grids import Grid

AISLE = 0.9
SPOT = 0.65
REACH = 1.9
ROWS = (2.2, 1.8)
RESOLUTION = 0.05
ATTEMPTS = 40
WALL_GAP = 0.02
_AT_WALL = ("shelf", "cabinet", "cupboard", "board", "radiator", "curtain")
_HEIGHTS = {"board": 0.9, "radiator": 0.12, "curtain": 0.08}
# What needs a free wall comes before what stands in the middle, and small things come last.
_ORDER = (
    "curtain", "radiator", "column", "cabinet", "shelf", "cupboard", "board", "table", "desk", "chair", "box",
    "bar", "beam", "lamp",
)  # fmt: skip


@dataclass(frozen=True)
class Gap:
    """An opening in the wall of a room.

    Args:
        x, y: its centre on the face of the wall.
        inwards: (nx, ny) unit vector into the room.
        width: metres.
        sill: height of its lower edge, metres; 0 for a door.
        door: whether it is one.
    """

    x: float
    y: float
    inwards: tuple[float, float]
    width: float
    sill: float
    door: bool

    def apron(self, depth: float, extra: float = 0.0) -> shapely.Polygon:
        """The strip of floor in front of it."""
        normal = np.array(self.inwards)
        side = np.array([-normal[1], normal[0]]) * (self.width / 2 + extra)
        centre = np.array([self.x, self.y])
        return shapely.Polygon(
            [centre - side, centre + side, centre + side + normal * depth, centre - side + normal * depth]
        )


class RoomFurnisher:
    """One room under furnishing: proposes pieces and keeps those that leave the robot its way.

    Args:
        outline: floor between the wall faces.
        height: of the ceiling, metres.
        gaps: doors and windows of the room.
        leaves: footprints of the door leaves that stand in it.
        placed: furniture that was placed by hand.
        start: (x, y) of the base if it starts here; it keeps a disc free of ``start_disc`` metres.
    """

    def __init__(
        self,
        outline: shapely.Polygon,
        height: float,
        gaps: list[Gap],
        leaves: list[shapely.Polygon],
        placed: list[Piece],
        start: tuple[float, float] | None,
        start_disc: float = 1.6,
    ) -> None:
        self.pieces: list[Piece] = list(placed)
        self._outline, self._height, self._gaps = outline, height, gaps
        doors = [gap for gap in gaps if gap.door]
        self._keep_clear = shapely.union_all([*leaves, *(gap.apron(1.2, 0.1) for gap in doors)])
        if start is not None:
            self._keep_clear = self._keep_clear.union(shapely.Point(start).buffer(start_disc))
        x0, y0, x1, y1 = outline.bounds
        shape = (int((y1 - y0) / RESOLUTION) + 3, int((x1 - x0) / RESOLUTION) + 3)
        frame = Grid(np.zeros(shape, bool), (x0 - RESOLUTION, y0 - RESOLUTION), RESOLUTION)
        self._floor = frame.with_data(mask_of(np.array(outline.exterior.coords[:-1]), frame))
        solid = [*leaves, *(piece.footprint for piece in placed if piece.hinders)]
        self._blocked = np.logical_or.reduce([~self._floor.data, *(self._cells(shape) for shape in solid)])
        self._entrances = [self._cells(gap.apron(1.2)) for gap in doors]
        if start is not None:
            self._entrances.append(self._cells(shapely.Point(start).buffer(0.3)))
        self._spot = SPOT if self._has_route(self._blocked, SPOT) else 0.0
        self._checked = self._has_route(self._blocked, self._spot)

    def furnish(self, wanted: dict[str, int], rng: np.random.Generator) -> None:
        """Draw pieces of each kind; one that finds no place in a few attempts is left out."""
        for kind in sorted(wanted, key=_ORDER.index):
            for index in range(wanted[kind]):
                for _ in range(ATTEMPTS):
                    piece = self._propose(kind, index, wanted[kind], rng)
                    if piece is not None and self._accept(piece):
                        if kind in ("desk", "table"):
                            self._add_chairs(piece, rng)
                        break

    def _propose(self, kind: str, index: int, count: int, rng: np.random.Generator) -> Piece | None:
        length, depth, height = SIZES[kind]
        detail = int(rng.integers(1 << 31))
        if kind == "curtain":
            return self._curtain(index, detail, rng)
        if kind in _AT_WALL:
            length *= rng.uniform(0.8, 1.2)
            height = min(height * rng.uniform(0.9, 1.1), self._height - 0.1)
            x, y, yaw = self._wall_place(length, depth, rng)
            return Piece(kind, x, y, yaw, _HEIGHTS.get(kind, 0.0), (length, depth, height), detail)
        if kind == "lamp":
            return self._lamp(index, count, detail, rng)
        if kind == "beam":
            return self._beam(detail, rng)
        x, y, yaw = self._row_place(rng) if kind in ("desk", "table") else self._free_place(rng)
        if kind == "bar":
            length, height = rng.uniform(0.6, 1.2), rng.uniform(0.015, 0.03)
        if kind == "column":
            height = self._height
        return Piece(kind, x, y, float(yaw), 0.0, (length, depth, height), detail)

    def _accept(self, piece: Piece) -> bool:
        """Keep a piece if it fits between the others and, standing on the floor, leaves every route."""
        footprint = piece.footprint
        if not self._outline.buffer(-0.005).covers(footprint) or self._collides(piece, footprint):
            return False
        if piece.hinders:
            if footprint.intersects(self._keep_clear):
                return False
            blocked = self._blocked | self._cells(footprint)
            if self._checked and not self._has_route(blocked, self._spot):
                return False
            self._blocked = blocked
        self.pieces.append(piece)
        return True

    def _collides(self, piece: Piece, footprint: shapely.Polygon) -> bool:
        top = piece.z + piece.size[2]
        doorway = not piece.hinders and piece.kind in ("curtain", "board")
        if doorway and any(gap.door and footprint.intersects(gap.apron(0.3)) for gap in self._gaps):
            return True
        # Only curtains and what is lower than the sill may stand before a window.
        windows = [gap for gap in self._gaps if not gap.door and piece.kind != "curtain" and top > gap.sill]
        if any(footprint.intersects(gap.apron(0.3)) for gap in windows if piece.z < 2.0):
            return True
        return any(
            other.z < top and piece.z < other.z + other.size[2] and footprint.intersects(other.footprint)
            for other in self.pieces
        )

    def _has_route(self, blocked: NDArray[np.bool_], spot: float) -> bool:
        """Whether aisles join all entrances and come near every part of the room.

        Somewhere along them there must be a place with ``spot`` metres around it, to turn freely.
        """
        distance = clearance(self._floor.with_data(blocked)).data
        _, labels = cv2.connectedComponents((distance >= AISLE / 2).astype(np.uint8), connectivity=4)
        touched = [set(np.unique(labels[cells])) - {0} for cells in self._entrances]
        joined = set.intersection(*touched) if touched else set(range(1, int(labels.max()) + 1))
        for label in joined:
            aisles = labels == label
            far = clearance(self._floor.with_data(aisles)).data[self._floor.data].max()
            if distance[aisles].max() >= spot and far <= REACH:
                return True
        return False

    def _cells(self, polygon: shapely.Polygon) -> NDArray[np.bool_]:
        """Cells of the room's grid that a footprint touches."""
        grown = polygon.buffer(RESOLUTION, join_style="mitre")
        return mask_of(np.array(grown.exterior.coords[:-1]), self._floor)

    def _edge(self, rng: np.random.Generator) -> tuple[NDArray[np.float64], NDArray[np.float64], float]:
        corners = np.array(self._outline.exterior.coords)
        vectors = np.diff(corners, axis=0)
        lengths = np.linalg.norm(vectors, axis=1)
        k = rng.choice(len(lengths), p=lengths / lengths.sum())
        return corners[k], vectors[k] / lengths[k], float(lengths[k])

    def _wall_place(self, length: float, depth: float, rng: np.random.Generator) -> tuple[float, float, float]:
        """A pose with the back to a wall."""
        start, along, total = self._edge(rng)
        u = rng.uniform(length / 2, max(length / 2, total - length / 2))
        inwards = np.array([-along[1], along[0]])
        x, y = start + along * u + inwards * (depth / 2 + WALL_GAP)
        return float(x), float(y), float(np.arctan2(along[1], along[0]))

    def _row_place(self, rng: np.random.Generator) -> tuple[float, float, float]:
        """A place in the rows of a classroom, not quite straight; now and then at a wall instead."""
        if rng.random() < 0.25:
            return self._wall_place(SIZES["desk"][0], SIZES["desk"][1], rng)
        x0, y0, x1, y1 = self._outline.bounds
        wide = x1 - x0 >= y1 - y0
        pitch = ROWS if wide else ROWS[::-1]
        counts = [max(1, int((extent - 1.0) / step)) for extent, step in zip((x1 - x0, y1 - y0), pitch, strict=True)]
        x, y = (
            low + (high - low) * (rng.integers(count) + 0.5) / count + rng.normal(0, 0.08)
            for low, high, count in zip((x0, y0), (x1, y1), counts, strict=True)
        )
        return float(x), float(y), (0.0 if wide else np.pi / 2) + float(rng.normal(0, 0.05))

    def _free_place(self, rng: np.random.Generator) -> tuple[float, float, float]:
        """Anywhere on the free floor, turned anyhow."""
        rows, columns = np.nonzero(~self._blocked)
        k = rng.integers(len(rows))
        x, y = self._floor.centres_of((rows[k], columns[k]))
        return float(x), float(y), float(rng.uniform(0, 2 * np.pi))

    def _curtain(self, index: int, detail: int, rng: np.random.Generator) -> Piece | None:
        """A curtain before one of the windows, drawn to one side of it or almost shut."""
        windows = [gap for gap in self._gaps if not gap.door]
        if not windows:
            return None
        gap = windows[index % len(windows)]
        normal = np.array(gap.inwards)
        along = np.array([normal[1], -normal[0]])
        length = rng.uniform(0.4, 0.9) * (gap.width + 0.4)
        side = rng.choice([-1, 1]) * (gap.width + 0.4 - length) / 2
        depth = SIZES["curtain"][1]
        x, y = np.array([gap.x, gap.y]) + along * side + normal * (depth / 2 + 0.12)
        foot = _HEIGHTS["curtain"]
        size = (length, depth, min(2.6, self._height - 0.1) - foot)
        return Piece("curtain", float(x), float(y), float(np.arctan2(along[1], along[0])), foot, size, detail)

    def _lamp(self, index: int, count: int, detail: int, rng: np.random.Generator) -> Piece:
        """Lamps hang in rows: the cells of a lattice over the room, filled one after the other."""
        x0, y0, x1, y1 = self._outline.bounds
        columns = max(1, round(np.sqrt(count * (x1 - x0) / (y1 - y0))))
        rows = int(np.ceil(count / columns))
        u, v = (index % columns + 0.5) / columns, (index // columns + 0.5) / rows
        x, y = x0 + u * (x1 - x0) + rng.normal(0, 0.1), y0 + v * (y1 - y0) + rng.normal(0, 0.1)
        yaw = 0.0 if x1 - x0 >= y1 - y0 else np.pi / 2
        drop = SIZES["lamp"][2] * rng.uniform(0.6, 1.2)
        return Piece("lamp", float(x), float(y), yaw, self._height - drop, (*SIZES["lamp"][:2], drop), detail)

    def _beam(self, detail: int, rng: np.random.Generator) -> Piece:
        """A beam from wall to wall, across the shorter way, under the ceiling."""
        x0, y0, x1, y1 = self._outline.bounds
        wide = x1 - x0 >= y1 - y0
        place = rng.uniform(0.25, 0.75)
        x, y = (x0 + place * (x1 - x0), (y0 + y1) / 2) if wide else ((x0 + x1) / 2, y0 + place * (y1 - y0))
        length = (y1 - y0 if wide else x1 - x0) - 0.04
        _, depth, drop = SIZES["beam"]
        return Piece("beam", x, y, np.pi / 2 if wide else 0.0, self._height - drop, (length, depth, drop), detail)

    def _add_chairs(self, desk: Piece, rng: np.random.Generator) -> None:
        """One or two chairs before a desk, most of them pushed back a little."""
        front = np.array([-np.sin(desk.yaw), np.cos(desk.yaw)])
        for _ in range(1 + int(rng.integers(2))):
            aside = rng.uniform(-0.3, 0.3) * desk.size[0]
            along = np.array([np.cos(desk.yaw), np.sin(desk.yaw)]) * aside
            x, y = np.array([desk.x, desk.y]) + front * (desk.size[1] / 2 + rng.uniform(0.28, 0.4)) + along
            yaw = desk.yaw + np.pi + rng.uniform(-0.4, 0.4)
            chair = Piece("chair", float(x), float(y), float(yaw), 0.0, SIZES["chair"], int(rng.integers(1 << 31)))
            self._accept(chair)
