"""The lease over real sockets: who has none, or an old one, or speaks too late, moves nothing."""

import math
import time
from itertools import count

import pytest
import zmq

from drivers.agent import base_agent
from drivers.lease import LIMIT_S, NEVER, LeaseKeeper
from drivers.messages import Beat, Drive, Goal, Late, Ok, Pending, Problem
from drivers.wire.base_client import BaseClient
from drivers.wire.endpoints import Endpoints
from drivers.wire.sockets import Sockets
from tests.drivers.wire_fakes import (
    ANYWHERE,
    IMPATIENT,
    QUICK,
    FakeBase,
    Proxy,
    eventually,
    failure_of,
    make_goal,
    restarted,
    value_of,
)
from tests.drivers.wire_talk import ask


@pytest.fixture
def device() -> FakeBase:
    return FakeBase()


@pytest.fixture
def keeper() -> LeaseKeeper:
    return LeaseKeeper(epoch=7, stale_after=0.5)


@pytest.fixture
def agent(device, keeper):
    with base_agent(device, ANYWHERE, keeper=keeper) as agent:
        yield agent


@pytest.fixture
def client(agent):
    client = BaseClient(agent.endpoints, QUICK)
    yield client
    client.close()


@pytest.fixture
def socket(agent):
    with Sockets().dealer(agent.endpoints.control) as socket:
        yield socket


def stamp(socket: zmq.Socket) -> dict[str, object]:
    """Of a command that stays valid for as long as the wire is concerned: only its nonce and its lease may be old."""
    first = ask(socket, Beat((0, 0), 0, 0, False), "hello")
    return {"boot": first.boot, "valid_until": first.clock + 100.0}


def test_an_order_without_a_lease_is_not_given(device, client):
    assert failure_of(client.drive(make_goal())).code == "LEASE_LOST"
    assert device.asked == []


def test_an_order_with_a_lease_that_never_was_is_refused(device, keeper, socket):
    order = Drive(Goal.of(make_goal()), (7, 1), keeper.nonce())
    reply = ask(socket, order, "r", **stamp(socket)).body
    assert isinstance(reply, Problem) and reply.code == "LEASE_LOST"
    assert device.asked == []


def test_an_order_of_the_owner_that_was_held_back_is_refused_and_given_anew_is_obeyed(device, client, keeper, socket):
    lease, valid = value_of(client.acquire("A")).number, stamp(socket)
    order = Drive(Goal.of(make_goal()), lease, keeper.nonce())
    time.sleep(LIMIT_S)
    assert isinstance(ask(socket, order, "r1", **valid).body, Late)
    assert isinstance(ask(socket, order, "r2", **valid).body, Late)
    assert device.asked == []
    order = Drive(order.goal, lease, keeper.nonce())
    assert isinstance(ask(socket, order, "r3", **valid).body, Pending)


def test_a_beat_permits_until_its_nonce_is_old_and_a_late_one_permits_nothing(device, client, keeper, socket):
    lease = value_of(client.acquire("A")).number
    before, nonce = time.monotonic(), keeper.nonce()
    assert device.permits == [NEVER]
    assert isinstance(ask(socket, Beat(lease, nonce, 1, True), "b1").body, Ok)
    assert before + LIMIT_S <= device.permits[-1] <= time.monotonic() + LIMIT_S
    assert isinstance(ask(socket, Beat(lease, nonce, 2, False), "b2").body, Ok)
    assert device.permits[-1] == NEVER
    time.sleep(LIMIT_S)
    permits = len(device.permits)
    assert isinstance(ask(socket, Beat(lease, nonce, 3, True), "b3").body, Late)
    assert len(device.permits) == permits


def test_the_beats_of_a_client_let_the_wheels_turn_and_its_release_stops_them(device, client):
    value_of(client.acquire("A"))
    eventually(lambda: client.state() is not None and client.state().owner == "A")

    ticks = count(1)

    def beat() -> bool:
        client.beat(next(ticks), may_move=True)
        time.sleep(0.01)
        return device.permits[-1] > time.monotonic()

    eventually(beat)
    assert value_of(client.release()) is None
    assert device.permits[-1] == NEVER
    permits = len(device.permits)
    client.beat(20_000, may_move=True)
    eventually(lambda: client.state().owner == "")
    assert len(device.permits) == permits
    assert value_of(client.release()) is None, "harmless without a lease"


def test_a_beat_before_the_lease_or_with_nobody_there_does_not_block():
    nobody = BaseClient(Endpoints("tcp://127.0.0.1:1", telemetry="tcp://127.0.0.1:1"), QUICK)
    nobody._lease = LeaseKeeper(1).acquire("A")
    nobody._listener.nonce = 5
    began = time.process_time()
    for tick in range(500):
        nobody.beat(tick, may_move=True)
    assert time.process_time() - began < 0.5
    nobody.close()


def test_a_new_owner_ends_the_drive_of_the_one_before_who_is_told_how_far_he_came_and_by_whom(device, agent, client):
    device.duration = math.inf
    value_of(client.acquire("A"))
    job = client.drive(make_goal())
    eventually(lambda: device.driven)
    heir = BaseClient(agent.endpoints, QUICK)
    refusal = failure_of(heir.acquire("B"))
    assert refusal.code == "LEASE_HELD" and refusal.evidence["owner"] == "A"
    eventually(lambda: (state := heir.state()) is not None and state.owner == "")
    lease = value_of(heir.acquire("B"))
    failure = failure_of(job)
    assert (failure.code, failure.evidence["owner"]) == ("LEASE_LOST", "B")
    assert failure.evidence["track"] == [[0.0, 0.0, 0.0]], "as the device told it"
    assert device.current is None
    assert failure_of(client.drive(make_goal("G02"))).code == "LEASE_LOST"
    device.duration = 0.1
    assert value_of(heir.drive(make_goal("G03"))).goal_id == "G03"
    assert [goal.goal_id for goal in device.driven] == ["G01", "G03"]
    assert lease.epoch == 7 and lease.sequence == 2
    heir.close()


def test_anybody_may_stop_the_base(device, agent, client):
    device.duration = math.inf
    value_of(client.acquire("A"))
    job = client.drive(make_goal())
    eventually(lambda: device.driven)
    passer_by = BaseClient(agent.endpoints, QUICK)
    assert value_of(passer_by.stop()) is None
    assert failure_of(job).code == "NAV_STOPPED"
    passer_by.close()


def test_an_order_that_always_comes_too_late_is_given_up(device, agent, keeper):
    """A link so slow that no nonce survives it."""

    def slow(number: int, frame: bytes) -> list[bytes]:
        time.sleep(LIMIT_S if b"robot_map" in frame else 0.0)
        return [frame]

    with Proxy(agent.endpoints.control, to_agent=slow) as proxy:
        client = BaseClient(Endpoints(proxy.endpoint, telemetry=agent.endpoints.telemetry), IMPATIENT)
        value_of(client.acquire("A"))
        assert failure_of(client.drive(make_goal())).code == "AGENT_UNREACHABLE"
        client.close()
    assert device.asked == []


def test_a_lease_does_not_outlive_the_agent_that_gave_it(device, agent, client):
    value_of(client.acquire("A"))
    eventually(lambda: client.state() is not None)
    agent.close()
    second = FakeBase()
    with restarted(lambda: base_agent(second, agent.endpoints)):
        assert failure_of(client.drive(make_goal())).code == "LEASE_LOST"
        assert second.asked == []
        value_of(client.acquire("A"))
        eventually(lambda: client.state().owner == "A")
        assert value_of(client.drive(make_goal("G02"))).goal_id == "G02"
