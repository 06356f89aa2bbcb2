"""A scanner over real sockets: each scan is taken once, whatever the link and the processes do."""

import shutil
import threading
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from drivers import scan_file
from drivers.agent import Agent, scanner_agent, serve_scanner
from drivers.interfaces import ScannerInfo
from drivers.jobs import Progress, Running
from drivers.messages import PROTOCOL, Ok, Release
from drivers.wire import introduction, scanner_server
from drivers.wire.client import Link
from drivers.wire.endpoints import Endpoints
from drivers.wire.scanner_client import ScannerClient
from drivers.wire.sockets import Sockets
from perception import transforms
from perception.failure import Failure, FailureError
from tests.drivers.wire_fakes import (
    ANYWHERE,
    IMPATIENT,
    QUICK,
    SETTINGS,
    FakeScanner,
    Proxy,
    eventually,
    failure_of,
    make_scan,
    restarted,
    value_of,
)

ODOMETRY = transforms.planar(1.0, 2.0, 0.3)


@pytest.fixture
def device() -> FakeScanner:
    return FakeScanner()


@pytest.fixture
def agent(device, tmp_path):
    with scanner_agent(device, ANYWHERE, tmp_path / "spool") as agent:
        yield agent


@pytest.fixture
def client(agent) -> ScannerClient:
    return ScannerClient(agent.endpoints, QUICK)


def test_a_scan_is_taken_fetched_and_released(device, client, tmp_path):
    receipt = value_of(client.take("S01", SETTINGS, ODOMETRY))
    assert (receipt.scan_id, receipt.points, device.started) == ("S01", 1000, ["S01"])
    np.testing.assert_allclose(device.odometry[0], ODOMETRY, atol=1e-12)
    assert receipt.started < receipt.ended
    path = value_of(client.fetch(receipt, tmp_path / "scans" / "S01.scan"))
    assert path.read_bytes() == scan_file.encode(make_scan("S01"))
    eventually(lambda: not (tmp_path / "spool" / "S01.scan").exists())


def test_each_mission_has_scans_of_its_own_by_the_same_names(device, agent, tmp_path):
    for mission in ("first", "second"):
        client = ScannerClient(agent.endpoints, QUICK, mission=mission)
        receipt = value_of(client.take("S01", SETTINGS, ODOMETRY))
        assert receipt.scan_id == "S01"
        path = value_of(client.fetch(receipt, tmp_path / mission / "S01.scan"))
        assert scan_file.read(path).scan_id == f"{mission}.S01"
    assert device.started == ["first.S01", "second.S01"]


def test_only_the_very_scan_that_is_safe_elsewhere_is_forgotten(client, agent, tmp_path):
    receipt = value_of(client.take("S01", SETTINGS, ODOMETRY))
    with Link(Sockets(), agent.endpoints.control, QUICK, Progress()) as link:
        link.ask(Release("S01", "0" * 64), Ok)
        assert (tmp_path / "spool" / "S01.scan").exists()
        link.ask(Release("S01", receipt.sha256), Ok)
        assert not (tmp_path / "spool" / "S01.scan").exists()


def test_the_scanner_says_who_it_is(client):
    assert value_of(client.info()) == ScannerInfo("fake", "0001", PROTOCOL)


def test_the_scanner_tells_how_it_is_and_its_agent_how_much_room_there_is(device, client, tmp_path):
    found = value_of(client.self_test())
    assert (found.faults, found.figures["temperature_c"]) == ((), 30.5)
    free = shutil.disk_usage(tmp_path).free / 1e9
    assert found.figures["storage_free_gb"] == pytest.approx(free, rel=0.1)
    device.complaints = ("the mirror does not reach its speed", "x" * 1000)
    assert value_of(client.self_test()).faults == ("the mirror does not reach its speed", "x" * 256)


def test_how_far_its_clock_is_off_is_found_by_the_shortest_round_trip(agent, monkeypatch):
    begun = time.time() - time.monotonic()
    monkeypatch.setattr(scanner_server, "time", SimpleNamespace(time=lambda: begun + time.monotonic() + 100.0))
    late = iter([0.3, 0.2, 0.0])

    def slow(number: int, frame: bytes) -> list[bytes]:
        time.sleep(next(late, 0.25))
        return [frame]

    found, asked = [], introduction._asked
    monkeypatch.setattr(introduction, "_asked", lambda *of: found.append(asked(*of)) or found[-1])
    with Proxy(agent.endpoints.control, to_client=slow) as proxy:
        clock = value_of(ScannerClient(Endpoints(proxy.endpoint, agent.endpoints.bulk)).info()).clock
    trips = [offset.uncertainty for _, offset in found]
    assert sorted(trips)[1] >= 0.1, "half of the second shortest delay"
    assert clock.uncertainty == min(trips)
    assert abs(clock.seconds - 100.0) <= clock.uncertainty + 0.01
    assert 100.0 - 2 * clock.uncertainty - 0.01 <= clock.certain <= 100.01


def test_a_scanner_whose_scans_could_not_be_fetched_is_unreachable(agent):
    nobody = Endpoints(agent.endpoints.control, "tcp://127.0.0.1:1")
    failure = failure_of(ScannerClient(nobody, IMPATIENT).info())
    assert failure.code == "AGENT_UNREACHABLE"
    assert "127.0.0.1:1" in failure.message


def test_a_clock_that_is_right_is_found_right(client):
    clock = value_of(client.info()).clock
    assert abs(clock.seconds) <= clock.uncertainty + 0.005


def test_progress_reaches_the_client(device, client):
    device.duration = 0.5
    job, seen = client.take("S01", SETTINGS, ODOMETRY), []
    eventually(lambda: seen.append(job.poll()) or not isinstance(seen[-1], Running))
    fractions = {outcome.fraction for outcome in seen if isinstance(outcome, Running)} - {None}
    assert len(fractions) > 3 and max(fractions) > 0.5


def test_the_same_name_is_taken_once_by_two_clients_and_later(device, agent, client):
    jobs = [
        client.take("S01", SETTINGS, ODOMETRY),
        ScannerClient(agent.endpoints, QUICK).take("S01", SETTINGS, ODOMETRY),
    ]
    receipts = {value_of(job) for job in jobs} | {value_of(client.take("S01", SETTINGS, ODOMETRY))}
    assert len(receipts) == 1 and device.started == ["S01"]


def test_a_failure_of_the_device_comes_out_of_the_job_and_the_name_is_free_again(device, client):
    device.fails_with = Failure("SCAN_REJECTED", "too hot", {"celsius": 61.5})
    assert failure_of(client.take("S01", SETTINGS, ODOMETRY)) == device.fails_with
    device.fails_with = None
    assert value_of(client.take("S01", SETTINGS, ODOMETRY)).points == 1000


def test_an_exception_of_the_device_is_a_failure_and_the_agent_goes_on(device, client):
    device.info = lambda: 1 / 0
    assert failure_of(client.info()).code == "AGENT_EXCEPTION"
    device.start = lambda *_: 1 / 0
    assert failure_of(client.take("S01", SETTINGS, ODOMETRY)).code == "DRIVER_EXCEPTION"
    assert failure_of(client.info()).code == "AGENT_EXCEPTION"


def test_cancelling_aborts_the_scan(device, client):
    device.duration = 30.0
    job = client.take("S01", SETTINGS, ODOMETRY)
    eventually(lambda: device.started)
    job.cancel()
    assert failure_of(job).code == "CANCELLED"
    assert set(device.aborted) == {"S01"}


def test_a_device_that_forgets_its_scan_is_not_waited_for(device, client):
    device.duration = 30.0
    job = client.take("S01", SETTINGS, ODOMETRY)
    eventually(lambda: device.started)
    device.status = lambda scan_id: None
    assert failure_of(job).code == "DEVICE_FORGOT"


@pytest.mark.parametrize("in_the_way", ["S01.scan.tmp", "S01.json"])
def test_a_scan_that_cannot_be_put_on_the_shelf_or_found_there_is_named(client, tmp_path, in_the_way):
    (tmp_path / "spool" / in_the_way).mkdir(parents=True)
    failure = failure_of(client.take("S01", SETTINGS, ODOMETRY))
    assert failure.code == "SPOOL_FAILED" and "S01" in failure.evidence["file"]


def test_a_request_that_makes_no_sense_is_refused_with_the_reason(client):
    failure = failure_of(client.take("../S01", SETTINGS, ODOMETRY))
    assert failure.code == "BAD_MESSAGE" and "scan_id" in failure.message


def test_an_agent_that_comes_late_is_found(device, tmp_path):
    with Proxy("tcp://127.0.0.1:1") as nobody:  # only to get a port that is free
        endpoint = nobody.endpoint
    job = ScannerClient(Endpoints(endpoint, endpoint), QUICK).take("S01", SETTINGS, ODOMETRY)
    threading.Event().wait(0.4)
    with restarted(lambda: scanner_agent(device, Endpoints(endpoint, ANYWHERE.bulk), tmp_path)):
        assert value_of(job).scan_id == "S01"


def test_a_silent_agent_is_unreachable_within_its_deadline():
    job = ScannerClient(Endpoints("tcp://127.0.0.1:1", "tcp://127.0.0.1:1"), IMPATIENT).take("S01", SETTINGS, ODOMETRY)
    failure = failure_of(job, IMPATIENT.total + 1.0)
    assert failure.code == "AGENT_UNREACHABLE" and "127.0.0.1:1" in failure.message


def test_an_agent_that_restarts_during_a_scan_takes_it_again_by_the_same_name(tmp_path):
    first, second = FakeScanner(duration=30.0), FakeScanner()
    agent = scanner_agent(first, ANYWHERE, tmp_path)
    job = ScannerClient(agent.endpoints, QUICK).take("S01", SETTINGS, ODOMETRY)
    eventually(lambda: first.started)
    agent.close()
    assert first.aborted == ["S01"]
    with restarted(lambda: scanner_agent(second, agent.endpoints, tmp_path)):
        assert value_of(job).scan_id == "S01"
    assert second.started == ["S01"]


def test_a_stored_scan_survives_a_restart_and_is_not_taken_again(device, agent, client, tmp_path):
    receipt = value_of(client.take("S01", SETTINGS, ODOMETRY))
    agent.close()
    second = FakeScanner()
    with restarted(lambda: scanner_agent(second, agent.endpoints, tmp_path / "spool")):
        assert value_of(client.take("S01", SETTINGS, ODOMETRY)) == receipt
        value_of(client.fetch(receipt, tmp_path / "S01.scan"))
        assert value_of(client.take("S01", SETTINGS, ODOMETRY)) == receipt, "the name outlives its data"
    assert second.started == []


def test_a_scan_that_could_not_be_kept_is_not_started(device, client, monkeypatch):
    monkeypatch.setattr("shutil.disk_usage", lambda _: type("Usage", (), {"free": 1000}))
    assert failure_of(client.take("S01", SETTINGS, ODOMETRY)).code == "DISK_FULL"
    assert device.started == []


@pytest.mark.parametrize(
    ("to_agent", "to_client"),
    [
        (lambda n, f: [], lambda n, f: [f]),
        (lambda n, f: [f] if n % 3 == 2 else [], lambda n, f: [f]),
        (lambda n, f: [f], lambda n, f: [f] if n % 3 == 2 else []),
        (lambda n, f: [f, f, f], lambda n, f: [f, f]),
        (lambda n, f: [f, f[:-3], b"\xc1" + f], lambda n, f: [f[: n % len(f)], f]),
    ],
    ids=["cut for a while", "requests lost", "replies lost", "all repeated", "garbled between"],
)
def test_over_a_bad_link_a_scan_is_taken_once(device, agent, to_agent, to_client):
    with Proxy(agent.endpoints.control, to_agent, to_client) as proxy:
        job = ScannerClient(Endpoints(proxy.endpoint, agent.endpoints.bulk), QUICK).take("S01", SETTINGS, ODOMETRY)
        threading.Timer(0.7, lambda: setattr(proxy, "to_agent", to_agent if to_agent(2, b"frame") else passing)).start()
        assert value_of(job).scan_id == "S01"
    assert device.started == ["S01"]


def passing(number: int, frame: bytes) -> list[bytes]:
    return [frame]


def test_a_port_that_is_taken_is_named(agent, tmp_path):
    with pytest.raises(FailureError, match=r"ENDPOINT_UNAVAILABLE.*in use"):
        scanner_agent(FakeScanner(), agent.endpoints, tmp_path)


def test_the_process_function_announces_its_ports_and_ends_when_told(device, tmp_path: Path):
    stop, announced = threading.Event(), []
    thread = threading.Thread(target=serve_scanner, args=(device, ANYWHERE, tmp_path, announced.append, stop))
    thread.start()
    eventually(lambda: announced)
    assert value_of(ScannerClient(announced[0], QUICK).info()).model == "fake"
    stop.set()
    thread.join(20.0)
    assert not thread.is_alive()


def test_closing_twice_does_no_harm(agent: Agent):
    agent.close()
    agent.close()
