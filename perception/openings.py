"""Openings in the walls of a room (paper section 2): where beams passed, how wide and high, and what is around.

Whether an opening is a door is judged in :mod:`perception.doors`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perception.findings import Door
from perception.rays.wall_evidence import CELL, Beam, Evidence, Wall
from perception.views import Views

NOMINAL_WIDTH = 0.9
"""Of a door whose other jamb nobody saw, metres."""
NOMINAL_THICKNESS = 0.15
"""Of a wall whose other face was not seen, metres."""

AROUND, _ASIDE = 8.0, 4.0
"""How far before, behind and beside a hole points are looked at, metres: a mirror shows the whole room."""

_BRIDGE = round(0.35 / CELL)
LOW, _MIDDLE, TOP = round(0.15 / CELL), round(0.9 / CELL), round(1.85 / CELL)


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
class Opening:
    """A hole in a wall, what beams did at its plane and deeper in, and the views around it as (u, d, z)."""

    wall: Wall
    evidence: Evidence
    deeper: Evidence
    left: float
    right: float
    height: float
    around: Views

    @property
    def points(self) -> NDArray[np.floating]:
        return self.around.points

    @property
    def columns(self) -> slice:
        return slice(max(0, round(self.left / CELL)), round(self.right / CELL))

    @property
    def inner_columns(self) -> slice:
        """Without the cells that the jambs cut."""
        return slice(self.columns.start + 3, self.columns.stop - 3)

    def through(self, some: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Of some of the points, all behind the wall: which were seen through the hole."""
        assert self.around.stations is not None and self.around.station_of is not None
        points, stations = self.points[some], self.around.stations[self.around.station_of[some]]
        seen = stations[:, 1] < 0  # not from behind the wall
        points, stations = points[seen], stations[seen]
        share = stations[:, 1] / (stations[:, 1] - points[:, 1])
        u, _, z = (stations + share[:, None] * (points - stations)).T
        seen[seen] = (u > self.left) & (u < self.right) & (z < self.height)
        return seen

    def within(self, low: float, high: float, left: float | None = None, right: float | None = None) -> NDArray:
        """Points of the opening's width (or another) between two heights above the floor."""
        u, z = self.points[:, 0], self.points[:, 2]
        left, right = self.left if left is None else left, self.right if right is None else right
        return self.points[(u > left) & (u < right) & (z > low) & (z < high)]


def columns_of(evidence: Evidence, gates: DoorGates) -> NDArray[np.int8]:
    """Each column of a wall: 1 where beams passed at knee and at head height, 0 where not, -1 where none got there."""
    decided = evidence.decided
    passed = np.ones(len(decided), bool)
    tested = np.zeros(len(decided), bool)
    for band in (slice(LOW, _MIDDLE), slice(_MIDDLE, TOP)):
        reached = np.count_nonzero(decided[:, band] >= 0, axis=1)
        free = np.count_nonzero(decided[:, band] == Beam.OPEN, axis=1)
        known = reached >= 0.15 * (band.stop - band.start)
        passed &= ~known | (free >= gates.open_column * reached)
        tested |= known
    return np.where(tested, np.where(passed, 1, 0), -1).astype(np.int8)


def holes(columns: NDArray[np.int8], gates: DoorGates) -> list[tuple[int, int]]:
    """Runs of open columns (first, past last) that may be as wide as a door."""
    return [run for run in _runs(columns, _BRIDGE) if _wide(run, gates)]


def half_hidden(columns: NDArray[np.int8], evidence: Evidence, gates: DoorGates) -> list[tuple[int, int]]:
    """Where a door may be (first, past last) of which beams only passed a strip beside its opened leaf."""
    found = []
    for first, last in _runs(columns, 0):
        low, high = first, last
        while low > 0 and columns[low - 1] != 0:
            low -= 1
        while high < len(columns) and columns[high] != 0:
            high += 1
        strip = slice(first, last), slice(LOW, round(0.5 / CELL))
        to_floor = last - first >= 2 and evidence.share(strip, Beam.OPEN) > 0.5
        if to_floor and _wide((low, high), gates) and not holes(columns[low:high], gates):
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


def guessed(wall: Wall, evidence: Evidence, part: tuple[int, int]) -> Door:
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


def measured(
    wall: Wall,
    evidence: Evidence,
    deeper: Evidence,
    first: int,
    last: int,
    views: Views,
) -> Opening:
    """The hole with its jambs from the points themselves and its height from the rows."""
    u, d, _ = views.points.T
    around = views.subset((u > first * CELL - _ASIDE) & (u < last * CELL + _ASIDE) & (np.abs(d) < AROUND))
    points = around.points
    on_wall = points[(np.abs(points[:, 1]) < 0.03) & (points[:, 2] > 0.2) & (points[:, 2] < 1.8)]
    left = _jamb(on_wall, first * CELL, -1.0)
    right = _jamb(on_wall, last * CELL, 1.0)
    decided = evidence.decided[first:last]
    reached = np.count_nonzero(decided >= 0, axis=0)
    free = np.count_nonzero(decided == Beam.OPEN, axis=0)
    shut = (reached >= 0.3 * len(decided)) & (free < 0.5 * reached)
    above = np.flatnonzero(shut[_MIDDLE:])
    height = (above[0] + _MIDDLE) * CELL if len(above) else decided.shape[1] * CELL
    return Opening(wall, evidence, deeper, left, right, float(height), around)


def _jamb(on_wall: NDArray[np.floating], edge: float, side: float) -> float:
    """Where the wall ends beside a hole: the median over height of each slab's last point on the wall."""
    u, z = side * (on_wall[:, 0] - edge), on_wall[:, 2]
    close = (u > -0.12) & (u < 0.20)
    slab = (z[close] / 0.1).astype(int)
    ends = [float(u[close][slab == s].min()) for s in np.unique(slab)]
    # A slab whose end lies far out was hidden there: it says nothing about the jamb.
    ends = [e for e in ends if e < min(ends) + 0.06]
    return edge + side * float(np.median(ends)) if ends else edge


def thickness_of(opening: Opening) -> float:
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
