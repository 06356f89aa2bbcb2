"""Devices without a body and a link that misbehaves, for the tests of the wire."""

import threading
import time
from collections.abc import Callable

import numpy as np
import zmq

from drivers.agent import Agent
from drivers.devices import BaseTelemetry
from drivers.interfaces import BaseInfo, DriveGoal, DriveReport, ScannerInfo, ScanSettings, SelfTest
from drivers.jobs import Done, Failed, Job, Outcome, Running
from drivers.wire.client import Patience
from drivers.wire.endpoints import Endpoints
from perception import transforms
from perception.failure import Failure, FailureError
from perception.grids import Cell, Grid
from perception.scan import BeamPattern, Scan
from perception.transforms import Matrix

ANY_PORT = "tcp://127.0.0.1:*"
ANYWHERE = Endpoints(ANY_PORT, bulk=ANY_PORT, telemetry=ANY_PORT)
QUICK = Patience(first=0.1, longest=0.3, total=20.0)
"""Asks again soon, but does not give up because the machine is busy with other tests."""
IMPATIENT = Patience(first=0.1, longest=0.3, total=1.0)
SETTINGS = ScanSettings(step=0.02)


def make_scan(scan_id: str = "S01", points: int = 1000, seed: int = 0) -> Scan:
    """Noise in the shape of a scan."""
    random = np.random.default_rng(seed)
    pattern = BeamPattern(max(4, points), 2, -0.7, 1.0, 1.5, 120.0)
    return Scan(
        scan_id,
        random.normal(0, 5, (points, 3)).astype(np.float32),
        random.random(points, np.float32),
        np.sort(random.choice(pattern.size, points, replace=False)).astype(np.int32),
        pattern,
        transforms.from_euler(0.01, -0.02, 2.0, (1.0, 2.0, 0.0)),
        transforms.from_euler(0.0, 0.0, 0.0, (0.0, 0.0, 1.3)),
    )


def make_goal(goal_id: str = "G01") -> DriveGoal:
    cells = np.full((60, 80), Cell.UNKNOWN, np.uint8)
    cells[10:50, 10:70] = Cell.FREE
    return DriveGoal(
        goal_id, Grid(cells, (-1.5, -2.0), 0.05), "M01", transforms.planar(0.5, 0.2, 0.1), x=1.0, y=0.5, yaw=None
    )


def outcome_of(job: Job, seconds: float = 20.0) -> Done | Failed:
    """Wait for the end of a job."""
    end = time.monotonic() + seconds
    while isinstance(outcome := job.poll(), Running):
        assert time.monotonic() < end, f"still {outcome}"
        time.sleep(0.005)
    return outcome


def value_of(job: Job, seconds: float = 20.0):
    outcome = outcome_of(job, seconds)
    assert isinstance(outcome, Done), outcome
    return outcome.value


def failure_of(job: Job, seconds: float = 20.0) -> Failure:
    outcome = outcome_of(job, seconds)
    assert isinstance(outcome, Failed), outcome
    return outcome.failure


def eventually(condition: Callable[[], object], seconds: float = 20.0) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it never came true"
        time.sleep(0.005)


def restarted(serve: Callable[[], Agent], seconds: float = 20.0) -> Agent:
    """An agent at the address of one that was just closed; ZeroMQ lets go of a port a little later."""
    end = time.monotonic() + seconds
    while True:
        try:
            return serve()
        except FailureError as error:
            assert error.failure.code == "ENDPOINT_UNAVAILABLE" and time.monotonic() < end
            time.sleep(0.01)


class FakeScanner:
    """Scans for ``duration`` seconds, then gives ``make_scan`` or the failure it is told to give."""

    def __init__(self, duration: float = 0.1, points: int = 1000) -> None:
        self.duration = duration
        self.points = points
        self.fails_with: Failure | None = None
        self.complaints: tuple[str, ...] = ()
        self.started: list[str] = []
        self.aborted: list[str] = []
        self.odometry: list[Matrix] = []
        self._since: dict[str, float] = {}

    def info(self) -> ScannerInfo:
        return ScannerInfo("fake", "0001", 1)

    def self_test(self) -> SelfTest:
        return SelfTest(self.complaints, {"temperature_c": 30.5})

    def start(self, scan_id: str, settings: ScanSettings, odom_from_base: Matrix) -> None:
        self.started.append(scan_id)
        self.odometry.append(odom_from_base)
        self._since[scan_id] = time.monotonic()

    def status(self, scan_id: str) -> Outcome[Scan] | None:
        if scan_id not in self._since:
            return None
        if scan_id in self.aborted:
            return Failed(Failure("SCAN_ABORTED", "it was aborted"))
        fraction = (time.monotonic() - self._since[scan_id]) / self.duration
        if fraction < 1:
            return Running(fraction, "scanning")
        return Failed(self.fails_with) if self.fails_with else Done(make_scan(scan_id, self.points))

    def abort(self, scan_id: str) -> None:
        self.aborted.append(scan_id)


class FakeBase:
    """Drives for ``duration`` seconds; thinks in ``start_drive`` for as long as ``may_start`` is not set."""

    def __init__(self, duration: float = 0.1) -> None:
        self.duration = duration
        self.may_start = threading.Event()
        self.may_start.set()
        self.asked: list[str] = []
        self.refuses: FailureError | None = None
        self.driven: list[DriveGoal] = []
        self.stops = 0
        self.permits: list[float] = []
        self.pose = transforms.planar(1.0, 2.0, 0.5)
        self.in_map: Matrix | None = None
        self.current: str | None = None
        self._since: dict[str, float] = {}
        self._stopped: set[str] = set()

    def info(self) -> BaseInfo:
        return BaseInfo("fake base", "0002", 1, (0.9, 0.6))

    def telemetry(self) -> BaseTelemetry:
        return BaseTelemetry(self.pose, self.in_map, self.current is not None, False, 0.75, "idle")

    def permit(self, until: float) -> None:
        self.permits.append(until)

    def start_drive(self, goal: DriveGoal) -> None:
        if self.refuses:
            raise self.refuses
        self.asked.append(goal.goal_id)
        self.may_start.wait()
        self.driven.append(goal)
        self.current = goal.goal_id
        self._since[goal.goal_id] = time.monotonic()

    def drive_status(self, goal_id: str) -> Outcome[DriveReport] | None:
        if goal_id not in self._since:
            return None
        if goal_id in self._stopped:
            return Failed(Failure("NAV_STOPPED", "stopped", {"track": [[0.0, 0.0, 0.0]]}))
        if time.monotonic() - self._since[goal_id] < self.duration:
            return Running(None, "driving")
        self.current = None
        return Done(DriveReport(goal_id, transforms.planar(1.0, 0.5, 0.0), ((0.0, 0.0, 0.0), (1.0, 0.5, 0.0)), 1.1))

    def stop(self) -> None:
        self.stops += 1
        if self.current is not None:
            self._stopped.add(self.current)
        self.current = None


Rule = Callable[[int, bytes], list[bytes]]


def passes(number: int, frame: bytes) -> list[bytes]:
    return [frame]


class Proxy:
    """A link between clients and an agent that loses, repeats and garbles messages by rule.

    A rule is given the running number of a message in its direction and its bytes, and returns what goes on.
    """

    def __init__(self, target: str, to_agent: Rule = passes, to_client: Rule = passes) -> None:
        context = zmq.Context.instance()
        self._front, self._back = context.socket(zmq.ROUTER), context.socket(zmq.DEALER)
        for socket in (self._front, self._back):
            socket.setsockopt(zmq.LINGER, 0)
        self._front.bind(ANY_PORT)
        self.endpoint = self._front.get_string(zmq.LAST_ENDPOINT).rstrip("\0")
        self._back.connect(target)
        self.to_agent, self.to_client = to_agent, to_client
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def __enter__(self) -> "Proxy":
        return self

    def __exit__(self, *exception: object) -> None:
        self._closing.set()
        self._thread.join()

    def _run(self) -> None:
        poller = zmq.Poller()
        poller.register(self._front, zmq.POLLIN)
        poller.register(self._back, zmq.POLLIN)
        numbers = {self._front: 0, self._back: 0}
        with self._front, self._back:
            while not self._closing.is_set():
                for source, _ in poller.poll(20):
                    *route, frame = source.recv_multipart()
                    target, rule = (
                        (self._back, self.to_agent) if source is self._front else (self._front, self.to_client)
                    )
                    for passed in rule(numbers[source], frame):
                        target.send_multipart([*route, passed])
                    numbers[source] += 1
