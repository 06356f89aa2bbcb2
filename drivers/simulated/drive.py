"""One drive from order to end: plan, follow, wait where the way is blocked, plan again, back up, give up."""

from enum import StrEnum

import numpy as np

from drivers.interfaces import DriveGoal, DriveReport
from drivers.jobs import Done, Failed, Outcome, Running
from drivers.simulated.costmap import CostMap
from drivers.simulated.follower import Command, Follower
from drivers.simulated.lidar import Sweep
from drivers.simulated.localiser import Localiser
from drivers.simulated.planner import Path, Planner, Pose
from drivers.simulated.profile import BaseProfile
from drivers.simulated.safety import SafetyMonitor
from perception import transforms
from perception.failure import Failure, FailureError

_REST: Command = (0.0, 0.0)
_LOOK_AHEAD = 1.8
_LOOK_EVERY = 0.4
_HELD_TOO_LONG = 0.6
_PATIENCE, _SHORT_PATIENCE = 20.0, 2.0
_BACK_UP, _BACK_UP_SPEED, _BACK_UP_TIME = 0.3, 0.12, 6.0
_ROUNDS = 4
_STUCK_AFTER, _STUCK_WITHIN, _TIMES_STUCK = 8.0, 0.03, 2
_ANYWHERE_TOLERANCE, _DOORWAY_TOLERANCE = 0.06, 0.03
_CORRECTIONS = 2
_TRACK_STEP, _TRACK_TURN = 0.05, np.deg2rad(5.0)


class Phase(StrEnum):
    FOLLOWING = "driving"
    WAITING = "waiting"
    BACKING_UP = "blocked"


class Drive:
    """Knows the goal, the base's own localisation and its sweeps; never the truth.

    Args:
        goal: what was ordered.
        localiser: moved and corrected by its owner.
        now: simulated seconds.
        resting: the newest sweep.

    Raises:
        FailureError: ``NAV_NO_PATH``; nothing was driven.
    """

    def __init__(self, goal: DriveGoal, localiser: Localiser, profile: BaseProfile, now: float, resting: Sweep) -> None:
        self.goal = goal
        self.phase = Phase.FOLLOWING
        self.outcome: Outcome[DriveReport] = Running(0.0)
        self._localiser = localiser
        self._profile = profile
        self._monitor = SafetyMonitor(profile)
        self._planner = Planner(profile.footprint)
        self._map = CostMap(goal.robot_map, profile.footprint)
        self._map.observe(localiser.pose, resting)
        self._sweep = resting
        self._track: list[Pose] = [localiser.pose]
        self._distance = 0.0
        self._last = localiser.pose
        self._rounds = self._corrections = self._times_stuck = 0
        self._now = self._since = self._looked = self._moved_at = now
        self._moved_from = localiser.pose
        self._held_since: float | None = None
        self._has_backed_up = False
        self._backed_from = localiser.pose
        self._retreat = -_BACK_UP_SPEED
        self._follower = Follower(self._first_path(), profile)

    @property
    def report(self) -> DriveReport:
        return DriveReport(
            self.goal.goal_id, transforms.planar(*self._localiser.pose), tuple(self._track), self._distance
        )

    def step(self, now: float, sweep: Sweep | None) -> Command:
        """The command for the wheels at a time; ``sweep`` where there is a new one."""
        self._now = now
        if sweep is not None:
            self._sweep = sweep
            self._map.observe(self._localiser.pose, sweep)
        self._keep_track()
        if self._localiser.lost:
            self._fail("NAV_STUCK", f"localisation lost: position uncertain by {self._localiser.sigma:.2f} m")
        if not isinstance(self.outcome, Running):
            return 0.0, 0.0
        if self.phase is Phase.WAITING:
            return self._wait()
        if self.phase is Phase.BACKING_UP:
            return self._back_up()
        return self._follow()

    def fail(self, code: str, message: str) -> None:
        """End the drive from outside: stopped, superseded, emergency stop."""
        if isinstance(self.outcome, Running):
            self._fail(code, message)

    def _first_path(self) -> Path:
        """The first plan; obstacles that only the planar scanner knows may go away, so they do not forbid it."""
        try:
            return self._plan()
        except FailureError:
            self._map.forget()
            return self._plan()

    def _plan(self) -> Path:
        return self._planner.plan(self._map, self._localiser.pose, (self.goal.x, self.goal.y, self.goal.yaw))

    def _follow(self) -> Command:
        wanted = self._follower.command(self._localiser.pose, self._monitor.space(self._sweep))
        if self._follower.done:
            return self._arrive()
        allowed = self._monitor.limit(wanted, self._sweep)
        if self._is_held(allowed) or self._is_way_blocked(every=_LOOK_EVERY):
            self._enter(Phase.WAITING)
            return _REST
        if self._now - self._moved_at > _STUCK_AFTER:
            return self._get_unstuck()
        self.outcome = Running(self._follower.fraction, self.phase)
        return allowed

    def _get_unstuck(self) -> Command:
        """The way is neither blocked nor made: back off and plan anew, a few times."""
        self._times_stuck += 1
        if self._times_stuck > _TIMES_STUCK:
            self._fail("NAV_STUCK", f"no progress for {_STUCK_AFTER:.0f} s, after {_TIMES_STUCK} other starts")
        else:
            self._enter(Phase.BACKING_UP)
        return _REST

    def _wait(self) -> Command:
        """Stand still until the way is free, or patience ends and another way is looked for."""
        wanted = self._follower.command(self._localiser.pose, self._monitor.space(self._sweep))
        way_blocked = self._is_way_blocked()
        waited = self._now - self._since
        if waited > _LOOK_EVERY and not way_blocked and self._monitor.limit(wanted, self._sweep) != _REST:
            self._enter(Phase.FOLLOWING)
        elif waited > (_PATIENCE if way_blocked else _SHORT_PATIENCE):
            self._look_for_another_way()
        return _REST

    def _look_for_another_way(self) -> None:
        self._rounds += 1
        if self._rounds > _ROUNDS:
            self._fail("NAV_BLOCKED", f"still blocked after {_ROUNDS} other ways were tried")
            return
        try:
            self._follower = Follower(self._plan(), self._profile)
        except FailureError as error:
            if self._has_backed_up:
                self._fail("NAV_BLOCKED", f"an obstacle stays in the way; {error.failure.message}")
            else:
                self._enter(Phase.BACKING_UP)
            return
        # A way that leads through the same place needs another start, or it would be held there again.
        if self._rounds > 1 and not self._has_backed_up:
            self._enter(Phase.BACKING_UP)
        else:
            self._enter(Phase.FOLLOWING)

    def _back_up(self) -> Command:
        allowed = self._monitor.limit((self._retreat, 0.0), self._sweep)
        gone = np.hypot(*np.subtract(self._localiser.pose[:2], self._backed_from[:2]))
        if gone < _BACK_UP and allowed != _REST and self._now - self._since < _BACK_UP_TIME:
            return allowed
        self._has_backed_up = True
        self._look_for_another_way()
        return _REST

    def _arrive(self) -> Command:
        """Done, unless the end of the path was missed by so much that driving there once more is worth it."""
        off, _ = _apart(self._localiser.pose, tuple(self._follower.path.poses[-1]))
        allowed = _ANYWHERE_TOLERANCE if self.goal.yaw is None else _DOORWAY_TOLERANCE
        if off > allowed and self._corrections < _CORRECTIONS:
            self._corrections += 1
            try:
                self._follower = Follower(self._plan(), self._profile)
            except FailureError:
                self._corrections = _CORRECTIONS
            return _REST
        self.outcome = Done(self.report)
        return _REST

    def _is_held(self, allowed: Command) -> bool:
        """Whether the safety monitor has allowed no motion for a while."""
        if allowed != _REST:
            self._held_since = None
            return False
        self._held_since = self._now if self._held_since is None else self._held_since
        return self._now - self._held_since > _HELD_TOO_LONG

    def _is_way_blocked(self, every: float = 0.0) -> bool:
        """Whether something that is not in the robot map stands on the path ahead; looks not more often than told."""
        if self._now - self._looked < every:
            return False
        self._looked = self._now
        return any(self._map.is_seen_under((x, y, yaw)) for x, y, yaw in self._follower.ahead(_LOOK_AHEAD))

    def _enter(self, phase: Phase) -> None:
        self.phase = phase
        self._since = self._moved_at = self._now
        self._held_since = None
        self._backed_from = self._localiser.pose
        if phase is Phase.FOLLOWING:
            self._has_backed_up = False
        elif phase is Phase.BACKING_UP:
            # What holds a turn may be close behind; then the way out is forward.
            backwards = self._monitor.limit((-_BACK_UP_SPEED, 0.0), self._sweep)
            self._retreat = _BACK_UP_SPEED if backwards == _REST else -_BACK_UP_SPEED

    def _keep_track(self) -> None:
        pose = self._localiser.pose
        self._distance += _apart(pose, self._last)[0]
        self._last = pose
        distance, turn = _apart(pose, self._track[-1])
        if distance > _TRACK_STEP or turn > _TRACK_TURN:
            self._track.append(pose)
        distance, turn = _apart(pose, self._moved_from)
        if distance > _STUCK_WITHIN or turn > _TRACK_TURN:
            self._moved_from, self._moved_at = pose, self._now

    def _fail(self, code: str, message: str) -> None:
        evidence = {
            "goal_id": self.goal.goal_id,
            "track": [list(pose) for pose in self._track],
            "map_from_base": transforms.planar(*self._localiser.pose).tolist(),
            "distance": self._distance,
        }
        self.outcome = Failed(Failure(code, message, evidence))


def _apart(a: Pose, b: Pose) -> tuple[float, float]:
    turn = np.arctan2(np.sin(a[2] - b[2]), np.cos(a[2] - b[2]))
    return float(np.hypot(a[0] - b[0], a[1] - b[1])), abs(float(turn))
