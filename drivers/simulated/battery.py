"""The simulated base's battery: it lasts a working day, and a charger stands where the mission starts."""

import math

_LASTS_S = 8 * 3600.0
_CHARGES_S = 3600.0
_DOCK_M = 0.5


class Battery:
    """State of charge, as a share.

    Args:
        charge: at the start.
        dock: (x, y) of the charger, which charges whatever stands still within half a metre of it.
    """

    def __init__(self, charge: float, dock: tuple[float, float]) -> None:
        self.charge = charge
        self._dock = dock

    def step(self, dt: float, at: tuple[float, float], moving: bool) -> None:
        """Pass ``dt`` simulated seconds."""
        docked = not moving and math.dist(at, self._dock) < _DOCK_M
        rate = 1.0 / _CHARGES_S if docked else -1.0 / _LASTS_S
        self.charge = min(1.0, max(0.0, self.charge + rate * dt))
