"""The base's planar safety scanner."""

import numpy as np
from numpy.typing import NDArray

from drivers.simulated.bodies import Body
from drivers.simulated.profile import LidarProfile
from drivers.simulated.surroundings import Surroundings


class Lidar:
    """Sweeps the plane just above the floor. Panes and mirrors count as seen: a safety scanner must stop for both."""

    def __init__(self, surroundings: Surroundings, profile: LidarProfile, seed: int) -> None:
        self._surroundings = surroundings
        self._profile = profile
        self._rng = np.random.default_rng((seed, 2))
        angles = np.arange(profile.beams) * (2 * np.pi / profile.beams)
        self._fan = np.stack([np.cos(angles), np.sin(angles)], axis=1)

    def sweep(self, x: float, y: float, yaw: float, bodies: tuple[Body, ...]) -> NDArray[np.float64]:
        """Points ``(N, 2)`` in base_link that returned, from a true pose."""
        cos, sin = np.cos(yaw), np.sin(yaw)
        rays = np.zeros((len(self._fan), 6), np.float32)
        rays[:, :3] = x, y, self._profile.height
        rays[:, 3] = cos * self._fan[:, 0] - sin * self._fan[:, 1]
        rays[:, 4] = sin * self._fan[:, 0] + cos * self._fan[:, 1]
        ranges = self._surroundings.distances(rays, bodies)
        seen = ranges < self._profile.range_max
        noisy = ranges[seen] + self._rng.normal(0.0, self._profile.noise_sigma, int(seen.sum()))
        return self._fan[seen] * noisy[:, None]
