"""What the base plans on: the robot map it was given and what its planar scanner sees in the way now."""

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from drivers.simulated.footprint import covers_any
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
    """The robot map and, over it, obstacles that only the planar scanner knows; forgotten where it sees through."""

    def __init__(self, robot_map: Grid) -> None:
        self.grid = robot_map
        self._fixed = robot_map.data == Cell.OBSTACLE
        self._unknown = robot_map.data == Cell.UNKNOWN
        self._explained = _clearance(self._fixed, robot_map.resolution) < _EXPLAINED
        self._seen = np.zeros(robot_map.shape, np.bool_)

    def observe(self, pose: tuple[float, float, float], hits: NDArray[np.float64]) -> None:
        """Enter points ``(N, 2)`` in base_link seen from a pose in the map.

        A hit near an obstacle of the map is that obstacle, a little displaced by the localisation; entering it too
        would make every door narrower by that much.
        """
        origin = np.asarray(self.grid.origin, float)
        _observe(self._seen, self._explained, hits, np.asarray(pose), origin, self.grid.resolution, _MEMORY_RANGE)

    def forget(self) -> None:
        """Drop all obstacles beyond the robot map."""
        self._seen[:] = False

    def is_seen_under(self, pose: tuple[float, float, float], half: tuple[float, float]) -> bool:
        """Whether an obstacle beyond the robot map lies under a rectangle (half length, half width) at a pose."""
        x, y = pose[0] - self.grid.origin[0], pose[1] - self.grid.origin[1]
        return bool(covers_any(self._seen, x, y, pose[2], *half, self.grid.resolution))

    def costs(self, standing_on: NDArray[np.integer]) -> Costs:
        """Costs for a search; the cells ``(N, 2)`` that the robot stands on are free, whatever the map says."""
        obstacle = self._fixed | self._seen
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
        if length < reach and 0 <= r < rows and 0 <= c < columns and not explained[r, c]:
            ends[i] = r, c
    for i in range(len(hits)):
        if ends[i, 0] >= 0:
            seen[ends[i, 0], ends[i, 1]] = True
