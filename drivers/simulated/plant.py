"""The true state of the robot in its world: what really moves, touches and leans. No software of the robot sees it."""

from collections.abc import Sequence

import numpy as np

from drivers.simulated.bodies import Body, Track, standing
from drivers.simulated.obstruction import Obstruction
from drivers.simulated.odometry import Odometry
from drivers.simulated.profile import BaseProfile
from drivers.simulated.stance import Stance
from drivers.simulated.world import World
from perception import transforms

_AT_REST = 0.005
_BRAKE_BELOW = 0.03
_SPIN_LENGTH = 0.5


class WheelLoop:
    """PID speed loop of one wheel over a motor with drag; the set point is slewed within the acceleration limit."""

    _KP, _KI, _KD, _DRAG, _EFFORT_LIMIT = 8.0, 6.0, 0.02, 0.4, 3.0

    def __init__(self, acceleration: float) -> None:
        self.speed = 0.0
        self._acceleration = acceleration
        self._set_point = self._integral = self._last_error = 0.0

    def step(self, target: float, dt: float) -> float:
        """Speed in m/s after ``dt`` seconds of chasing ``target``."""
        slew = self._acceleration * dt
        self._set_point += min(max(target - self._set_point, -slew), slew)
        if target == self._set_point == 0.0 and abs(self.speed) < _BRAKE_BELOW:
            self.halt()  # the holding brake; the controller alone would creep for seconds
            return 0.0
        error = self._set_point - self.speed
        self._integral += error * dt
        effort = self._KP * error + self._KI * self._integral + self._KD * (error - self._last_error) / dt
        self._last_error = error
        self.speed += (min(max(effort, -self._EFFORT_LIMIT), self._EFFORT_LIMIT) - self._DRAG * self.speed) * dt
        return self.speed

    def halt(self) -> None:
        """Brakes on: at rest at once."""
        self.speed = self._set_point = self._integral = self._last_error = 0.0


class Tilt:
    """How the floor leans the robot: smooth over a few metres, never more than ``limit`` radians in roll or pitch."""

    def __init__(self, limit: float, seed: int) -> None:
        rng = np.random.default_rng((seed, 3))
        self._limit = limit
        self._waves = rng.normal(0.0, 1.0, (2, 3, 2))
        self._phases = rng.uniform(0, 2 * np.pi, (2, 3))

    def at(self, x: float, y: float) -> tuple[float, float]:
        lean = self._limit * np.sin(self._waves @ (x, y) + self._phases).mean(axis=1)
        return float(lean[0]), float(lean[1])


class Plant:
    """Differential drive in the world, stepped by its owner.

    Args:
        world: mesh; ``start`` is (x, y, yaw) in its frame.
        tracks: of people and carts.
        seed: of drift and tilt.
        slip_at: distances driven (metres) at which the wheels spin for a while.
    """

    def __init__(
        self,
        world: World,
        profile: BaseProfile,
        start: tuple[float, float, float],
        tracks: Sequence[Track] = (),
        seed: int = 0,
        slip_at: Sequence[float] = (),
    ) -> None:
        self.odometry = Odometry(profile.odometry, seed)
        self.collisions = 0
        self.distance = 0.0
        self.time = 0.0
        self._profile = profile
        self._tracks = tracks
        self._tilt = Tilt(profile.tilt_max, seed)
        self._obstruction = Obstruction(world, profile.footprint)
        self._x, self._y, self._yaw = start
        self._left, self._right = WheelLoop(2 * profile.acceleration), WheelLoop(2 * profile.acceleration)
        self._command = (0.0, 0.0)
        self._in_contact = False
        self._slips = sorted(slip_at)
        self._spin = 0.0

    @property
    def pose(self) -> tuple[float, float, float]:
        """True (x, y, yaw)."""
        return self._x, self._y, self._yaw

    @property
    def velocity(self) -> tuple[float, float]:
        """True speed (m/s) and turn rate (rad/s)."""
        left, right = self._left.speed, self._right.speed
        return (left + right) / 2, (right - left) / self._profile.track_width

    @property
    def moving(self) -> bool:
        return bool(max(abs(self._left.speed), abs(self._right.speed)) > _AT_REST)

    def bodies(self) -> tuple[Body, ...]:
        return standing(self._tracks, self.time)

    def stance(self) -> Stance:
        return Stance(transforms.planar(*self.pose), self._tilt.at(self._x, self._y), self.bodies(), self.moving)

    def command(self, speed: float, turn_rate: float) -> None:
        """Set the speeds to reach, m/s and rad/s."""
        self._command = speed, turn_rate

    def brake(self) -> None:
        """The hardware stop: wheels locked."""
        self._command = (0.0, 0.0)
        self._left.halt()
        self._right.halt()

    def step(self, dt: float) -> bool:
        """Advance by ``dt`` seconds; True if the bumper was pressed: the robot ran, or pushed on, into something."""
        self.time += dt
        speed, turn_rate = self._command
        half_track = self._profile.track_width / 2
        self._left.step(speed - turn_rate * half_track, dt)
        self._right.step(speed + turn_rate * half_track, dt)
        speed, turn_rate = self.velocity
        if not self.moving:
            return False
        distance, rotation = speed * dt, turn_rate * dt
        if self._spins(distance):
            self.odometry.moved(distance, rotation)
            return False
        middle = self._yaw + rotation / 2
        x, y = self._x + distance * float(np.cos(middle)), self._y + distance * float(np.sin(middle))
        yaw = self._yaw + rotation
        if self._obstruction.touches(x, y, yaw, self.bodies()):
            return self._run_into()
        self._in_contact = False
        self._x, self._y, self._yaw = x, y, float(np.arctan2(np.sin(yaw), np.cos(yaw)))
        self.distance += abs(distance)
        self.odometry.moved(distance, rotation)
        return False

    def _spins(self, distance: float) -> bool:
        """Whether the wheels turn on the spot just now, after a scripted slip."""
        if self._slips and self.distance >= self._slips[0]:
            self._spin = _SPIN_LENGTH
            self._slips.pop(0)
        self._spin -= abs(distance)
        return self._spin > 0.0

    def _run_into(self) -> bool:
        """What is touched stops the wheels; pushing on against it is still the same collision."""
        self._left.halt()
        self._right.halt()
        self.collisions += not self._in_contact
        self._in_contact = True
        return True
