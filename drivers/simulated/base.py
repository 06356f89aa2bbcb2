"""The simulated base: the plant, the software that drives it, and what a server on a socket may call."""

import threading
import time
from collections.abc import Callable

from drivers.devices import BaseTelemetry
from drivers.interfaces import BaseInfo, DriveGoal, DriveReport
from drivers.jobs import Failed, Outcome, Running
from drivers.lease import NEVER
from drivers.messages import PROTOCOL
from drivers.simulated.battery import Battery
from drivers.simulated.clock import Clock
from drivers.simulated.drive import Drive
from drivers.simulated.lidar import Lidar, Sweep
from drivers.simulated.localiser import Localiser
from drivers.simulated.plant import Plant
from drivers.simulated.profile import BaseProfile
from drivers.simulated.scenario import Scenario
from drivers.simulated.stance import Stance
from drivers.simulated.surroundings import Surroundings
from drivers.simulated.truth_log import TruthLog
from drivers.simulated.whereabouts import Whereabouts
from drivers.simulated.world import World
from perception import transforms
from perception.failure import FailureError

_PLANNING = Running(0.0, "planning")
_MAX_LAG = 2.0
_STALLED = 0.2
_GLANCES = 5


class SimulatedBase:
    """A base in a world. Every public method may be called from any thread and returns at once.

    A :class:`~drivers.devices.BaseDevice`. Its time is advanced by :meth:`step`, from :meth:`run` on a clock or by a
    test. Inside, the drive sees odometry and sweeps only; the truth leaves this class through :meth:`stance`, for the
    scanner, and through the truth log.

    Args:
        world: where it stands, at ``world.start``.
        profile: of the drive and its sensors.
        scenario: people and faults.
        seed: of drift, noise and tilt.
        truth: log for the evaluation.
        whereabouts: where it stands if it has been in this world before, and where it comes to stand.
    """

    def __init__(
        self,
        world: World,
        profile: BaseProfile | None = None,
        scenario: Scenario | None = None,
        seed: int = 0,
        truth: TruthLog | None = None,
        whereabouts: Whereabouts | None = None,
    ) -> None:
        self._profile = profile or BaseProfile()
        self._scenario = scenario or Scenario()
        self._truth = truth or TruthLog()
        self._seed = seed
        self._whereabouts = whereabouts
        start = (whereabouts and whereabouts.read()) or world.start
        self._plant = Plant(world, self._profile, start, self._scenario.tracks, seed, self._scenario.base.slip_at)
        self._lidar = Lidar(Surroundings(world), self._profile.lidar, self._profile.guard, seed)
        self._localiser: Localiser | None = None
        self._drive: Drive | None = None
        self._outcomes: dict[str, Outcome[DriveReport]] = {}
        self._orders: list[DriveGoal | None] = []
        self._newest_sweep = self._lidar.sweep(*self._plant.pose, self._plant.bodies())
        self._swept_at = 0.0
        self._stopped = False
        self._permitted_until = NEVER
        self._held_for = 0.0
        self._battery = Battery(self._scenario.base.battery, world.start[:2])
        self._lock = threading.Lock()
        self._stance = self._plant.stance()
        self._newest = self._report()

    @property
    def collisions(self) -> int:
        """Collisions so far; for the evaluation."""
        return self._plant.collisions

    def info(self) -> BaseInfo:
        return BaseInfo(self._profile.model, f"SIM-{self._seed:04d}", PROTOCOL, self._profile.footprint)

    def telemetry(self) -> BaseTelemetry:
        """The state as of the last step."""
        return self._newest

    def stance(self) -> Stance:
        """The truth as of the last step; for the simulated scanner and the evaluation only."""
        return self._stance

    def permit(self, until: float) -> None:
        """Let the wheels turn until this instant of the real monotonic clock, however fast simulated time runs."""
        self._permitted_until = until

    def start_drive(self, goal: DriveGoal) -> None:
        """Accept a goal, dropping any other; one that is known already is not driven again."""
        with self._lock:
            if goal.goal_id not in self._outcomes:
                self._outcomes[goal.goal_id] = _PLANNING
                self._orders.append(goal)

    def drive_status(self, goal_id: str) -> Outcome[DriveReport] | None:
        """How a goal fares as of the last step; None for one never ordered."""
        return self._outcomes.get(goal_id)

    def stop(self) -> None:
        """Bring the wheels to rest and drop any goal."""
        with self._lock:
            self._orders.append(None)

    def run(self, clock: Clock, should_stop: Callable[[], bool]) -> None:
        """Advance with a clock until told to stop; after a long plan the time that was missed is skipped.

        Between two steps it looks several times whether the wheels may still turn, and after a stall of this very loop
        they are brought to rest first: meanwhile nobody was in control of them.
        """
        dt = self._profile.time_step
        done, looked = clock.now(), time.monotonic()
        while not should_stop():
            looked, stalled = time.monotonic(), time.monotonic() - looked > _STALLED
            if self._plant.moving and (stalled or not self._permitted):
                self._plant.brake()
                self._newest = self._report()
            behind = clock.now() - done
            if behind < dt:
                clock.sleep(min(dt - behind, dt / _GLANCES))
                continue
            if behind > _MAX_LAG:
                done += behind - _MAX_LAG
            self.step(dt)
            done += dt

    def step(self, dt: float) -> None:
        """Advance the world and the robot by a few hundredths of a second; called by one thread only."""
        self._obey()
        permitted = self._permitted
        if not permitted:
            self._plant.brake()
            self._held_for += dt
            self._swept_at = NEVER  # what it sees when it goes on is new
        before = self._plant.odometry.pose
        collisions = self._plant.collisions
        touched = self._plant.step(dt)
        if self._plant.collisions > collisions:
            self._truth.write("collision", self._plant.time, pose=self._plant.pose)
        sweep = self._sweep() if permitted else None
        if self._localiser:
            self._localiser.predict(before, self._plant.odometry.pose)
            if sweep is not None and self._plant.moving:
                self._localiser.correct(sweep.plane)
        if touched:
            self._drop("COLLISION", "the bumper was touched")
        self._control(sweep, permitted)
        self._battery.step(dt, self._plant.pose[:2], self._plant.moving)
        if self._whereabouts is not None:
            self._whereabouts.write(self._plant.pose)
        self._stance = self._plant.stance()
        self._newest = self._report()

    def _obey(self) -> None:
        """Take up the orders that came in since the last step, the newest last."""
        with self._lock:
            orders, self._orders = self._orders, []
        for goal in orders:
            why = "stopped by order" if goal is None else f"superseded by {goal.goal_id}"
            self._drop("CANCELLED", why)
            self._stopped = goal is None
            if goal is not None:
                self._begin(goal)

    def _begin(self, goal: DriveGoal) -> None:
        self._newest_sweep = self._lidar.sweep(*self._plant.pose, self._plant.bodies())
        try:
            self._localiser = self._localised_in(goal)
            self._drive = Drive(goal, self._localiser, self._profile, self._driving_time, self._newest_sweep)
            self._outcomes[goal.goal_id] = self._drive.outcome
            self._truth.write("drive_begun", self._plant.time, goal_id=goal.goal_id)
        except FailureError as error:
            self._outcomes[goal.goal_id] = Failed(error.failure)

    def _localised_in(self, goal: DriveGoal) -> Localiser:
        if goal.map_from_base is not None:
            return Localiser(goal.robot_map, transforms.to_planar(goal.map_from_base))
        if self._localiser is None:
            raise FailureError("NAV_STUCK", "the base was never told where it stands", goal_id=goal.goal_id)
        return Localiser(goal.robot_map, self._localiser.pose)

    def _control(self, sweep: Sweep | None, permitted: bool) -> None:
        """Let the drive command the wheels, unless the red button is pressed or nobody answers for them."""
        if self._emergency_stop:
            self._plant.brake()
            self._drop("ESTOP", "the emergency stop is pressed")
        if self._drive is None:
            return
        if permitted and isinstance(self._drive.outcome, Running):
            self._plant.command(*self._drive.step(self._driving_time, sweep))
        if isinstance(self._drive.outcome, Running):
            self._outcomes[self._drive.goal.goal_id] = self._drive.outcome
        elif not self._plant.moving:
            self._end()  # told only at rest, for the next thing will be a scan

    def _drop(self, code: str, why: str) -> None:
        if self._drive:
            self._drive.fail(code, why)
            self._end()

    def _end(self) -> None:
        """Tell the outcome of the drive and forget it."""
        if self._drive:
            goal_id, pose, distance = self._drive.goal.goal_id, self._plant.pose, self._plant.distance
            self._truth.write("drive", self._plant.time, goal_id=goal_id, pose=pose, distance=distance)
            self._outcomes[goal_id] = self._drive.outcome
        self._drive = None
        self._plant.command(0.0, 0.0)

    def _sweep(self) -> Sweep | None:
        """A new sweep where a turn is due, which without a drive it never is."""
        due = self._plant.time - self._swept_at >= self._profile.lidar.interval - 1e-9
        if not due or self._drive is None:
            return None
        self._swept_at = self._plant.time
        self._newest_sweep = self._lidar.sweep(*self._plant.pose, self._plant.bodies())
        return self._newest_sweep

    @property
    def _permitted(self) -> bool:
        return time.monotonic() < self._permitted_until

    @property
    def _driving_time(self) -> float:
        """Simulated time that stands still while the wheels are held."""
        return self._plant.time - self._held_for

    @property
    def _emergency_stop(self) -> bool:
        return any(start <= self._plant.time < end for start, end in self._scenario.base.emergency_stop)

    def _report(self) -> BaseTelemetry:
        return BaseTelemetry(
            odom_from_base=self._plant.odometry.odom_from_base,
            map_from_base=transforms.planar(*self._localiser.pose) if self._localiser else None,
            moving=self._plant.moving,
            emergency_stop=self._emergency_stop,
            battery=self._battery.charge,
            activity=self._activity(),
        )

    def _activity(self) -> str:
        if self._drive is None:
            return "stopped" if self._stopped else "idle"
        return self._drive.phase if self._permitted else "held"
