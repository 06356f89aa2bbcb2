"""The real tree and executive with real clients and agents on real sockets; only devices and stages act a script.

Every cable between them is a :class:`~tests.drivers.chaos_link.ChaosLink`. Shared by the tests and by
``benchmarks.chaos``.
"""

import json
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from behaviours.services import Services
from behaviours.settings import Settings
from behaviours.survey import Survey
from drivers.agent import base_agent, scanner_agent
from drivers.devices import BaseTelemetry
from drivers.interfaces import BaseInfo, DriveGoal, DriveReport, ScannerInfo, ScanSettings
from drivers.jobs import Done, Failed, Outcome, Running
from drivers.lease import NEVER
from drivers.simulated.clock import ScaledClock
from drivers.wire.base_client import BaseClient
from drivers.wire.endpoints import Endpoints
from drivers.wire.scanner_client import ScannerClient
from mission.chronicle import Chronicle
from mission.clock import MissionClock
from mission.executive import Executive
from mission.journal import plain
from mission.ledger import Ledger
from mission.operator import Desk
from mission.ownership import ownership
from mission.remembering import remembering
from mission.state import describe
from perception.failure import Failure
from perception.scan import Scan
from perception.transforms import Matrix
from tests.drivers.chaos_link import NONE, ChaosLink, Mischief
from tests.drivers.wire_fakes import ANYWHERE, make_scan
from tests.scenarios.monitor import Monitor
from tests.scenarios.play import Events
from tests.scenarios.scripted import (
    ODOM_FROM_MAP,
    FreeFloor,
    Script,
    ScriptedBase,
    ScriptedJob,
    ScriptedPerception,
    ScriptedScanner,
)
from tests.scenarios.site import Site, row
from trees.building import create_root

POINTS = 120_000
"""Of a scan, so that its file takes several chunks to come home."""
_QUICKER = 5
"""Ticks of the loop in one of the real executive: messages cross each other as often, and nobody has to wait."""
_TOO_LONG_S = 240.0
_MOST_TICKS = 20_000


class BaseAtSite:
    """A :class:`~drivers.devices.BaseDevice` that drives through a site, while it may, and counts what it is told."""

    def __init__(self, site: Site, script: Script) -> None:
        self.body = ScriptedBase(site, script)
        self.executed: Counter[str] = Counter()
        self._jobs: dict[str, ScriptedJob] = {}
        self._permitted_until = NEVER

    def info(self) -> BaseInfo:
        return BaseInfo("wired", "0002", 1, (0.9, 0.6))

    def permit(self, until: float) -> None:
        self._permitted_until = until

    def telemetry(self) -> BaseTelemetry:
        return BaseTelemetry(ODOM_FROM_MAP @ self.body.map_from_base, None, self._moving, False, 0.9, "idle")

    def start_drive(self, goal: DriveGoal) -> None:
        self.executed[goal.goal_id] += 1
        self._jobs[goal.goal_id] = self.body.drive(goal)

    def drive_status(self, goal_id: str) -> Outcome[DriveReport] | None:
        job = self._jobs.get(goal_id)
        if job is None:
            return None
        if job.cancelled:
            return Failed(Failure("CANCELLED", "stopped by order", {"track": [], "distance": 0.0}))
        return job.poll() if time.monotonic() < self._permitted_until else job.outcome or Running(None, "held")

    def stop(self) -> None:
        for job in self._jobs.values():
            job.cancel()

    @property
    def _moving(self) -> bool:
        return any(not job.over for job in self._jobs.values())


class ScannerAtSite:
    """A :class:`~drivers.devices.ScannerDevice` there; it knows where each scan was taken, and delivers noise."""

    def __init__(self, base: ScriptedBase, script: Script) -> None:
        self.known = ScriptedScanner(base, script)
        self.executed: Counter[str] = Counter()
        self._jobs: dict[str, ScriptedJob] = {}

    def info(self) -> ScannerInfo:
        return ScannerInfo("wired", "0001", 1)

    def start(self, scan_id: str, settings: ScanSettings, odom_from_base: Matrix) -> None:
        self.executed[scan_id] += 1
        self._jobs[scan_id] = self.known.take(scan_id, settings, odom_from_base)

    def status(self, scan_id: str) -> Outcome[Scan] | None:
        job = self._jobs.get(scan_id)
        if job is None:
            return None
        if job.cancelled:
            return Failed(Failure("SCAN_ABORTED", "it was aborted"))
        outcome = job.poll()
        return Done(make_scan(scan_id, POINTS, seed=int(scan_id[1:]))) if isinstance(outcome, Done) else outcome

    def abort(self, scan_id: str) -> None:
        if scan_id in self._jobs:
            self._jobs[scan_id].cancel()


class Floor(FreeFloor):
    """A free floor whose scans are files."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def scan_file(self, scan_id: str) -> Path:
        return self._folder / f"{scan_id}.scan"


@dataclass(frozen=True)
class Flown:
    """A mission that has ended.

    Args:
        result: what no link may change: outcome, rooms, doors, map, goals, scans with their poses and hashes.
        executed: how often each goal was driven and each scan taken.
        befell: what became of how many messages.
        failures: code and message of each, in their order.
    """

    result: Any
    executed: Counter[str]
    befell: Counter[str]
    failures: list[str]
    seconds: float

    @property
    def twice(self) -> list[str]:
        """Goals and scans that were executed more than once."""
        return [name for name, count in self.executed.items() if count > 1]


@dataclass(frozen=True)
class Rig:
    """Both devices with their agents, and the links that an executive reaches them by."""

    base: BaseAtSite
    scanner: ScannerAtSite
    links: dict[str, ChaosLink]

    @classmethod
    @contextmanager
    def up(cls, folder: Path, script: Script, seed: str, mischief: Mischief) -> Iterator["Rig"]:
        """All of it up; the scanner's own disk is in the folder."""
        base = BaseAtSite(row(2), script)
        scanner = ScannerAtSite(base.body, script)
        with ExitStack() as stack:
            scanner_up = stack.enter_context(scanner_agent(scanner, ANYWHERE, folder / "spool")).endpoints
            base_up = stack.enter_context(base_agent(base, ANYWHERE)).endpoints
            ends = {
                "scanner control": scanner_up.control,
                "scanner bulk": scanner_up.bulk,
                "base control": base_up.control,
                "base telemetry": base_up.telemetry,
            }
            links = {
                name: stack.enter_context(ChaosLink(end, f"{seed} {name}", mischief, name == "base telemetry"))
                for name, end in ends.items()
            }
            yield cls(base, scanner, links)

    def scanner_client(self) -> ScannerClient:
        return ScannerClient(Endpoints(self._near("scanner control"), bulk=self._near("scanner bulk")))

    def base_client(self) -> BaseClient:
        return BaseClient(Endpoints(self._near("base control"), telemetry=self._near("base telemetry")))

    @property
    def executed(self) -> Counter[str]:
        return self.base.executed + self.scanner.executed

    @property
    def befell(self) -> Counter[str]:
        return sum((link.befell for link in self.links.values()), Counter())

    def _near(self, link: str) -> str:
        return self.links[link].endpoint


def fly(folder: Path, seed: str = "", mischief: Mischief = NONE) -> Flown:
    """One mission over links of such mischief.

    Raises:
        AssertionError: where it takes too long, or ends in a fault.
    """
    began = time.monotonic()
    script = Script(clock=ScaledClock(1000.0))
    clock = MissionClock(wait=lambda seconds: time.sleep(seconds / _QUICKER))
    events = Events(clock)
    folder.mkdir(parents=True, exist_ok=True)
    with Rig.up(folder, script, seed, mischief) as rig:
        with closing(rig.base_client()) as base, ownership(base) as lease:
            perception = ScriptedPerception(rig.base.body.site, rig.scanner.known, script)
            services = Services(
                rig.scanner_client(), base, perception, clock, events, Floor(folder), Settings(),
                Desk(clock, events, False), owner=lease.owner,
            )  # fmt: skip
            outcome, executive = _watched(services, clock, began)
        befell = rig.befell
    assert outcome != "fault", str(executive.course.state)
    failures = [f"{event['code']}: {event['message']}" for event in events.of("failure")]
    result = _whatever_the_links(outcome, executive.survey, rig.base.body.goals)
    return Flown(result, rig.executed, befell, failures, time.monotonic() - began)


def _watched(services: Services, clock: MissionClock, began: float) -> tuple[str, Executive]:
    """One mission, remembered as ``mission run`` does, with a watch over all that it asks of its devices."""
    monitor = Monitor(_MOST_TICKS)

    def after_tick(tick: int) -> None:
        monitor.ticked(tick)
        assert time.monotonic() < began + _TOO_LONG_S, "this mission does not end"

    with closing(Ledger(Path(":memory:"))) as ledger:
        watched = remembering(monitor.watch(services), Chronicle(ledger, clock))
        command = monitor.hearing(lambda: "run")
        executive = Executive(create_root(services.settings), watched, clock, command, after_tick)
        monitor.executive = executive
        outcome = executive.run()
        monitor.assert_at_rest(ledger.jobs())
    return outcome, executive


def _whatever_the_links(outcome: str, survey: Survey, goals: list[DriveGoal]) -> Any:
    """What a mission came to, but for the figures that may depend on the day."""
    told = describe(survey)
    for scan in told["scans"]:
        del scan["started"], scan["ended"]
    places = [(goal.goal_id, round(goal.x, 9), round(goal.y, 9)) for goal in goals]
    return json.loads(json.dumps([outcome, told, places], default=plain))
