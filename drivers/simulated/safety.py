"""The last word before the wheels: slows down and stops so that nothing the base sees is ever touched."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from drivers.simulated.lidar import Sweep
from drivers.simulated.profile import BaseProfile

_MARGIN = 0.025
_REACTION = 0.2
# One or two may be noise; so near, even the leg of a chair is met by several beams.
_HITS_THAT_COUNT = 3
# The guard looks less closely, so that what it sees may reach a little further.
_OVERHANG_MARGIN = 0.04
_SCALES = (1.0, 0.6, 0.3, 0.12)


class SafetyMonitor:
    """Judges commands by the footprint's sweep until it could stand still."""

    def __init__(self, profile: BaseProfile) -> None:
        self._profile = profile
        self._half = profile.footprint[0] / 2, profile.footprint[1] / 2

    def space(self, sweep: Sweep) -> float:
        """Metres between the footprint and the nearest thing seen; inf without any."""
        seen = np.concatenate([sweep.plane, sweep.overhang])
        if not len(seen):
            return float("inf")
        over = np.maximum(np.abs(seen) - self._half, 0.0)
        return float(np.hypot(over[:, 0], over[:, 1]).min())

    def limit(self, command: tuple[float, float], sweep: Sweep) -> tuple[float, float]:
        """The command, slowed down as far as it must be; (0, 0) where no speed is safe."""
        speed, turn_rate = command
        plane, overhang = (seen[(np.abs(seen) < 1.5).all(axis=1)] for seen in (sweep.plane, sweep.overhang))
        for scale in _SCALES:
            v, w = speed * scale, turn_rate * scale
            stopping = max(abs(v) / self._profile.acceleration, abs(w) / self._profile.turn_acceleration)
            motion = v, w, _REACTION + stopping / 2, *self._half
            touches = _meets(plane, _HITS_THAT_COUNT, *motion, _MARGIN)
            if not (touches or _meets(overhang, 1, *motion, _OVERHANG_MARGIN)):
                return v, w
        return 0.0, 0.0


@njit(cache=True)
def _meets(
    hits: NDArray[np.float64],
    needed: int,
    v: float,
    w: float,
    duration: float,
    half_length: float,
    half_width: float,
    margin: float,
) -> bool:
    """Whether hits come into the footprint and its margin, or deeper into it, within so many seconds."""
    length, width = half_length + margin, half_width + margin
    threats = 0
    for i in range(len(hits)):
        x0, y0 = hits[i]
        now = min(length - abs(x0), width - abs(y0))
        for k in range(1, 7):
            t = duration * k / 6
            yaw = w * t
            if abs(w) > 1e-4:
                cx, cy = v / w * np.sin(yaw), v / w * (1.0 - np.cos(yaw))
            else:
                cx, cy = v * t, 0.0
            dx, dy = x0 - cx, y0 - cy
            x, y = np.cos(yaw) * dx + np.sin(yaw) * dy, np.cos(yaw) * dy - np.sin(yaw) * dx
            depth = min(length - abs(x), width - abs(y))
            # What is already within the margin must only not come nearer, or the robot could never leave.
            if depth > 0.0 and depth > now + 2e-4:
                threats += 1
                break
        if threats == needed:
            return True
    return False
