"""A passive watch over everything that a mission asks of its devices: it changes nothing, and forgets no breach.

It stands between the executive and the devices, whoever plays them. What a leaf does wrong is put on record here and
not only raised, because a leaf makes an ordinary failure of whatever is raised in it.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, TypeVar

from py_trees.common import Status

from behaviours.services import Journal, Perception, Services
from behaviours.survey import Survey
from drivers.interfaces import Base, BaseState, DriveGoal, Lease, Scanner, ScanReceipt, ScanSettings
from drivers.jobs import Job, Outcome, Running
from mission.executive import Executive
from mission.ledger import JobRow
from mission.phase import DRIVING, ENDED, Phase
from perception.transforms import Matrix

T = TypeVar("T")

_ENDLESS = "this mission does not end"
_NOT_WAITED_FOR = ("stop", "acquire", "release")
"""Orders that stand whether or not anybody hears the answer."""


class WatchedJob:
    """A job of a device: seen to its end, or given up."""

    def __init__(self, monitor: "Monitor", what: str, name: str, job: Job[Any]) -> None:
        self.what = what
        self.name = name
        self.cancelled = False
        self.outcome: Outcome[Any] | None = None
        self._monitor = monitor
        self._job = job

    def __repr__(self) -> str:
        return f"{self.what} {self.name}".strip()

    @property
    def over(self) -> bool:
        return self.cancelled or self.outcome is not None

    def poll(self) -> Outcome[Any]:
        outcome = self._monitor.asking(self._job.poll)
        if not isinstance(outcome, Running) and not self.over:
            self.outcome = outcome
        return outcome

    def cancel(self) -> None:
        self.cancelled = self.outcome is None
        self._job.cancel()


class Monitor:
    """Records every call, and each breach of what must hold at all times and at the end.

    One monitor may watch over several lives of one mission's executive: :meth:`watch` begins each.

    Args:
        most_ticks: a life that takes so many never ends.
    """

    def __init__(self, most_ticks: int = 3000) -> None:
        self.breaches: list[str] = []
        self.rooms_ended: dict[str, tuple[str, str]] = {}
        self.registered: list[str] = []
        self._most_ticks = most_ticks
        self._begin()

    def _begin(self) -> None:
        self.jobs: list[WatchedJob] = []
        self.events: list[tuple[str, dict[str, Any]]] = []
        self.beats: list[int] = []
        self.ordered: list[str] = []
        self.said = "run"
        self.sensed: BaseState | None = None
        self.services: Services | None = None
        self.executive: Executive | None = None
        self._asked: set[tuple[str, str]] = set()

    # --- what it stands between ---------------------------------------------------------------------------------------

    def watch(self, services: Services) -> Services:
        """The same services, watched; a life of an executive begins with them."""
        self._begin()
        self.services = services
        return replace(
            services,
            scanner=_Scanner(self, services.scanner),
            base=_Base(self, services.base),
            perception=_Perception(self, services.perception),
            journal=_Journal(self, services.journal),
        )

    def hearing(self, command: Callable[[], str]) -> Callable[[], str]:
        """The operator's word, on its way to the executive."""

        def heard() -> str:
            self.said = command()
            return self.said

        return heard

    def asking(self, call: Callable[[], T]) -> T:
        """What a device finds wrong with what it is asked is a breach of the executive's, whoever catches it."""
        try:
            return call()
        except AssertionError as broken:
            self.breaches.append(str(broken).partition("\n")[0])
            raise

    def begun(self, what: str, name: str, start: Callable[[], Job[Any]]) -> WatchedJob:
        """A device is asked for something."""
        if what in ("take", "drive"):
            other = "drive" if what == "take" else "take"
            self._expect((what, name) not in self._asked, f"{what} {name} was ordered twice")
            self._asked.add((what, name))
            self._expect(not self._under_way(other), f"{what} {name} was ordered during {self._under_way(other)}")
        if what == "take":
            self._expect(self.sensed is None or not self.sensed.moving, f"{name} was ordered while the base moves")
        if what in ("drive", "stop"):
            self.ordered.append(what)
        job = WatchedJob(self, what, name, self.asking(start))
        self.jobs.append(job)
        return job

    def beaten(self, tick: int, may_move: bool) -> None:
        """The executive says that it is alive, and whether the base may move."""
        self._expect(tick == len(self.beats) + 1, f"beat {tick} came after beat {len(self.beats)}")
        self.beats.append(tick)
        for reason in self._reasons_to_stand() if may_move else ():
            self._expect(False, f"beat {tick} let the base move {reason}")

    def ticked(self, tick: int) -> None:
        """After a tick: the base was told of it, and they come to an end.

        Raises:
            AssertionError: where they do not; put on record before, because the executive ends in a fault by it.
        """
        self._expect(bool(self.beats) and self.beats[-1] == tick, f"tick {tick} had no beat")
        if tick >= self._most_ticks:
            self.breaches.append(_ENDLESS)
            raise AssertionError(_ENDLESS)

    def noted(self, kind: str, figures: dict[str, Any]) -> None:
        """An event has its place in the log."""
        self.events.append((kind, figures))
        if kind == "room_ended":
            self.rooms_ended[figures["room_id"]] = (figures["status"], figures["reason"])
        if kind == "registered":
            self.registered.append(figures["scan_id"])

    def _reasons_to_stand(self) -> list[str]:
        assert self.services is not None and self.executive is not None
        phase, base, settings = self.executive.course.state.phase, self.sensed, self.services.settings
        stands = {
            f"during {self._under_way('take')}": bool(self._under_way("take")),
            f"though the word is {self.said}": self.said != "run",
            f"in the phase {phase}": phase not in DRIVING,
        }
        if base is not None:
            stands |= {
                "with the emergency stop pressed": base.emergency_stop,
                "though the base is lost": base.age > settings.building.base_lost_s,
                "though the base is not its own": base.owner != self.services.owner,
                "without charge": base.battery < settings.battery.critical,
            }
        return [words for words, applies in stands.items() if applies]

    def _under_way(self, what: str) -> list[WatchedJob]:
        return [job for job in self.jobs if job.what == what and not job.over]

    def _expect(self, holds: bool, otherwise: str) -> None:
        if not holds:
            self.breaches.append(otherwise)

    # --- the end ------------------------------------------------------------------------------------------------------

    def assert_kept(self) -> None:
        """Every promise was kept so far."""
        assert self.breaches == [], "; ".join(dict.fromkeys(self.breaches))

    def assert_at_rest(self, rows: list[JobRow]) -> None:
        """What holds on every way out: a declared end, nothing runs, the base stands, nothing lost, all explained.

        Args:
            rows: all of the ledger's jobs.
        """
        assert self.executive is not None
        self.assert_kept()
        assert self.executive.course.state.phase in ENDED, "the mission has no end"
        nodes = list(self.executive.root.iterate())
        assert [node.name for node in nodes if node.status != Status.INVALID] == [], "a node was not stopped"
        assert [job for job in self.jobs if not job.over and job.what not in _NOT_WAITED_FOR] == [], "a job runs on"
        assert self.ordered[-1:] == ["stop"], "the base was not told to stop at the end"
        assert [f"{row.kind} {row.name}" for row in rows if row.ended is None] == [], "a job has no end in the ledger"
        self._assert_log_is_whole()
        self._assert_nothing_is_lost(rows)
        found = unexplained(self.executive, self.said, self.of("failure"))
        assert found == [], "; ".join(found)

    def of(self, kind: str) -> list[dict[str, Any]]:
        """Figures of this life's events of a kind."""
        return [figures for of, figures in self.events if of == kind]

    def _assert_log_is_whole(self) -> None:
        """Each node's changes follow upon each other and end; each room's last end is the one in the survey."""
        shown: dict[str, str] = {}
        for event in self.of("node"):
            assert event["before"] == shown.get(event["path"], "INVALID"), "a change of a node is not in the log"
            shown[event["path"]] = event["after"]
        assert set(shown.values()) <= {"INVALID"}, "the end of a node is not in the log"
        ended = {room.id: (room.status, room.reason) for room in self._survey.building.rooms if room.status != "open"}
        assert self.rooms_ended == ended, "the log tells another end of a room"

    def _assert_nothing_is_lost(self, rows: list[JobRow]) -> None:
        """Every scan with a pose was brought home, has its pose once, and the log tells of each."""
        placed = [scan.scan_id for scan in self._survey.scans]
        assert len(placed) == len(set(placed)), "a scan has two poses"
        home = {row.name for row in rows if row.kind == "fetch" and row.how == "done"}
        assert set(placed) <= home, "a scan has a pose that was never brought home"
        assert set(placed) == set(self.registered), "the scans with a pose are not those in the log"

    @property
    def _survey(self) -> Survey:
        assert self.executive is not None
        return self.executive.survey


def unexplained(executive: Executive, said: str, failures: list[dict[str, Any]]) -> list[str]:
    """What a mission left undone without naming a cause that it met."""
    survey, state = executive.survey, executive.course.state
    met = {str(event["code"]) for event in failures} | {"views_blocked", "max_scans"}
    rooms, doors = survey.building.rooms, survey.building.doors
    found = [f"{room.id}: {room.reason or 'no reason'}" for room in rooms if _is_short(room.status, room.reason, met)]
    found += [f"{edge.id}: {edge.reason or 'no reason'}" for edge in doors if _is_short(edge.state, edge.reason, met)]
    match state.phase:
        case Phase.DONE:
            found += [f"{room.id} is {room.status}" for room in rooms if room.status != "complete"]
        case Phase.INCOMPLETE:
            found += [f"{room.id} is still open" for room in rooms if room.status == "open"]
            shortfalls = [room for room in rooms if room.status == "partial"]
            refused = [edge for edge in doors if edge.state == "refused"]
            found += [] if shortfalls or refused or "MAX_ROOMS" in met else ["incomplete without a shortfall"]
        case Phase.ABORTED:
            held = state.code == "SAFETY_STOP" and met & {
                "ESTOP", "BASE_LOST", "LEASE_LOST", "BASE_ROGUE", "GEOFENCE", "DISK_FULL", "BATTERY_CRITICAL",
            }  # fmt: skip
            found += [] if held or said == "abort" else ["aborted by nobody"]
        case Phase.FAULT:
            found += [] if any(event["leaf"] == "tick" for event in failures) else ["a fault without an error"]
    return found


def _is_short(status: str, reason: str, met: set[str]) -> bool:
    return status in ("partial", "refused") and reason not in met


class _Scanner:
    def __init__(self, monitor: Monitor, scanner: Scanner) -> None:
        self._monitor = monitor
        self._scanner = scanner

    def __getattr__(self, name: str) -> Any:
        return getattr(self._scanner, name)

    def take(self, scan_id: str, settings: ScanSettings, odom_from_base: Matrix) -> Job[ScanReceipt]:
        return self._monitor.begun("take", scan_id, lambda: self._scanner.take(scan_id, settings, odom_from_base))

    def fetch(self, receipt: ScanReceipt, destination: Any) -> Job[Any]:
        name = str(getattr(receipt, "scan_id", receipt))
        return self._monitor.begun("fetch", name, lambda: self._scanner.fetch(receipt, destination))


class _Base:
    def __init__(self, monitor: Monitor, base: Base) -> None:
        self._monitor = monitor
        self._base = base

    def __getattr__(self, name: str) -> Any:
        return getattr(self._base, name)

    def state(self) -> BaseState | None:
        self._monitor.sensed = self._base.state()
        return self._monitor.sensed

    def drive(self, goal: DriveGoal) -> Job[Any]:
        return self._monitor.begun("drive", goal.goal_id, lambda: self._base.drive(goal))

    def stop(self) -> Job[None]:
        return self._monitor.begun("stop", "", self._base.stop)

    def acquire(self, owner: str) -> Job[Lease]:
        return self._monitor.begun("acquire", owner, lambda: self._base.acquire(owner))

    def release(self) -> Job[None]:
        return self._monitor.begun("release", "", self._base.release)

    def beat(self, tick: int, may_move: bool) -> None:
        self._monitor.beaten(tick, may_move)
        self._monitor.asking(lambda: self._base.beat(tick, may_move))


class _Perception:
    def __init__(self, monitor: Monitor, perception: Perception) -> None:
        self._monitor = monitor
        self._perception = perception

    def submit(self, stage: str, /, **arguments: Any) -> Job[Any]:
        name = str(arguments.get("scan_id") or arguments.get("room_id") or "")
        return self._monitor.begun(stage, name, lambda: self._perception.submit(stage, **arguments))


class _Journal:
    def __init__(self, monitor: Monitor, journal: Journal) -> None:
        self._monitor = monitor
        self._journal = journal

    def record(self, kind: str, /, **figures: object) -> None:
        self._journal.record(kind, **figures)
        self._monitor.noted(kind, figures)
