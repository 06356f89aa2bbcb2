"""The simulated base: the plant, the software that drives it, and what a server on a socket may call."""

import threading
from collections.abc import Callable

from drivers.devices import BaseTelemetry
from drivers.interfaces import BaseInfo, DriveGoal, DriveReport
from drivers.jobs import Failed, Outcome, Running
from drivers.messages import PROTOCOL
from drivers.simulated.clock import Clock
from drivers.simulated.drive import Drive
from drivers.simulated.lidar import Lidar, Sweep
from drivers.simulated.localiser import Localiser
from drivers.simulated.plant import Plant, Stance
from drivers.simulated.profile import BaseProfile
from drivers.simulated.scenario import Scenario
from drivers.simulated.surroundings import Surroundings
from drivers.simulated.truth_log import TruthLog
from drivers.simulated.world import World
from perception import transforms
from perception.failure import FailureError

_PLANNING = Running(0.0, "planning")
_BATTERY_SECONDS = 8 * 3600.0
_MAX_LAG = 2.0


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
    """

    def __init__(
        self,
        world: World,
        profile: BaseProfile | None = None,
        scenario: Scenario | None = None,
        seed: int = 0,
        truth: TruthLog | None = None,
    ) -> None:
        self._profile = profile or BaseProfile()
        self._scenario = scenario or Scenario()
        self._truth = truth or TruthLog()
        self._seed = seed
        self._plant = Plant(world, self._profile, world.start, self._scenario.tracks, seed, self._scenario.base.slip_at)
        self._lidar = Lidar(Surroundings(world), self._profile.lidar, self._profile.guard, seed)
        self._localiser: Localiser | None = None
        self._drive: Drive | None = None
        self._outcomes: dict[str, Outcome[DriveReport]] = {}
        self._orders: list[DriveGoal | None] = []
        self._newest_sweep = self._lidar.sweep(*self._plant.pose, self._plant.bodies())
        self._swept_at = 0.0
        self._stopped = False
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
        """Advance with a clock until told to stop; after a long plan the time that was missed is skipped."""
        dt = self._profile.time_step
        done = clock.now()
        while not should_stop():
            behind = clock.now() - done
            if behind < dt:
                clock.sleep(dt - behind)
                continue
            if behind > _MAX_LAG:
                done += behind - _MAX_LAG
            self.step(dt)
            done += dt

    def step(self, dt: float) -> None:
        """Advance the world and the robot by a few hundredths of a second; called by one thread only."""
        self._obey()
        before = self._plant.odometry.pose
        if self._plant.step(dt):
            self._truth.write("collision", self._plant.time, pose=self._plant.pose)
        sweep = self._sweep()
        if self._localiser:
            self._localiser.predict(before, self._plant.odometry.pose)
            if sweep is not None and self._plant.moving:
                self._localiser.correct(sweep.plane)
        self._control(sweep)
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
            self._drive = Drive(goal, self._localiser, self._profile, self._plant.time, self._newest_sweep)
            self._outcomes[goal.goal_id] = self._drive.outcome
        except FailureError as error:
            self._outcomes[goal.goal_id] = Failed(error.failure)

    def _localised_in(self, goal: DriveGoal) -> Localiser:
        if goal.map_from_base is not None:
            return Localiser(goal.robot_map, transforms.to_planar(goal.map_from_base))
        if self._localiser is None:
            raise FailureError("NAV_STUCK", "the base was never told where it stands", goal_id=goal.goal_id)
        return Localiser(goal.robot_map, self._localiser.pose)

    def _control(self, sweep: Sweep | None) -> None:
        """Let the drive command the wheels, unless the red button is pressed."""
        if self._emergency_stop:
            self._plant.brake()
            self._drop("ESTOP", "the emergency stop is pressed")
        if self._drive is None:
            return
        if isinstance(self._drive.outcome, Running):
            self._plant.command(*self._drive.step(self._plant.time, sweep))
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
    def _emergency_stop(self) -> bool:
        return any(start <= self._plant.time < end for start, end in self._scenario.base.emergency_stop)

    def _report(self) -> BaseTelemetry:
        return BaseTelemetry(
            odom_from_base=self._plant.odometry.odom_from_base,
            map_from_base=transforms.planar(*self._localiser.pose) if self._localiser else None,
            moving=self._plant.moving,
            emergency_stop=self._emergency_stop,
            battery=max(0.0, 1.0 - self._plant.time / _BATTERY_SECONDS),
            activity=self._drive.phase if self._drive else ("stopped" if self._stopped else "idle"),
        )
