"""Wheel encoders that lie a little, always in the same direction, and now and then slip."""

import numpy as np

from drivers.simulated.profile import OdometryProfile
from perception import transforms
from perception.transforms import Matrix


class Odometry:
    """Integrates true motion with the errors of :class:`OdometryProfile`; drifts, never jumps. Seeded."""

    def __init__(self, profile: OdometryProfile, seed: int) -> None:
        self._profile = profile
        self._rng = np.random.default_rng((seed, 1))
        self._distance_factor = 1.0 + profile.distance_scale * float(self._rng.uniform(-1, 1))
        self._rotation_factor = 1.0 + profile.rotation_scale * float(self._rng.uniform(-1, 1))
        self._x = self._y = self._yaw = 0.0

    @property
    def pose(self) -> tuple[float, float, float]:
        """(x, y, yaw) in the odom frame."""
        return self._x, self._y, self._yaw

    @property
    def odom_from_base(self) -> Matrix:
        return transforms.planar(*self.pose)

    def moved(self, distance: float, rotation: float) -> None:
        """Add a small true motion: metres along the heading (negative backwards) and radians."""
        distance_seen = distance * self._distance_factor
        rotation_seen = rotation * self._rotation_factor
        length = abs(distance)
        if length > 0.0:
            rotation_seen += self._profile.heading_walk * float(np.sqrt(length) * self._rng.standard_normal())
            if self._rng.random() < self._profile.slips_per_metre * length:
                distance_seen += float(np.sign(distance) * self._rng.uniform(0.0, self._profile.slip_distance))
                rotation_seen += float(self._rng.uniform(-1.0, 1.0)) * self._profile.slip_heading
        middle = self._yaw + rotation_seen / 2
        self._x += distance_seen * float(np.cos(middle))
        self._y += distance_seen * float(np.sin(middle))
        self._yaw = float(np.arctan2(np.sin(self._yaw + rotation_seen), np.cos(self._yaw + rotation_seen)))
