"""Open doors in the walls of a room (paper section 2) by what the beams did at the planes of the walls.

A door is a hole that reaches the floor, has jambs and goes on: floor at the same height behind it, room to stand, and
a gap that the robot fits through. Windows, niches, cupboards, mirrors and steps each fail a gate that has their name.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from perception import transforms
from perception.building import before, beyond, door_pose
from perception.findings import Door, DoorFindings, RoomShape
from perception.passage import passage
from perception.rays.wall_evidence import CELL, Beam, Evidence, Wall, gather, local_points, walls_of
from perception.scan import Scan
from perception.transforms import Matrix

__all__ = ["DoorGates", "before", "beyond", "door_pose", "find_doors"]

UNVERIFIED = "depth"
"""The last gate: all else speaks for a door, but from where the scans were nobody saw that it leads anywhere."""
HIDDEN = "hidden"
"""Beams passed to the floor in a strip too narrow for a door, but what hides the wall beside it may be its leaf."""
NOMINAL_WIDTH = 0.9
"""Of a door whose other jamb nobody saw, metres."""
NOMINAL_THICKNESS = 0.15
"""Of a wall whose other face was not seen, metres."""

_AROUND, _ASIDE = 8.0, 4.0
"""How far before, behind and beside a hole points are looked at, metres: a mirror shows the whole room."""

_BRIDGE = round(0.35 / CELL)
_LOW, _MIDDLE, _TOP = round(0.15 / CELL), round(0.9 / CELL), round(1.85 / CELL)


@dataclass(frozen=True)
class DoorGates:
    """What makes a hole in a wall a door; lengths in metres, the rest shares."""

    min_width: float = 0.65
    max_width: float = 2.4
    min_height: float = 1.85
    max_height: float = 2.6
    open_column: float = 0.6
    fill: float = 0.7
    jamb: float = 0.5
    lintel: float = 0.5
    floor_step: float = 0.03
    free_depth: float = 0.8
    min_deep_view: float = 0.25
    cupboard: float = 0.75
    leaf_reach: float = 1.3
    min_leaf_cells: int = 20
    mirrored: float = 0.6
    glass: float = 0.4


@dataclass(frozen=True)
class _Opening:
    """A hole in a wall, what beams did at its plane and deeper in, and the points around it as (u, d, z)."""

    wall: Wall
    evidence: Evidence
    deeper: Evidence
    left: float
    right: float
    height: float
    points: NDArray[np.float32]

    @property
    def columns(self) -> slice:
        return slice(max(0, round(self.left / CELL)), round(self.right / CELL))

    @property
    def inner_columns(self) -> slice:
        """Without the cells that the jambs cut."""
        return slice(self.columns.start + 3, self.columns.stop - 3)

    def within(self, low: float, high: float, left: float | None = None, right: float | None = None) -> NDArray:
        """Points of the opening's width (or another) between two heights above the floor."""
        u, z = self.points[:, 0], self.points[:, 2]
        left, right = self.left if left is None else left, self.right if right is None else right
        return self.points[(u > left) & (u < right) & (z > low) & (z < high)]


def find_doors(
    shape: RoomShape,
    scans: Sequence[tuple[Scan, Matrix]],
    robot_width: float = 0.6,
    gates: DoorGates = DoorGates(),
) -> DoorFindings:
    """Find the open doors of a room.

    Args:
        shape: contour, floor, ceiling and walls of the room; the walls may be 10 cm off.
        scans: every scan near the room with its ``map_from_scanner``; evidence adds up over them.
        robot_width: metres that an opened leaf must leave; a narrower door is refused as ``narrow``.

    Returns:
        The doors; the door-like holes that failed, each with the name of the gate; and of those the suspects, which
        a scan from nearby would decide.
    """
    ranges = [scan.range_image() for scan, _ in scans]
    cloud = _surroundings(shape, scans)
    doors: list[Door] = []
    refused: list[tuple[Door, str]] = []
    for wall in walls_of(shape, cloud[:: max(1, len(cloud) // 200_000)]):
        evidence = gather(wall, scans, ranges)
        points: NDArray[np.float32] | None = None
        columns = _columns(evidence, gates)
        refused += [(_guessed(wall, evidence, part), HIDDEN) for part in _half_hidden(columns, evidence, gates)]
        for left, right in _holes(columns, gates):
            if points is None:
                points, deeper = local_points(wall, cloud), gather(wall.moved(gates.free_depth), scans, ranges)
            opening = _measured(wall, evidence, deeper, left, right, points)
            door, gate = _judge(opening, robot_width, gates)
            if gate is None:
                doors.append(door)
            else:
                refused.append((door, gate))
    suspects = tuple(door for door, gate in refused if gate in (UNVERIFIED, HIDDEN))
    return DoorFindings(tuple(doors), tuple(refused), suspects)


def _surroundings(shape: RoomShape, scans: Sequence[tuple[Scan, Matrix]]) -> NDArray[np.float32]:
    """All points between a little below the floor and the ceiling, in and around the room, map frame."""
    low, high = shape.contour.min(axis=0) - _AROUND, shape.contour.max(axis=0) + _AROUND
    clouds = []
    for scan, map_from_scanner in scans:
        points = transforms.apply(map_from_scanner, scan.points)
        inside = np.all((points[:, :2] > low) & (points[:, :2] < high), axis=1)
        clouds.append(points[inside & (points[:, 2] > shape.floor_z - 1.0) & (points[:, 2] < shape.ceiling_z)])
    return np.concatenate(clouds)


def _columns(evidence: Evidence, gates: DoorGates) -> NDArray[np.int8]:
    """Each column of a wall: 1 where beams passed at knee and at head height, 0 where not, -1 where none got there."""
    decided = evidence.decided
    passed = np.ones(len(decided), bool)
    tested = np.zeros(len(decided), bool)
    for band in (slice(_LOW, _MIDDLE), slice(_MIDDLE, _TOP)):
        reached = np.count_nonzero(decided[:, band] >= 0, axis=1)
        free = np.count_nonzero(decided[:, band] == Beam.OPEN, axis=1)
        known = reached >= 0.15 * (band.stop - band.start)
        passed &= ~known | (free >= gates.open_column * reached)
        tested |= known
    return np.where(tested, np.where(passed, 1, 0), -1).astype(np.int8)


def _holes(columns: NDArray[np.int8], gates: DoorGates) -> list[tuple[int, int]]:
    """Runs of open columns (first, past last) that may be as wide as a door."""
    return [run for run in _runs(columns, _BRIDGE) if _wide(run, gates)]


def _half_hidden(columns: NDArray[np.int8], evidence: Evidence, gates: DoorGates) -> list[tuple[int, int]]:
    """Where a door may be (first, past last) of which beams only passed a strip beside its opened leaf."""
    found = []
    for first, last in _runs(columns, 0):
        low, high = first, last
        while low > 0 and columns[low - 1] != 0:
            low -= 1
        while high < len(columns) and columns[high] != 0:
            high += 1
        strip = slice(first, last), slice(_LOW, round(0.5 / CELL))
        to_floor = last - first >= 2 and evidence.share(strip, Beam.OPEN) > 0.5
        if to_floor and _wide((low, high), gates) and not _holes(columns[low:high], gates):
            found.append(_nominal(first, last, low, high))
    return list(dict.fromkeys(found))


def _nominal(first: int, last: int, low: int, high: int) -> tuple[int, int]:
    """A door's usual width around a strip, from its one known jamb on if it has one."""
    width = round(NOMINAL_WIDTH / CELL)
    if high == last:
        return max(low, last - width), last
    if low == first:
        return first, min(high, first + width)
    middle = (first + last) // 2
    return max(low, middle - width // 2), min(high, middle + width // 2)


def _wide(run: tuple[int, int], gates: DoorGates) -> bool:
    return (run[1] - run[0]) * CELL > gates.min_width - 2 * CELL


def _guessed(wall: Wall, evidence: Evidence, part: tuple[int, int]) -> Door:
    """A door that nobody has measured yet."""
    width = (part[1] - part[0]) * CELL
    x, y = (float(value) for value in wall.at((part[0] + part[1]) / 2 * CELL))
    outward = float(wall.outward[0]), float(wall.outward[1])
    return Door(x, y, outward, width, 0.0, evidence.counts.shape[2] * CELL, 0.0, NOMINAL_THICKNESS)


def _runs(state: NDArray[np.int8], bridge: int) -> list[tuple[int, int]]:
    """Runs of 1, joined across at most ``bridge`` unknown (-1) entries."""
    runs: list[tuple[int, int]] = []
    for i in np.flatnonzero(state == 1):
        if runs and i - runs[-1][1] <= bridge and not np.any(state[runs[-1][1] : i] == 0):
            runs[-1] = (runs[-1][0], int(i) + 1)
        else:
            runs.append((int(i), int(i) + 1))
    return runs


def _measured(
    wall: Wall, evidence: Evidence, deeper: Evidence, first: int, last: int, points: NDArray[np.float32]
) -> _Opening:
    """The hole with its jambs from the points themselves and its height from the rows."""
    around = points[(points[:, 0] > first * CELL - _ASIDE) & (points[:, 0] < last * CELL + _ASIDE)]
    around = around[np.abs(around[:, 1]) < _AROUND]
    on_wall = around[(np.abs(around[:, 1]) < 0.03) & (around[:, 2] > 0.2) & (around[:, 2] < 1.8)]
    left = _jamb(on_wall, first * CELL, -1.0)
    right = _jamb(on_wall, last * CELL, 1.0)
    decided = evidence.decided[first:last]
    reached = np.count_nonzero(decided >= 0, axis=0)
    free = np.count_nonzero(decided == Beam.OPEN, axis=0)
    shut = (reached >= 0.3 * len(decided)) & (free < 0.5 * reached)
    above = np.flatnonzero(shut[_MIDDLE:])
    height = (above[0] + _MIDDLE) * CELL if len(above) else decided.shape[1] * CELL
    return _Opening(wall, evidence, deeper, left, right, float(height), around)


def _jamb(on_wall: NDArray[np.float32], edge: float, side: float) -> float:
    """Where the wall ends beside a hole: the median over height of each slab's last point on the wall."""
    u, z = side * (on_wall[:, 0] - edge), on_wall[:, 2]
    close = (u > -0.12) & (u < 0.20)
    slab = (z[close] / 0.1).astype(int)
    ends = [float(u[close][slab == s].min()) for s in np.unique(slab)]
    # A slab whose end lies far out was hidden there: it says nothing about the jamb.
    ends = [e for e in ends if e < min(ends) + 0.06]
    return edge + side * float(np.median(ends)) if ends else edge


def _judge(opening: _Opening, robot_width: float, gates: DoorGates) -> tuple[Door, str | None]:
    """The opening as a door, and the first gate that it fails."""
    wall = opening.wall
    thickness = _thickness(opening)
    way = passage(opening.within(0.08, 1.4)[:, :2], opening.left, opening.right, thickness)
    x, y = wall.at(way.centre)
    rows = slice(_LOW, min(_TOP, round(opening.height / CELL)))
    inner_rows = slice(rows.start + 1, rows.stop - 2)
    fill = opening.evidence.share((opening.columns, rows), Beam.OPEN)
    door = Door(
        x=float(x),
        y=float(y),
        normal=(float(wall.outward[0]), float(wall.outward[1])),
        width=opening.right - opening.left,
        net_width=way.clearance,
        height=opening.height,
        confidence=0.0 if np.isnan(fill) else fill,
        thickness=thickness,
    )
    ground = _ground_behind(opening)
    checks = {
        "width": gates.min_width <= door.width <= gates.max_width,
        "height": _height_fits(opening, gates),
        "sill": _reaches_floor(opening),
        "glass": opening.evidence.echoes((opening.inner_columns, inner_rows)) < gates.glass,
        "fill": door.confidence >= gates.fill,
        "jambs": _jambs_stand(opening, gates),
        "floor": ground is None or abs(ground) <= gates.floor_step,
        "narrow": door.net_width >= robot_width,
        "mirror": not _is_mirror(opening, gates),
        UNVERIFIED: ground is not None and _goes_on(opening, gates),
    }
    return door, next((gate for gate, passed in checks.items() if not passed), None)


def _height_fits(opening: _Opening, gates: DoorGates) -> bool:
    to_ceiling = opening.height > opening.wall.ceiling_z - opening.wall.floor_z - 0.15
    return opening.height >= gates.min_height and (opening.height <= gates.max_height or to_ceiling)


def _reaches_floor(opening: _Opening) -> bool:
    """Beams passed between 15 and 50 cm over the floor wherever they got there, and got there at all."""
    share = opening.evidence.share((opening.columns, slice(_LOW, round(0.5 / CELL))), Beam.OPEN)
    return bool(share > 0.5)


def _jambs_stand(opening: _Opening, gates: DoorGates) -> bool:
    """The wall on both sides of the hole is solid; one side may have gone untested, nearer than the minimum range."""
    solid = [_jamb_solidity(opening, side) for side in (-1, 1)]
    tested = [share for share in solid if not np.isnan(share)]
    return bool(tested and min(tested) >= gates.jamb)


def _jamb_solidity(opening: _Opening, side: int) -> float:
    """Share of the wall beside the hole that threw beams back; 1 in the room's corner, NaN where no beam tested it."""
    columns = opening.columns
    near = slice(columns.start - 4, columns.start - 1) if side < 0 else slice(columns.stop + 1, columns.stop + 4)
    if near.start < 0 or near.stop > opening.evidence.counts.shape[1]:
        return 1.0
    return opening.evidence.share((near, slice(_LOW, None)), Beam.SOLID)


def _ground_behind(opening: _Opening) -> float | None:
    """Height of the ground behind the hole, up to 1.5 m deep, over the floor, metres; None where nobody saw it."""
    low = opening.within(-1.0, 0.25)
    ground = low[(low[:, 1] > 0.10) & (low[:, 1] < 1.5), 2]
    levels, edges = np.histogram(ground, np.arange(-1.0, 0.26, 0.02))
    # The commonest height, because the feet of leaves and walls stand on the floor too but spread over all heights.
    commonest = int(np.argmax(levels))
    return float(edges[commonest]) + 0.01 if levels[commonest] >= 5 else None


def _thickness(opening: _Opening) -> float:
    """Depth of the reveals, where they were seen."""
    depths = []
    for edge in (opening.left, opening.right):
        reveal = opening.within(0.2, 1.8, edge - 0.03, edge + 0.03)[:, 1]
        reveal = np.sort(reveal[(reveal > -0.02) & (reveal < 0.8)])
        if len(reveal) >= 15:
            gaps = np.flatnonzero(np.diff(reveal) > 0.05)
            depths.append(float(reveal[gaps[0]] if len(gaps) else reveal[-1]))
    plausible = [depth for depth in depths if 0.06 <= depth <= 0.45]
    return min(plausible) if plausible else NOMINAL_THICKNESS


def _goes_on(opening: _Opening, gates: DoorGates) -> bool:
    """Something was seen deeper than a cupboard's back: beams that went on, or an opened leaf that reaches there."""
    aside = round(gates.free_depth / CELL)
    columns = slice(max(0, opening.columns.start - aside), opening.columns.stop + aside)
    passed = np.any(opening.deeper.decided[columns, _LOW:_TOP] == Beam.OPEN, axis=1)
    if np.count_nonzero(passed) * CELL >= gates.min_deep_view:
        return True
    deep = opening.within(0.15, 1.85, opening.left, opening.right)
    deep = deep[(deep[:, 1] > gates.cupboard) & (deep[:, 1] < gates.leaf_reach)]
    return len(np.unique(np.floor(deep[:, [0, 2]] / CELL), axis=0)) >= gates.min_leaf_cells


def _is_mirror(opening: _Opening, gates: DoorGates) -> bool:
    """What is seen behind repeats, reflected, what stands before the wall.

    Floor, ceiling and walls that run on through the plane repeat in any case: they also do when the reflection is
    displaced, so only what does not is asked.
    """
    top = opening.wall.ceiling_z - opening.wall.floor_z - 0.15
    points = opening.points[(opening.points[:, 2] > 0.15) & (opening.points[:, 2] < top)]
    behind, front = points[points[:, 1] > 0.3], points[points[:, 1] < -0.1]
    if len(behind) < 50 or len(front) < 50:
        return False
    reflected = behind[:: max(1, len(behind) // 2000)] * np.array([1, -1, 1], np.float32)
    tree = cKDTree(front)

    def repeats(shift: float) -> NDArray[np.bool_]:
        displaced = reflected + np.array([0, shift, 0], np.float32)
        return np.isfinite(tree.query(displaced, distance_upper_bound=0.06, workers=2)[0])

    telling = ~(repeats(0.25) | repeats(-0.25))
    return bool(np.count_nonzero(telling) >= 50 and np.mean(repeats(0.0)[telling]) > gates.mirrored)
