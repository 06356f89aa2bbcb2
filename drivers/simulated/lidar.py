"""What the base sees by itself: a plane just above the floor, and whatever hangs over it close to the robot."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.simulated.bodies import Body
from drivers.simulated.profile import GuardProfile, LidarProfile
from drivers.simulated.surroundings import Surroundings

Points = NDArray[np.float64]
"""``(N, 2)`` in base_link, metres."""

_BELOW = 0.06
_SECTORS = 240


@dataclass(frozen=True)
class Sweep:
    """One turn of both sensors.

    Args:
        plane: where the planar safety scanner hit something.
        overhang: where the guard saw something above the floor and below the top of the mast, and the plane nothing
            below it: the edge of a table, not a person.
    """

    plane: Points
    overhang: Points


class Lidar:
    """The planar safety scanner and the overhang guard.

    A table's edge is invisible to the plane, and to a terrestrial scanner that stands within its minimum range of it;
    hence the guard, the depth cameras that such bases carry. Panes and mirrors count as seen by both: a safety sensor
    must stop for them.
    """

    def __init__(self, surroundings: Surroundings, plane: LidarProfile, guard: GuardProfile, seed: int) -> None:
        self._surroundings = surroundings
        self._plane, self._guard = plane, guard
        self._rng = np.random.default_rng((seed, 2))
        flat = _fan(plane.beams, np.zeros(1), plane.height)
        down = _fan(guard.columns, np.asarray(guard.slopes), guard.height)
        self._planar = len(flat)
        self._rays = np.concatenate([flat, down])
        self._sigma = np.repeat([plane.noise_sigma, guard.noise_sigma], [len(flat), len(down)])

    def sweep(self, x: float, y: float, yaw: float, bodies: tuple[Body, ...]) -> Sweep:
        """What is seen from a true pose."""
        exact = self._surroundings.distances(_placed(self._rays, x, y, yaw), bodies)
        ranges = exact + self._rng.normal(0.0, self._sigma)
        planar, guarded = self._rays[: self._planar], self._rays[self._planar :]
        near, far = ranges[: self._planar], ranges[self._planar :]
        seen = near < self._plane.range_max
        low, high = self._guard.band
        height = guarded[:, 2] + guarded[:, 5] * far
        hanging = (height > low) & (height < high) & (far < self._guard.range_max)
        standing = planar[seen, 3:5] * near[seen, None]
        above = guarded[hanging, 3:5] * far[hanging, None]
        return Sweep(standing, above[np.linalg.norm(above, axis=1) < _ranges(standing)[_sector(above)] - _BELOW])


def _sector(points: Points) -> NDArray[np.int64]:
    """Direction of each point, in steps of a turn divided by ``_SECTORS``."""
    return np.rint(np.arctan2(points[:, 1], points[:, 0]) / (2 * np.pi) * _SECTORS).astype(np.int64) % _SECTORS


def _ranges(points: Points) -> NDArray[np.float64]:
    """Distance of the nearest point in each sector, inf where there is none."""
    ranges = np.full(_SECTORS, np.inf)
    np.minimum.at(ranges, _sector(points), np.linalg.norm(points, axis=1))
    return ranges


def _fan(columns: int, slopes: NDArray[np.float64], height: float) -> NDArray[np.float32]:
    """Rays in base_link from its vertical axis: all round, once for each slope (rise per metre)."""
    azimuth, slope = (axis.ravel() for axis in np.meshgrid(np.arange(columns) * 2 * np.pi / columns, slopes))
    along = np.stack([np.cos(azimuth), np.sin(azimuth), slope], axis=1)
    direction = along / np.linalg.norm(along, axis=1, keepdims=True)
    origin = np.broadcast_to((0.0, 0.0, height), direction.shape)
    return np.concatenate([origin, direction], axis=1).astype(np.float32)


def _placed(rays: NDArray[np.float32], x: float, y: float, yaw: float) -> NDArray[np.float32]:
    """The rays of base_link in the world."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    placed = rays.copy()
    placed[:, 0], placed[:, 1] = x, y
    placed[:, 3] = cos * rays[:, 3] - sin * rays[:, 4]
    placed[:, 4] = sin * rays[:, 3] + cos * rays[:, 4]
    return placed
