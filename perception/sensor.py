"""What a levelled scanner can see from where it stands: height, field of view, range."""

from dataclasses import dataclass

import numpy as np

from perception.scan import BeamPattern


@dataclass(frozen=True)
class Sensor:
    """A scanner above the floor, level.

    Args:
        height: of the optical centre above the floor, metres.
        elevation_min, elevation_max: field of view, radians.
        range_min, range_max: metres.
    """

    height: float
    elevation_min: float
    elevation_max: float
    range_min: float
    range_max: float

    @classmethod
    def of(cls, pattern: BeamPattern, height: float) -> "Sensor":
        """The sensor that fires ``pattern`` from ``height`` metres above the floor."""
        return cls(height, pattern.elevation_min, pattern.elevation_max, pattern.range_min, pattern.range_max)

    def blind_radius(self, height: float) -> float:
        """Radius in metres of the disc around the sensor that it cannot see at ``height`` metres above the floor."""
        if self.elevation_min >= 0:
            return float("inf") if height < self.height else 0.0
        return max(0.0, (self.height - height) / float(np.tan(-self.elevation_min)))
