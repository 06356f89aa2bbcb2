"""From a pose to a goal without touching anything that the map has: the footprint is checked at each cell and heading.

A cell of the map that is an obstacle may be one by its very edge, so that a plan leaves more than half a cell on all
sides, and more than the bumper's field (:mod:`drivers.simulated.safety`) would stop for.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.simulated import lattice
from drivers.simulated.costmap import CostMap, Costs
from perception.failure import FailureError
from perception.grids import Grid

Pose = tuple[float, float, float]

_MARGINS = np.array([0.12, 0.08, 0.05, 0.03])
_ESCAPE_RADIUS = 0.35
_HEURISTIC_SLACK = 0.002
_GOAL_SLACK, _DOORWAY_SLACK = 0.08, 0.055
_GOAL_MARGINS = (0.05, 0.03)
_MAX_EXPANSIONS = 600_000


@dataclass(frozen=True)
class Leg:
    """A stretch driven in one go.

    Args:
        points: ``(N, 2)`` map frame, from where it starts to where it ends; a single one for a turn on the spot.
        yaw: heading to start a stretch with, or to end a turn with, radians.
        direction: 1 forwards, -1 backwards, 0 a turn on the spot.
    """

    points: NDArray[np.float64]
    yaw: float
    direction: int


@dataclass(frozen=True)
class Path:
    """Legs to drive, and every pose ``(N, 3)`` (x, y, yaw) on the way."""

    legs: tuple[Leg, ...]
    poses: NDArray[np.float64]

    @property
    def length(self) -> float:
        return float(np.linalg.norm(np.diff(self.poses[:, :2], axis=0), axis=1).sum())


class Planner:
    """SE(2) lattice A* at the resolution of the robot map with 32 headings, turns on the spot and reversing.

    Args:
        footprint: length x width, metres.
    """

    def __init__(self, footprint: tuple[float, float]) -> None:
        self._half = footprint[0] / 2, footprint[1] / 2
        self._angles = lattice.headings()
        self._strides = lattice.strides()

    def plan(self, cost_map: CostMap, start: Pose, goal: tuple[float, float, float | None]) -> Path:
        """The cheapest path; short of space is dear, so that it keeps away from things as far as it can.

        Raises:
            FailureError: ``NAV_NO_PATH``.
        """
        grid = cost_map.grid
        costs = cost_map.costs(self._cells_under(grid, start))
        row, column = (int(i) for i in grid.cells_of(start[:2]))
        reason = "the base stands outside the robot map"
        if grid.contains((row, column)):
            reason = "the goal does not leave room for the footprint"
            target = self._free_cell_near(grid, costs, goal)
            if target is not None:
                reason = "no way is wide enough"
                rows = self._search(grid, costs, (row, column, self._heading(start[2])), target, goal[2])
                if len(rows):
                    return self._path(grid, costs, rows, start, goal)
        message = f"no path from ({start[0]:.2f}, {start[1]:.2f}) to ({goal[0]:.2f}, {goal[1]:.2f}): {reason}"
        raise FailureError("NAV_NO_PATH", message, start=list(start), goal=list(goal[:2]), reason=reason)

    def _search(
        self,
        grid: Grid,
        costs: Costs,
        start: tuple[int, int, int],
        goal: tuple[int, int],
        yaw: float | None,
    ) -> NDArray[np.int64]:
        to_go = lattice.cost_to_go(costs.price, costs.clearance, self._half[1] - _HEURISTIC_SLACK, goal)
        if not np.isfinite(to_go[start[:2]]):
            return np.empty((0, 4), np.int64)
        states = to_go.size * lattice.HEADINGS
        return lattice.search(
            start,
            goal,
            -1 if yaw is None else self._heading(yaw),
            self._angles,
            self._strides,
            self._half,
            _MARGINS,
            _ESCAPE_RADIUS,
            costs.obstacle,
            costs.clearance,
            costs.price,
            to_go,
            grid.resolution,
            np.zeros(states, np.float32),
            np.zeros(states, np.int8),
            np.zeros(states, np.int8),
            _MAX_EXPANSIONS,
        )

    def _heading(self, yaw: float) -> int:
        return int(np.rint(yaw / (2 * np.pi) * lattice.HEADINGS)) % lattice.HEADINGS

    def _cells_under(self, grid: Grid, pose: Pose) -> NDArray[np.int64]:
        """Cells whose centres the footprint covers at a pose."""
        half_length, half_width = self._half
        row, column = grid.cells_of(pose[:2])
        reach = int(np.ceil(np.hypot(half_length, half_width) / grid.resolution)) + 1
        span = np.arange(-reach, reach + 1)
        near = np.stack(np.meshgrid(row + span, column + span, indexing="ij"), -1).reshape(-1, 2)
        dx, dy = (grid.centres_of(near) - pose[:2]).T
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        return near[(np.abs(cos * dx + sin * dy) <= half_length) & (np.abs(cos * dy - sin * dx) <= half_width)]

    def _free_cell_near(
        self, grid: Grid, costs: Costs, goal: tuple[float, float, float | None]
    ) -> tuple[int, int] | None:
        """The goal's cell, or one within a few centimetres of it where the footprint fits better."""
        headings = self._angles if goal[2] is None else np.array([goal[2], self._angles[self._heading(goal[2])]])
        slack = _GOAL_SLACK if goal[2] is None else _DOORWAY_SLACK
        reach = np.arange(-1, 2) * grid.resolution
        around = grid.cells_of(np.stack(np.meshgrid(reach, reach), -1).reshape(-1, 2) + goal[:2])
        off = np.linalg.norm(grid.centres_of(around) - goal[:2], axis=1)
        near = around[np.argsort(off, kind="stable")][: np.count_nonzero(off < slack)]
        for margin in _GOAL_MARGINS:
            half = self._half[0] + margin, self._half[1] + margin
            for row, column in near.tolist():
                fits = [_is_free(grid, costs, (row, column), angle, half) for angle in headings]
                if any(fits) if goal[2] is None else all(fits):
                    return row, column
        return None

    def _path(
        self,
        grid: Grid,
        costs: Costs,
        rows: NDArray[np.int64],
        start: Pose,
        goal: tuple[float, float, float | None],
    ) -> Path:
        poses = np.column_stack([grid.centres_of(rows[:, :2]), self._angles[rows[:, 2]]])
        poses[0] = start
        elsewhere = np.flatnonzero((rows[:, :2] != rows[-1, :2]).any(axis=1))
        arrived = max(elsewhere, default=0) + 1
        if tuple(grid.cells_of(goal[:2])) == tuple(rows[-1, :2]) and self._may_shift(grid, costs, rows[arrived:]):
            poses[arrived:, :2] = goal[:2]
        legs = list(_legs(poses, rows[:, 3]))
        if goal[2] is not None:
            legs.append(Leg(poses[-1:, :2], goal[2], 0))
        return Path(tuple(legs), poses)

    def _may_shift(self, grid: Grid, costs: Costs, rows: NDArray[np.int64]) -> bool:
        """Whether the footprint may stand anywhere in the cells of these states, not only at their centres."""
        margin = _MARGINS[-1] + grid.resolution / np.sqrt(2)
        half = self._half[0] + margin, self._half[1] + margin
        return all(_is_free(grid, costs, (row, column), self._angles[h], half) for row, column, h in rows[:, :3])


def _is_free(grid: Grid, costs: Costs, cell: tuple[int, int], angle: float, half: tuple[float, float]) -> bool:
    """Whether nothing is within a rectangle, given by half its length and width, about the centre of a cell."""
    return lattice.footprint_free(*cell, angle, *half, costs.obstacle, costs.clearance, grid.resolution)


def _legs(poses: NDArray[np.float64], moves: NDArray[np.int64]) -> list[Leg]:
    """Merge the moves of a search into stretches of one direction and turns on the spot."""
    legs: list[Leg] = []
    index = 1
    while index < len(poses):
        direction = _direction(moves[index])
        end = index
        while end + 1 < len(poses) and _direction(moves[end + 1]) == direction:
            end += 1
        if direction:
            legs.append(Leg(poses[index - 1 : end + 1, :2], float(poses[index - 1, 2]), direction))
        else:
            legs.append(Leg(poses[end : end + 1, :2], float(poses[end, 2]), 0))
        index = end + 1
    return legs


def _direction(move: int) -> int:
    if move in (lattice.TURN_LEFT, lattice.TURN_RIGHT):
        return 0
    return -1 if move == lattice.BACKWARD else 1
