"""The real tree and executive with real clients and agents on real sockets; only devices and stages act a script.

Every cable between them is a :class:`~tests.drivers.chaos_link.ChaosLink`. Shared by the tests and by
``benchmarks.chaos``.
"""

import json
import time
from collections import Counter
from contextlib import ExitStack, closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from behaviours.services import Services
from behaviours.settings import Settings
from drivers.agent import base_agent, scanner_agent
from drivers.devices import BaseTelemetry
from drivers.interfaces import BaseInfo, DriveGoal, DriveReport, ScannerInfo, ScanSettings
from drivers.jobs import Done, Failed, Outcome, Running
from drivers.lease import NEVER
from drivers.simulated.clock import ScaledClock
from drivers.wire.base_client import BaseClient
from drivers.wire.endpoints import Endpoints
from drivers.wire.scanner_client import ScannerClient
from mission.clock import MissionClock
from mission.executive import Executive
from mission.journal import plain
from mission.operator import Desk
from mission.ownership import ownership
from mission.state import describe
from perception.failure import Failure
from perception.scan import Scan
from perception.transforms import Matrix
from tests.drivers.chaos_link import NONE, ChaosLink, Mischief
from tests.drivers.wire_fakes import ANYWHERE, make_scan
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
    """A :class:`~drivers.devices.ScannerDevice` on that base; its scans are noise, but from a known place."""

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


def fly(folder: Path, seed: str = "", mischief: Mischief = NONE, site: Site | None = None) -> Flown:
    """One mission over links of such mischief."""
    began = time.monotonic()
    script = Script(clock=ScaledClock(1000.0))
    device = BaseAtSite(site or row(2), script)
    scanner_device = ScannerAtSite(device.body, script)
    folder.mkdir(parents=True, exist_ok=True)
    with ExitStack() as stack:
        scanner_up = stack.enter_context(scanner_agent(scanner_device, ANYWHERE, folder / "spool"))
        base_up = stack.enter_context(base_agent(device, ANYWHERE))
        ends = {
            "scanner control": scanner_up.endpoints.control,
            "scanner bulk": scanner_up.endpoints.bulk,
            "base control": base_up.endpoints.control,
            "base telemetry": base_up.endpoints.telemetry,
        }
        links = {
            name: stack.enter_context(ChaosLink(end, f"{seed} {name}", mischief, name == "base telemetry"))
            for name, end in ends.items()
        }
        near = {name: link.endpoint for name, link in links.items()}
        scanner = ScannerClient(Endpoints(near["scanner control"], bulk=near["scanner bulk"]))
        base = BaseClient(Endpoints(near["base control"], telemetry=near["base telemetry"]))
        stack.enter_context(closing(base))
        clock = MissionClock(wait=lambda seconds: time.sleep(seconds / _QUICKER))
        events = Events(clock)
        perception = ScriptedPerception(device.body.site, scanner_device.known, script)
        lease = stack.enter_context(ownership(base))
        services = Services(
            scanner, base, perception, clock, events, Floor(folder), Settings(),
            Desk(clock, events, False), owner=lease.owner,
        )  # fmt: skip
        executive = Executive(create_root(), services, clock, after_tick=lambda _: _still_young(began))
        outcome = executive.run()
        befell = sum((link.befell for link in links.values()), Counter())
    goals = [(goal.goal_id, round(goal.x, 9), round(goal.y, 9)) for goal in device.body.goals]
    survey = describe(executive.survey)
    for scan in survey["scans"]:
        del scan["started"], scan["ended"]  # the only figures that may depend on the day
    result = json.loads(json.dumps([outcome, survey, goals], default=plain))
    executed = device.executed + scanner_device.executed
    return Flown(
        result,
        executed,
        befell,
        [f"{event['code']}: {event['message']}" for event in events.of("failure")],
        time.monotonic() - began,
    )


def _still_young(began: float) -> None:
    assert time.monotonic() < began + _TOO_LONG_S, "this mission does not end"
