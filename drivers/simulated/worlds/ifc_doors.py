"""Doors of an IFC model: their own solid gives way to leaves that are hinged at the jambs."""

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from drivers.simulated.world import DoorState, DoorTruth, RoomTruth
from drivers.simulated.worlds.builder import MeshBuilder
from drivers.simulated.worlds.doors import ROBOT_DISC, Leaf
from drivers.simulated.worlds.shell import add_leaf

TWO_LEAVES = 1.3
BESIDE = 0.3
_STATES = (DoorState.OPEN, DoorState.HALF, DoorState.SHUT)
_SHARES = (0.75, 0.15, 0.10)
_ANGLES = {DoorState.OPEN: (85.0, 110.0), DoorState.HALF: (40.0, 65.0), DoorState.SHUT: (0.0, 0.0)}
Vector = NDArray[np.float64]


@dataclass(frozen=True)
class DoorHole:
    """An opening in a wall: ``u`` along the wall, ``v`` across it, ``z`` upwards, metres from ``origin`` (x, y)."""

    name: str
    origin: Vector
    along: Vector
    across: Vector
    u: tuple[float, float]
    v: tuple[float, float]
    z: tuple[float, float]

    @property
    def width(self) -> float:
        return self.u[1] - self.u[0]

    def at(self, u: float, v: float) -> Vector:
        return self.origin + self.along * u + self.across * v

    def beside(self, rooms: list[RoomTruth], side: int) -> RoomTruth | None:
        """The room on the side of the smaller (0) or larger (1) ``v``."""
        out = self.v[side] + (BESIDE if side else -BESIDE)
        point = shapely.Point(self.at((self.u[0] + self.u[1]) / 2, out))
        return next((room for room in rooms if shapely.Polygon(room.polygon).contains(point)), None)

    def leaf(self, side: int, jamb: int, width: float, angle: float) -> Leaf:
        """A leaf at the lower (0) or upper (1) jamb that opens to one side; ``angle`` in radians."""
        inwards = self.across if side else -self.across
        towards = -self.along if jamb else self.along
        thickness = self.v[1] - self.v[0]
        return Leaf(self.at(self.u[jamb], self.v[side]), towards, inwards, self.width, thickness, width, angle)


def hang_door(
    mesh: MeshBuilder, hole: DoorHole, rooms: list[RoomTruth], level: float, rng: np.random.Generator
) -> DoorTruth:
    """Draw the leaves of a door, open, half open or shut, and describe it; a door to the outside is shut."""
    sides = (hole.beside(rooms, 0), hole.beside(rooms, 1))
    drawn = _STATES[rng.choice(len(_STATES), p=_SHARES)]
    state = drawn if None not in sides else DoorState.SHUT
    angle = float(np.deg2rad(rng.uniform(*_ANGLES[state])))
    leaves = _best_leaves(hole, sides, angle, rng)
    for leaf in leaves:
        add_leaf(mesh, leaf, hole.z[1] - level, level)
    taken = sum(hole.width - leaf.net_width for leaf in leaves)
    clearance = leaves[0].clearance if len(leaves) == 1 else _between(leaves)
    x, y = hole.at(sum(hole.u) / 2, sum(hole.v) / 2)
    first, second = (side.room_id if side else None for side in sides)
    return DoorTruth(
        hole.name,
        float(x),
        float(y),
        (float(hole.across[0]), float(hole.across[1])),
        hole.width,
        max(0.0, hole.width - taken),
        clearance,
        hole.z[1] - level,
        hole.v[1] - hole.v[0],
        (first, second),
        leaves[0].state,
        clearance >= ROBOT_DISC,
    )


def _best_leaves(
    hole: DoorHole, sides: tuple[RoomTruth | None, RoomTruth | None], angle: float, rng: np.random.Generator
) -> list[Leaf]:
    """The leaf, or the two of a wide door, on the side and at the jamb where it stands least in a wall."""
    if hole.width > TWO_LEAVES:
        choices = [[hole.leaf(side, jamb, hole.width / 2, angle) for jamb in (0, 1)] for side in (0, 1)]
    else:
        choices = [[hole.leaf(side, jamb, hole.width, angle)] for side in (0, 1) for jamb in (0, 1)]
    order = rng.permutation(len(choices))
    room = shapely.union_all([shapely.Polygon(side.polygon) for side in sides if side is not None])
    outside = [sum(leaf.footprint.difference(room).area for leaf in choices[k]) for k in order]
    return choices[order[int(np.argmin(np.round(outside, 3)))]]


def _between(leaves: list[Leaf]) -> float:
    """Diameter of the largest disc that passes between two leaves, metres."""
    if leaves[0].state is DoorState.SHUT:
        return 0.0
    return min(leaves[0].opening, float(leaves[0].footprint.distance(leaves[1].footprint)))
