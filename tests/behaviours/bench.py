"""A bench for single leaves: services that do nothing by themselves, and jobs that are finished by hand."""

from types import SimpleNamespace
from typing import Any

import numpy as np
from py_trees.behaviour import Behaviour
from py_trees.blackboard import Blackboard
from py_trees.common import Status

from behaviours.keys import Key
from behaviours.services import Services
from behaviours.survey import CurrentScan, ScanRecord, Survey
from drivers.interfaces import BaseState, ScanReceipt
from drivers.jobs import Done, Failed, Outcome, Running
from drivers.simulated.clock import VirtualClock
from perception import transforms
from perception.failure import Failure
from perception.findings import Alignment, Registration


class HandJob:
    """A job that ends when the test says so."""

    def __init__(self) -> None:
        self.outcome: Outcome[Any] = Running()
        self.cancelled = 0

    def poll(self) -> Outcome[Any]:
        return self.outcome

    def cancel(self) -> None:
        self.cancelled += 1

    def done(self, value: object = None) -> None:
        self.outcome = Done(value)

    def failed(self, code: str, **evidence: object) -> None:
        self.outcome = Failed(Failure(code, "by hand", evidence))


class Bench:
    """Services whose every call is noted in ``calls`` and answered by a :class:`HandJob` in ``jobs``."""

    def __init__(self) -> None:
        self.clock = VirtualClock()
        self.calls: list[tuple[str, tuple[Any, ...], dict[str, Any]]] = []
        self.jobs: list[HandJob] = []
        self.events: list[dict[str, Any]] = []
        self.base_state: BaseState | None = standing()
        scanner = SimpleNamespace(take=self._call("take"), fetch=self._call("fetch"))
        self.beats: list[tuple[int, bool]] = []
        base = SimpleNamespace(
            acquire=self._call("acquire"),
            beat=lambda tick, may_move: self.beats.append((tick, may_move)),
            release=self._call("release"),
            drive=self._call("drive"),
            stop=self._call("stop"),
            state=lambda: self.base_state,
        )
        perception = SimpleNamespace(submit=self._call("submit"))
        journal = SimpleNamespace(record=lambda kind, /, **figures: self.events.append({"kind": kind, **figures}))
        self.free_gb = 100.0
        files = SimpleNamespace(
            scan_file=lambda scan_id: f"{scan_id}.scan", robot_map=lambda map_id: map_id, free_gb=lambda: self.free_gb
        )
        self.services = Services(scanner, base, perception, self.clock, journal, files)

    def set_up(self, *leaves: Behaviour) -> None:
        for leaf in leaves:
            for node in leaf.iterate():
                node.setup(services=self.services)

    @property
    def job(self) -> HandJob:
        return self.jobs[-1]

    @property
    def codes(self) -> list[str]:
        return [event["code"] for event in self.events if event["kind"] == "failure"]

    def _call(self, name: str) -> Any:
        def call(*args: Any, **kwargs: Any) -> HandJob:
            self.calls.append((name, args, kwargs))
            self.jobs.append(HandJob())
            return self.job

        return call


def put(**values: object) -> None:
    """Write to the blackboard as if a leaf had."""
    for name, value in values.items():
        Blackboard.set(Key[name], value)


def get(key: Key) -> Any:
    return Blackboard.get(key) if Blackboard.exists(key) else None


def tick(node: Behaviour) -> Status:
    node.tick_once()
    return node.status


def standing(x: float = 0.0, y: float = 0.0, yaw: float = 0.0, **other: Any) -> BaseState:
    values = {"map_from_base": None, "moving": False, "emergency_stop": False, "battery": 1.0, "activity": "idle"}
    return BaseState(**{**values, "odom_from_base": transforms.planar(x, y, yaw), "age": 0.0, **other})


MOUNT = transforms.from_euler(0, 0, 0, (0, 0, 1.3))
LEVEL = Alignment(MOUNT, 0.0, 0.0, 1.3, 3.0, 0.0, 0.3)


def receipt(scan_id: str) -> ScanReceipt:
    return ScanReceipt(scan_id, 1000, 12_000, "0" * 64, "2026-01-01T00:00:00Z", "2026-01-01T00:00:45Z")


def placed(x: float = 0.0, y: float = 0.0, method: str = "icp") -> Registration:
    pose = transforms.from_euler(0, 0, 0, (x, y, 1.3))
    return Registration(pose, 0.9, 0.004, 0.7, 0.2, (0, 0, 1), 0.01, 0.001, method)


def scan(scan_id: str, x: float = 0.0, y: float = 0.0, room_id: str = "R1") -> ScanRecord:
    """A registered scan; odometry and map agree."""
    at = transforms.planar(x, y, 0.0)
    return ScanRecord(scan_id, room_id, placed(x, y).map_from_scanner, at, at, 1000, receipt(scan_id), LEVEL, placed())


def current(scan_id: str, guess: np.ndarray | None, distance: float = 0.0) -> CurrentScan:
    return CurrentScan(scan_id, np.eye(4), guess, distance, receipt(scan_id), MOUNT, 1000, LEVEL)


def survey_of(*scans: ScanRecord, **changes: Any) -> Survey:
    survey = Survey(map_id="map_1", **changes)
    for record in scans:
        survey = survey.with_scan(record)
    return survey
