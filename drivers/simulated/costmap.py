"""What the base plans on: the robot map it was given and what its planar scanner sees in the way now."""

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from drivers.simulated.footprint import covers_any
from drivers.simulated.lidar import Sweep
from perception.grids import Cell, Grid

_EXPLAINED = 0.12
_MEMORY_RANGE = 6.0
_SOFT_HEIGHT, _SOFT_FROM, _SOFT_WIDTH = 3.0, 0.35, 0.15
_UNKNOWN_COST = 3.0


@dataclass(frozen=True)
class Costs:
    """What a search needs: metres to the nearest obstacle cell and the price of a metre, each ``(rows, columns)``."""

    clearance: NDArray[np.float32]
    obstacle: NDArray[np.bool_]
    price: NDArray[np.float32]


class CostMap:
    """The robot map and, over it, obstacles that only the base has seen; forgotten where its plane sees through."""

    def __init__(self, robot_map: Grid, footprint: tuple[float, float]) -> None:
        self.grid = robot_map
        self._half = footprint[0] / 2, footprint[1] / 2
        self._fixed = robot_map.data == Cell.OBSTACLE
        self._unknown = robot_map.data == Cell.UNKNOWN
        self._explained = _clearance(self._fixed, robot_map.resolution) < _EXPLAINED
        self._seen = np.zeros(robot_map.shape, np.bool_)
        self._overhang = np.zeros(robot_map.shape, np.bool_)

    def observe(self, pose: tuple[float, float, float], sweep: Sweep) -> None:
        """Enter what is seen from a pose in the map.

        A hit near an obstacle of the map is that obstacle, a little displaced by the localisation; entering it too
        would make every door narrower by that much.
        """
        origin, resolution = np.asarray(self.grid.origin, float), self.grid.resolution
        place = np.asarray(pose)
        _observe(self._seen, self._explained, sweep.plane, place, origin, resolution, _MEMORY_RANGE, self._half)
        self._remember_overhangs(pose, sweep)

    def _remember_overhangs(self, pose: tuple[float, float, float], sweep: Sweep) -> None:
        """Table tops are kept for good: that the plane sees through below them says nothing, and they do not walk."""
        hanging = sweep.overhang[(np.abs(sweep.overhang) > self._half).any(axis=1)]
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        cells = self.grid.cells_of(hanging @ np.array([[cos, sin], [-sin, cos]]) + pose[:2])
        rows, columns = cells[self.grid.contains(cells)].T
        self._overhang[rows, columns] |= ~self._explained[rows, columns]

    def forget(self) -> None:
        """Drop all obstacles beyond the robot map."""
        self._seen[:] = False
        self._overhang[:] = False

    def is_seen_under(self, pose: tuple[float, float, float]) -> bool:
        """Whether the footprint at a pose would cover an obstacle that the robot map does not have."""
        x, y = pose[0] - self.grid.origin[0], pose[1] - self.grid.origin[1]
        place = x, y, pose[2], *self._half, self.grid.resolution
        return bool(covers_any(self._seen, *place) or covers_any(self._overhang, *place))

    def costs(self, standing_on: NDArray[np.integer]) -> Costs:
        """Costs for a search; the cells ``(N, 2)`` that the robot stands on are free, whatever the map says."""
        obstacle = self._fixed | self._seen | self._overhang
        own = standing_on[self.grid.contains(standing_on)]
        obstacle[own[:, 0], own[:, 1]] = False
        clearance = _clearance(obstacle, self.grid.resolution)
        price = 1.0 + _SOFT_HEIGHT * np.exp(-np.maximum(clearance - _SOFT_FROM, 0.0) / _SOFT_WIDTH)
        return Costs(clearance, obstacle, (price + _UNKNOWN_COST * self._unknown).astype(np.float32))


def _clearance(obstacle: NDArray[np.bool_], resolution: float) -> NDArray[np.float32]:
    # Without any obstacle OpenCV returns a huge constant, which is what is meant.
    distance = cv2.distanceTransform((~obstacle).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return (distance * resolution).astype(np.float32)


@njit(cache=True)
def _observe(
    seen: NDArray[np.bool_],
    explained: NDArray[np.bool_],
    hits: NDArray[np.float64],
    pose: NDArray[np.float64],
    origin: NDArray[np.float64],
    resolution: float,
    reach: float,
    half: tuple[float, float],
) -> None:
    """Clear the cells along each beam up to a cell before its end, then set the ends."""
    rows, columns = seen.shape
    cos, sin = np.cos(pose[2]), np.sin(pose[2])
    x0, y0 = (pose[0] - origin[0]) / resolution, (pose[1] - origin[1]) / resolution
    ends = np.full((len(hits), 2), -1, np.int64)
    for i in range(len(hits)):
        length = np.hypot(hits[i, 0], hits[i, 1])
        dx = (cos * hits[i, 0] - sin * hits[i, 1]) / length
        dy = (sin * hits[i, 0] + cos * hits[i, 1]) / length
        steps = (min(length, reach) - resolution) / resolution
        for k in range(int(steps)):
            c, r = int(np.floor(x0 + dx * k)), int(np.floor(y0 + dy * k))
            if 0 <= r < rows and 0 <= c < columns:
                seen[r, c] = False
        c = int(np.floor(x0 + dx * length / resolution))
        r = int(np.floor(y0 + dy * length / resolution))
        if length >= reach or r < 0 or c < 0 or r >= rows or c >= columns or explained[r, c]:
            continue
        # A hit just beside the robot may fall into a cell that the robot covers; nothing else can be there.
        ex, ey = (c + 0.5 - x0) * resolution, (r + 0.5 - y0) * resolution
        if abs(cos * ex + sin * ey) > half[0] or abs(cos * ey - sin * ex) > half[1]:
            ends[i] = r, c
    for i in range(len(hits)):
        if ends[i, 0] >= 0:
            seen[ends[i, 0], ends[i, 1]] = True
