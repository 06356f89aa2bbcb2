"""A scanner, a base and a perception worker that act a script: what is not in it goes well.

They know the truth of a :mod:`site <tests.scenarios.site>`, take their time on a virtual clock, and check what the
tree hands them as the real ones would: a pose that is claimed must be true, an argument must survive pickling.
"""

import pickle
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from drivers.interfaces import BaseState, DriveGoal, DriveReport, Lease, ScanReceipt, ScanSettings
from drivers.jobs import Done, Failed, Outcome, Running
from drivers.simulated.clock import VirtualClock
from mission.summaries import MapSummary, ScanSummary
from perception import transforms
from perception.failure import Failure, FailureError
from perception.findings import (
    Alignment,
    Candidate,
    DoorFindings,
    LabelCounts,
    Movement,
    PoseAdjustment,
    Registration,
    ViewChoice,
)
from perception.grids import Cell, Grid
from perception.transforms import Matrix
from tests.scenarios.site import HEIGHT, Site

MOUNT = transforms.planar(0.1, 0.0, 0.0) @ transforms.from_euler(0, 0, 0, (0, 0, 1.3))
ODOM_FROM_MAP = transforms.planar(5.0, -3.0, 0.7)
"""Odometry starts anywhere; nothing may take it for the map."""

FOR_GOOD = 10_000
"""Calls, or ticks, that no mission has."""
ONCE, TWICE, EVER = range(1, 2), range(1, 3), range(1, FOR_GOOD)
HANG = object()
"""As an outcome: the job never ends."""

WORKER_S = 360.0
"""The perception worker kills a stage after 180 s of the wall, and gives it one more chance."""

SECONDS = {"take": 30.0, "drive": 30.0}
"""How long things take; 10 s where nothing is said."""
ROLLS_ON_S = 15.0
"""So long its wheels still turn after the base was last seen driving: at the next tick too."""


class ScriptedJob:
    """Runs for so many mission seconds and then ends as ``conclude`` says, unless it is cancelled before."""

    def __init__(self, what: str, clock: VirtualClock, seconds: float, conclude: Callable[[], Outcome[Any]]) -> None:
        self.what = what
        self.cancelled = False
        self.outcome: Outcome[Any] | None = None
        self._clock = clock
        self._ends = clock.now() + seconds
        self._conclude = conclude

    @property
    def over(self) -> bool:
        return self.cancelled or self.outcome is not None

    def settle(self) -> None:
        """What is due by now has happened, whether or not anybody asks."""
        if self.outcome is None and not self.cancelled and self._clock.now() >= self._ends:
            self.outcome = self._conclude()

    def poll(self) -> Outcome[Any]:
        self.settle()
        return self.outcome or Running(None, self.what)

    def cancel(self) -> None:
        self.cancelled = self.outcome is None

    def conclude_with(self, act: Callable[[], object]) -> None:
        """Where all goes well, this gives the value; unless it ended before."""
        conclude = self._conclude

        def concluded() -> Outcome[Any]:
            outcome = conclude()
            return Done(act()) if isinstance(outcome, Done) else outcome

        self._conclude = concluded


@dataclass(frozen=True)
class Way:
    """How an operation goes otherwise than well.

    Args:
        value: what it gives, made of what would give its right value.
        seconds: how long it takes, made of how long it would.
    """

    value: Callable[[Callable[[], object]], object] = lambda act: act()
    seconds: Callable[[float], float] = lambda seconds: seconds


@dataclass
class Script:
    """What happens at which call of an operation, and how often each was called.

    Operations are ``take``, ``fetch``, ``drive``, ``stop``, ``acquire``, ``release`` and the names of the stages.
    """

    clock: VirtualClock = field(default_factory=VirtualClock)
    calls: Counter[str] = field(default_factory=Counter)
    jobs: list[ScriptedJob] = field(default_factory=list)
    _told: dict[tuple[str, int], object] = field(default_factory=dict)

    def fail(self, operation: str, code: str, calls: Iterable[int] = ONCE) -> "Script":
        return self.answer(operation, Failure(code, "as the script wants it"), calls)

    def answer(self, operation: str, outcome: object, calls: Iterable[int] = ONCE) -> "Script":
        """The calls of these numbers, counted from one, end with a failure, with another value, or never."""
        self._told.update({(operation, call): outcome for call in calls})
        return self

    def job(
        self, operation: str, act: Callable[[], object], deadline: float = float("inf"), late: Failure | None = None
    ) -> ScriptedJob:
        """A call of an operation; ``act`` gives its value, or a Failure, if the script does not.

        Args:
            deadline: seconds after which whoever does it gives up by himself, and fails with ``late``.
        """
        self.calls[operation] += 1
        told = self._told.get((operation, self.calls[operation]))
        way = told if isinstance(told, Way) else Way() if told is None else Way(lambda _: told)
        seconds = float("inf") if told is HANG else way.seconds(SECONDS.get(operation, 10.0))

        def conclude() -> Outcome[Any]:
            try:
                value = late if seconds > deadline else way.value(act)
            except FailureError as error:
                value = error.failure
            return Failed(value) if isinstance(value, Failure) else Done(value)

        self.jobs.append(ScriptedJob(operation, self.clock, min(seconds, deadline), conclude))
        return self.jobs[-1]


class ScriptedBase:
    """Drives through open doors to free places; its odometry is exact, and it never localises itself.

    ``closed`` names the passages that are shut, ``occupied`` the places (x, y) that somebody stands on, ``owner`` whose
    it is, ``is_pushed`` says that its wheels turn though nobody told them to.
    """

    def __init__(self, site: Site, script: Script, owner: str = "") -> None:
        self.site = site
        self.owner = owner
        self.pose: tuple[float, float, float] = (0.0, 0.0, 0.0)
        self.closed: set[str] = set()
        self.occupied: set[tuple[float, float]] = set()
        self.goals: list[DriveGoal] = []
        self.commands: list[str] = []
        self.emergency_stop = False
        self.battery = 0.9
        self.silent_since: float | None = None
        self.odom_from_map = ODOM_FROM_MAP
        self.boots = 1
        self.was_placed = False
        self.has_slipped = False
        self.is_pushed = False
        self._drives: list[ScriptedJob] = []
        self._at_rest_from = 0.0
        self._asked_for: list[ScriptedJob] = []
        self.beats: list[tuple[int, bool]] = []
        self._script = script

    @property
    def map_from_base(self) -> Matrix:
        return transforms.planar(*self.pose)

    def state(self) -> BaseState | None:
        now = self._script.clock.now()
        if any(not job.over for job in self._drives):
            self._at_rest_from = now + ROLLS_ON_S
        for job in (*self._drives, *self._asked_for):
            job.settle()
        age = 0.0 if self.silent_since is None else now - self.silent_since
        odometry = self.odom_from_map @ self.map_from_base
        return BaseState(
            odometry, None, self.is_pushed or now < self._at_rest_from, self.emergency_stop, self.battery, "idle", age,
            self.owner, f"boot {self.boots}",
        )  # fmt: skip

    def reboot(self, at: tuple[float, float, float] | None = None) -> None:
        """Its agent begins anew, where the base stands or where somebody has put it: odometry from zero, no owner."""
        for job in self._script.jobs:
            if job.what == "drive" and not job.over:
                job.outcome = Failed(Failure("NAV_INTERRUPTED", "the base began anew", {"track": [], "distance": 0.0}))
        self.pose = at or self.pose
        self.odom_from_map = transforms.inverse(self.map_from_base)
        self.boots += 1
        self.owner, self.was_placed = "", False

    def push(self, x: float) -> None:
        """Somebody rolls it along x by so much, and its wheels notice."""
        self.pose = (self.pose[0] + x, *self.pose[1:])

    def slip(self, x: float, y: float, yaw: float) -> None:
        """It is moved by so much, and its wheels do not notice: odometry says that it stands where it stood."""
        odometry = self.odom_from_map @ self.map_from_base
        self.pose = (self.pose[0] + x, self.pose[1] + y, self.pose[2] + yaw)
        self.odom_from_map = odometry @ transforms.inverse(self.map_from_base)
        self.has_slipped = True

    def acquire(self, owner: str) -> ScriptedJob:
        self._asked_for.append(self._script.job("acquire", lambda: self._become_owned_by(owner)))
        return self._asked_for[-1]

    def beat(self, tick: int, may_move: bool) -> None:
        assert not self.beats or tick > self.beats[-1][0], "the same tick beats once"
        self.beats.append((tick, may_move))

    def release(self) -> ScriptedJob:
        return self._script.job("release", lambda: None)

    def drive(self, goal: DriveGoal) -> ScriptedJob:
        assert goal.goal_id not in {known.goal_id for known in self.goals}, "a goal is never driven twice"
        if goal.map_from_base is not None:
            told = np.allclose(goal.map_from_base, self.map_from_base)
            assert told or self.has_slipped, "the base is not where it is said to be"
            self.was_placed = True
        self.goals.append(goal)
        self.commands.append("drive")
        self._drives.append(self._script.job("drive", lambda: self._arrive(goal)))
        return self._drives[-1]

    def stop(self) -> ScriptedJob:
        self.commands.append("stop")
        return self._script.job("stop", lambda: None)

    def _become_owned_by(self, owner: str) -> Lease | Failure:
        if self.owner not in ("", owner):
            return Failure("LEASE_HELD", f"the base belongs to {self.owner}")
        self.owner = owner
        return Lease(self.boots, 1, owner)

    def _arrive(self, goal: DriveGoal) -> DriveReport | Failure:
        if self.emergency_stop:
            return Failure("ESTOP", "the emergency stop is pressed", {"track": [], "distance": 0.0})
        if self.silent_since is not None:
            return Failure("AGENT_UNREACHABLE", "no answer")
        if not self.was_placed:
            return Failure("NAV_STUCK", "the base was never told where it stands", {"track": [], "distance": 0.0})
        start, target = self.pose[:2], (goal.x, goal.y)
        way = self.site.way(start, target)
        if way is None:
            return Failure("NAV_NO_PATH", "there is no way", {"track": [], "distance": 0.0})
        shut = [name for name in (*way, self.site.passage_at(*target)) if name in self.closed]
        if shut:
            return self._blocked(self._before(way, shut[0]))
        if any(np.hypot(x - goal.x, y - goal.y) < 0.5 for x, y in self.occupied):
            return self._blocked(((start[0] + goal.x) / 2, (start[1] + goal.y) / 2))
        track, distance = self._move([*(self.site.passages[name].middle for name in way), target], goal.yaw)
        return DriveReport(goal.goal_id, self.map_from_base, track, distance)

    def _before(self, way: list[str], shut: str) -> tuple[float, float]:
        """On this side of a shut door."""
        here = self.site.rooms_at(*self.pose[:2])
        for name in way[: way.index(shut)] if shut in way else way:
            here = set(self.site.passages[name].rooms)
        passage = self.site.passages[shut]
        return passage.before(next(room for room in passage.rooms if room in here), 0.8)

    def _blocked(self, at: tuple[float, float]) -> Failure:
        track, distance = self._move([at], None)
        return Failure("NAV_BLOCKED", "an obstacle stays in the way", {"track": track, "distance": distance})

    def _move(
        self, places: list[tuple[float, float]], yaw: float | None
    ) -> tuple[tuple[tuple[float, float, float], ...], float]:
        distance, track = 0.0, []
        for x, y in places:
            dx, dy = x - self.pose[0], y - self.pose[1]
            distance += float(np.hypot(dx, dy))
            self.pose = (x, y, float(np.arctan2(dy, dx)))
            track.append(self.pose)
        if yaw is not None:
            self.pose = (*self.pose[:2], yaw)
        return tuple(track), distance


class ScriptedScanner:
    """Takes scans of nothing, and knows from where they were taken."""

    def __init__(self, base: ScriptedBase, script: Script) -> None:
        self.taken: dict[str, Matrix] = {}
        self._base = base
        self._script = script

    def take(self, scan_id: str, settings: ScanSettings, odom_from_base: Matrix) -> ScriptedJob:
        assert scan_id not in self.taken, "the same name is never taken twice"
        assert np.allclose(odom_from_base, self._base.odom_from_map @ self._base.map_from_base)
        self.taken[scan_id] = self._base.map_from_base
        return self._script.job("take", lambda: _receipt(scan_id))

    def fetch(self, receipt: ScanReceipt, destination: Path) -> ScriptedJob:
        assert destination.stem == receipt.scan_id
        return self._script.job("fetch", lambda: destination)


class ScriptedPerception:
    """Finds in every scan what the site has; a room is seen by 90 % in its first cycle and by 92 % in its second.

    ``seen`` may say otherwise: voxels seen after each cycle, of 10,000, the last one for all cycles after it.
    ``spoiled`` has the scans that are none, with what validation finds wrong with them.
    """

    def __init__(self, site: Site, scanner: ScriptedScanner, script: Script) -> None:
        self.site = site
        self.seen: list[int] = [9000, 9200]
        self.requests: list[tuple[str, dict[str, Any]]] = []
        self.guess_errors: list[tuple[float, float]] = []
        self.spoiled: dict[str, str] = {}
        self._labelled: set[tuple[str, int]] = set()
        self._scanner = scanner
        self._script = script

    def submit(self, stage: str, /, **arguments: Any) -> ScriptedJob:
        arguments = pickle.loads(pickle.dumps(arguments))  # noqa: S301, as on the way to the worker
        self.requests.append((stage, arguments))
        late = Failure("PERC_TIMEOUT", f"{stage} did not end within its deadline")
        return self._script.job(stage, lambda: getattr(self, stage)(**arguments), WORKER_S, late)

    def of_stage(self, stage: str) -> list[dict[str, Any]]:
        """Arguments of each call of a stage."""
        return [arguments for name, arguments in self.requests if name == stage]

    def validate_scan(self, scan_id: str) -> ScanSummary | Failure:
        if scan_id in self.spoiled:
            return Failure(self.spoiled[scan_id], "what the scanner gave is no scan")
        return ScanSummary(1_000_000, 0, 0.9, 3.0, MOUNT)

    def align_scan(self, scan_id: str) -> Alignment:
        level_from_scanner = transforms.from_euler(0, 0, 0, (0, 0, 1.3))
        return Alignment(level_from_scanner, 0.0, 0.0, 1.3, HEIGHT, 0.0, 0.3)

    def anchor_scan(self, scan_id: str) -> Registration:
        return self._found(scan_id, "anchor")

    def register_scan(self, scan_id: str, guess: list[list[float]], error_m: float, **_: Any) -> Registration | Failure:
        found = self._found(scan_id, "icp")
        self.guess_errors.append(transforms.difference(np.array(guess), found.map_from_scanner))
        if self.guess_errors[-1][0] > 3 * error_m:
            return Failure("REG_INCONSISTENT", "it fits, but not where odometry has it")
        return found

    def register_globally(self, scan_id: str, **_: Any) -> Registration:
        return self._found(scan_id, "global")

    def optimise_poses(self, scans: list[tuple[str, list[list[float]]]]) -> PoseAdjustment:
        """Nothing to be mended: the poses are true."""
        poses = {name: np.array(pose) for name, pose in scans}
        return PoseAdjustment(poses, dict.fromkeys(poses, 0.002), len(poses) - 1, (), 0.0005, 0.0005, 0.0)

    def find_movement(self, **_: Any) -> Movement:
        return Movement(0.0, None)

    def segment_room(self, seed: tuple[float, float], **_: Any) -> object:
        return self.site.shape(self.site.room_at(*seed))

    def build_map(self, scan_id: str, **_: Any) -> MapSummary:
        return MapSummary(f"map_{scan_id}", 20.0, 2.0)

    def label_space(self, room_id: str, cycle: int, **_: Any) -> LabelCounts:
        self._labelled.add((room_id, cycle))
        seen = self.seen[min(cycle, len(self.seen)) - 1]
        return LabelCounts(seen // 10, seen - seen // 10, 10_000 - seen)

    def choose_view(self, room_id: str, cycle: int, shape: Any, stations: Any, avoid: Any, **_: Any) -> ViewChoice:
        if (room_id, cycle) not in self._labelled:
            raise FailureError("PERC_EXCEPTION", f"{room_id} was never labelled in cycle {cycle}")
        taken = [(pose[0][3], pose[1][3], 0.5) for _, pose in stations]
        views = [
            Candidate(x, y, gain, 3.0)
            for (x, y), gain in zip(self.site.views(self._room(shape)), (500, 400, 300, 200), strict=True)
            if all(np.hypot(x - there[0], y - there[1]) > there[2] for there in (*taken, *avoid))
        ]
        return ViewChoice(tuple(views), len(views))

    def find_doors(self, shape: Any, **_: Any) -> DoorFindings:
        room = self._room(shape)
        passages = self.site.passages.values()
        return DoorFindings(tuple(passage.seen_from(room) for passage in passages if room in passage.rooms))

    def _room(self, shape: Any) -> str:
        if len(shape.contour) < 3:
            raise FailureError("PERC_EXCEPTION", f"{len(shape.contour)} corners are no outline of a room")
        return self.site.room_at(*shape.contour.mean(axis=0))

    def _found(self, scan_id: str, method: str) -> Registration:
        map_from_scanner = self._scanner.taken[scan_id] @ MOUNT
        return Registration(map_from_scanner, 0.95, 0.004, 0.8, 0.2, (0.0, 0.0, 1.0), 0.02, 0.01, method)


class FreeFloor:
    """The run folder of a mission that leaves none: every robot map is free floor."""

    free = 100.0

    def free_gb(self) -> float:
        return self.free

    def scan_file(self, scan_id: str) -> Path:
        return Path(f"{scan_id}.scan")

    def robot_map(self, map_id: str) -> Grid:
        return Grid(np.full((4, 4), Cell.FREE, np.uint8), (-1.0, -1.0), 0.5)


def _receipt(scan_id: str) -> ScanReceipt:
    return ScanReceipt(scan_id, 1_000_000, 12_000_000, "0" * 64, "2026-01-01T00:00:00Z", "2026-01-01T00:00:45Z")
