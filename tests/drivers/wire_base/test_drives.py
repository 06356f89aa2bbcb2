"""A base over real sockets: each goal is driven once, and a stop always gets through."""

import threading
import time
from contextlib import closing

import numpy as np
import pytest

from drivers.agent import base_agent
from drivers.jobs import Failed, Running
from drivers.messages import Pending
from drivers.wire.endpoints import Endpoints
from perception import transforms
from perception.failure import FailureError
from tests.drivers.chaos_link import NONE, ChaosLink
from tests.drivers.wire_fakes import FakeBase, Proxy, eventually, failure_of, make_goal, outcome_of, restarted, value_of
from tests.drivers.wire_talk import owner, replies


def test_a_goal_is_driven_and_reported(device, client):
    report = value_of(client.drive(make_goal()))
    assert (report.goal_id, len(report.track), report.distance) == ("G01", 2, 1.1)
    np.testing.assert_allclose(report.map_from_base, transforms.planar(1.0, 0.5, 0.0), atol=1e-12)
    np.testing.assert_array_equal(device.driven[0].robot_map.data, make_goal().robot_map.data)


def test_the_same_goal_is_driven_once(device, client):
    value_of(client.drive(make_goal()))
    value_of(client.drive(make_goal()))
    assert len(device.driven) == 1


def test_each_mission_has_goals_of_its_own_by_the_same_names(device, agent):
    for mission in ("first", "second"):
        with closing(owner(agent.endpoints, mission)) as client:
            assert value_of(client.drive(make_goal())).goal_id == "G01"
            value_of(client.release())
    assert [goal.goal_id for goal in device.driven] == ["first.G01", "second.G01"]


def test_a_drive_of_a_mission_can_be_given_up(device, agent):
    with closing(owner(agent.endpoints, "first")) as client:
        assert_a_drive_can_be_given_up(device, client)


def assert_a_drive_can_be_given_up(device, client):
    device.duration = 30.0
    job = client.drive(make_goal())
    eventually(lambda: device.driven)
    job.cancel()
    assert failure_of(job).code == "CANCELLED"
    assert device.stops >= 1 and device.current is None


def test_a_refusal_comes_out_of_the_job(device, client):
    device.refuses = FailureError("NAV_NO_PATH", "walls all around", track=[])
    failure = failure_of(client.drive(make_goal()))
    assert (failure.code, failure.evidence) == ("NAV_NO_PATH", {"track": []})


def test_cancelling_a_drive_stops_the_base(device, client):
    assert_a_drive_can_be_given_up(device, client)


def test_a_stop_from_elsewhere_ends_the_drive_with_its_track(device, client):
    device.duration = 30.0
    job = client.drive(make_goal())
    eventually(lambda: device.driven)
    assert value_of(client.stop()) is None
    failure = failure_of(job)
    assert (failure.code, failure.evidence["track"]) == ("NAV_STOPPED", [[0.0, 0.0, 0.0]])


def test_a_stop_gets_through_while_the_device_thinks_and_the_goal_never_moves_it(device, client):
    device.duration = 30.0
    device.may_start.clear()
    job = client.drive(make_goal())
    eventually(lambda: device.asked)
    value_of(client.stop())
    assert device.stops == 1 and device.driven == []
    device.may_start.set()
    assert failure_of(job).code == "NAV_STOPPED"
    assert device.current is None


def test_cancelling_one_goal_does_not_stop_the_next(device, client):
    device.duration = 0.5
    first = client.drive(make_goal("G01"))
    eventually(lambda: device.driven)
    second = client.drive(make_goal("G02"))
    eventually(lambda: len(device.driven) == 2)
    first.cancel()
    failure_of(first)
    assert value_of(second).goal_id == "G02"


def test_a_base_that_restarts_during_a_drive_is_not_sent_on(device, agent, client):
    device.duration, device.in_map = 30.0, transforms.planar(0.4, 0.1, 0.0)
    eventually(lambda: (state := client.state()) and state.map_from_base is not None)
    before = client.state().odom_frame
    job = client.drive(make_goal())
    eventually(lambda: device.driven)
    agent.close()
    assert device.current is None, "an agent that ends leaves the base at rest"
    second = FakeBase()
    with restarted(lambda: base_agent(second, agent.endpoints)):
        failure = failure_of(job)
        assert client.state().odom_frame != before, "what comes next goes by where it stands now"
    assert failure.code == "NAV_INTERRUPTED" and np.allclose(failure.evidence["track"], [(0.4, 0.1, 0.0)])
    assert second.driven == []


def test_who_hears_that_a_drive_has_ended_sees_the_base_where_it_ended(device, agent):
    """The link of the telemetry loses what was said before the end; nobody is told the end until it is heard again."""
    device.pose = transforms.planar(1.0, 2.0, 0.5)
    with ChaosLink(agent.endpoints.telemetry, "held", NONE, telemetry=True) as link:
        client = owner(Endpoints(agent.endpoints.control, telemetry=link.endpoint))
        for fails in (False, True):
            job = client.drive(make_goal(f"G{fails:d}"))
            eventually(lambda: device.current)
            link.cut()
            device.pose = device.pose @ transforms.planar(1.0, 0.0, 0.0)
            if fails:
                device.stop()
            eventually(lambda: device.current is None or not isinstance(device.drive_status(device.current), Running))
            time.sleep(0.3)
            assert isinstance(job.poll(), Running)
            link.heal()
            outcome = outcome_of(job)
            assert isinstance(outcome, Failed) == fails
            assert np.allclose(client.state().odom_from_base, device.pose)
        client.close()


def test_a_drive_whose_reply_was_lost_is_not_given_to_the_next_process(device, agent):
    """The first process drives but its word does not come through; the second must not begin anew."""
    lost = threading.Event()

    def to_client(number: int, frame: bytes) -> list[bytes]:
        if isinstance(replies.decode(frame).body, Pending):
            lost.set()
            return []
        return [frame]

    with Proxy(agent.endpoints.control, to_client=to_client) as proxy:
        client = owner(Endpoints(proxy.endpoint, telemetry=agent.endpoints.telemetry))
        device.duration = 30.0
        job = client.drive(make_goal())
        assert lost.wait(20.0)
        agent.close()
        second = FakeBase()
        with restarted(lambda: base_agent(second, agent.endpoints)):
            assert failure_of(job).code == "NAV_INTERRUPTED"
        client.close()
    assert len(device.driven) == 1 and second.driven == []


@pytest.mark.parametrize("seed", range(3))
def test_over_a_bad_link_each_goal_is_driven_once(device, agent, seed):
    random = np.random.default_rng(seed)

    def unreliable(number: int, frame: bytes) -> list[bytes]:
        return [[], [frame], [frame], [frame, frame], [frame[:-2], frame]][random.integers(5)]

    with Proxy(agent.endpoints.control, unreliable, unreliable) as proxy:
        client = owner(Endpoints(proxy.endpoint, telemetry=agent.endpoints.telemetry))
        for name in ("G01", "G02", "G03"):
            assert value_of(client.drive(make_goal(name))).goal_id == name
        client.close()
    assert [goal.goal_id for goal in device.driven] == ["G01", "G02", "G03"]
