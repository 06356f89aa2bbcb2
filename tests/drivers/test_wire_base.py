"""A base over real sockets: each goal is driven once, a stop always gets through, old commands move nothing."""

import threading
import time
from collections.abc import Callable
from contextlib import closing, suppress

import numpy as np
import pytest
import zmq

from drivers.agent import Agent, base_agent, serve_base
from drivers.interfaces import BaseInfo
from drivers.jobs import BackgroundJob, Failed, Progress, Running
from drivers.messages import (
    PROTOCOL,
    AnyReply,
    BaseRequest,
    Body,
    Drive,
    Goal,
    Ok,
    Pending,
    Pose,
    Reply,
    Request,
    Stale,
    Stop,
    Telemetry,
)
from drivers.wire.base_client import BaseClient
from drivers.wire.client import Link
from drivers.wire.codec import Codec, encode
from drivers.wire.endpoints import Endpoints
from drivers.wire.sockets import Sockets
from drivers.wire.telemetry import Listener
from perception import transforms
from perception.failure import Failure, FailureError
from tests.drivers.chaos_link import NONE, ChaosLink
from tests.drivers.wire_fakes import (
    ANY_PORT,
    ANYWHERE,
    QUICK,
    FakeBase,
    Proxy,
    eventually,
    failure_of,
    make_goal,
    outcome_of,
    restarted,
    value_of,
)

replies: Codec = Codec(Reply[AnyReply])


@pytest.fixture
def device() -> FakeBase:
    return FakeBase()


@pytest.fixture
def agent(device):
    with base_agent(device, ANYWHERE) as agent:
        yield agent


@pytest.fixture
def client(agent):
    client = owner(agent.endpoints)
    yield client
    client.close()


def owner(endpoints: Endpoints, mission: str = "") -> BaseClient:
    """A client that has the lease."""
    client = BaseClient(endpoints, QUICK, mission=mission)
    value_of(client.acquire("owner"))
    return client


def heard(agent: Agent) -> int:
    """The nonce of the newest telemetry."""
    listener = Listener(Sockets().subscriber(agent.endpoints.telemetry))
    eventually(lambda: listener.nonce is not None)
    listener.close()
    return listener.nonce


def ask(socket: zmq.Socket, body: object, request_id: str, **stamp: object) -> Reply:
    """One exchange by hand, for what the client would never send."""
    socket.send(encode(Request(PROTOCOL, request_id, body, **stamp)))
    assert socket.poll(20_000), "no reply"
    return replies.decode(socket.recv())


def test_a_goal_is_driven_and_reported(device, client):
    report = value_of(client.drive(make_goal()))
    assert (report.goal_id, len(report.track), report.distance) == ("G01", 2, 1.1)
    np.testing.assert_allclose(report.map_from_base, transforms.planar(1.0, 0.5, 0.0), atol=1e-12)
    np.testing.assert_array_equal(device.driven[0].robot_map.data, make_goal().robot_map.data)


def test_the_base_says_who_it_is(client):
    assert value_of(client.info()) == BaseInfo("fake base", "0002", PROTOCOL, (0.9, 0.6))


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
    device.duration = 30.0
    with closing(owner(agent.endpoints, "first")) as client:
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
    device.duration = 30.0
    job = client.drive(make_goal())
    eventually(lambda: device.driven)
    job.cancel()
    assert failure_of(job).code == "CANCELLED"
    assert device.stops >= 1 and device.current is None


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


def test_a_command_is_void_without_a_stamp_after_its_time_and_for_another_boot(device, agent):
    client = BaseClient(agent.endpoints, QUICK)
    lease = value_of(client.acquire("owner"))
    client.close()
    with Sockets().dealer(agent.endpoints.control) as socket:
        order = Drive(Goal.of(make_goal()), lease.number, heard(agent))
        first = ask(socket, order, "r1")
        assert isinstance(first.body, Stale)
        boot, now = first.boot, first.clock
        assert isinstance(ask(socket, order, "r2", boot=boot, valid_until=now - 0.1).body, Stale)
        assert isinstance(ask(socket, order, "r3", boot="another", valid_until=now + 9).body, Stale)
        assert isinstance(ask(socket, order, "r4", boot=boot, valid_until=float("nan")).body, Stale)
        assert device.driven == []
        order = Drive(order.goal, order.lease, heard(agent))
        assert isinstance(ask(socket, order, "r5", boot=boot, valid_until=now + 9).body, Pending)
        eventually(lambda: device.driven)


def test_a_repeated_request_gets_the_remembered_reply(device, agent):
    with Sockets().dealer(agent.endpoints.control) as socket:
        for _ in range(3):
            assert isinstance(ask(socket, Stop(), "same").body, Ok)
        assert device.stops == 1
        ask(socket, Stop(), "other")
        assert device.stops == 2


def test_a_drive_that_comes_after_its_own_stop_is_not_begun(device, agent, client):
    with Sockets().dealer(agent.endpoints.control) as socket:
        assert isinstance(ask(socket, Stop("G01"), "r1").body, Ok)
    assert failure_of(client.drive(make_goal("G01"))).code == "CANCELLED"
    assert device.driven == []


def test_garbage_does_not_keep_the_agent_from_a_good_client(agent, client):
    random = np.random.default_rng(3)
    good = encode(Request(PROTOCOL, "r", Drive(Goal.of(make_goal()), (1, 1), 7)))
    with Sockets().dealer(agent.endpoints.control) as socket:
        for number in range(20_000):
            frame = bytearray(good[: random.integers(1, len(good))] if number % 2 else good)
            frame[random.integers(len(frame))] = random.integers(256)
            socket.send(bytes(frame))
            if number % 32 == 31:  # stay under the high-water mark, so that all of it arrives
                while socket.poll(0):
                    socket.recv()
        socket.send_multipart([b""] * 20)
        assert value_of(client.info()).model == "fake base"


def test_a_link_that_went_deaf_is_replaced_and_the_request_keeps_its_id():
    requests: Codec = Codec(Request[BaseRequest])
    with Sockets().router(ANY_PORT)[0] as socket:
        endpoint = socket.get_string(zmq.LAST_ENDPOINT).rstrip("\0")
        client = BaseClient(Endpoints(endpoint, telemetry=ANY_PORT.replace("*", "1")), QUICK)
        job = client.stop()
        deaf, first = socket.recv_multipart()
        request_ids = set()
        while isinstance(job.poll(), Running):
            assert socket.poll(20_000), "it never tried another link"
            identity, frame = socket.recv_multipart()
            request_ids.add(requests.decode(frame).request_id)
            if identity != deaf:
                with suppress(zmq.ZMQError):  # on a busy machine that link may have been given up as well by now
                    reply = Reply(PROTOCOL, requests.decode(frame).request_id, Ok(), "boot", 0.0)
                    socket.send_multipart([identity, encode(reply)])
                eventually(lambda: socket.poll(0) or not isinstance(job.poll(), Running))
        assert value_of(job) is None and request_ids <= {requests.decode(first).request_id}
        client.close()


def told(job_of: Callable[[Link], object], *bodies: tuple[Body, str]) -> Failure:
    """How a conversation fails in which the agent says each of these to a new request, and the last for ever."""
    requests: Codec = Codec(Request[BaseRequest])
    with Sockets().router(ANY_PORT)[0] as socket:
        endpoint = socket.get_string(zmq.LAST_ENDPOINT).rstrip("\0")

        def converse(progress: Progress) -> object:
            with Link(Sockets(), endpoint, QUICK, progress) as link:
                return job_of(link)

        job, asked = BackgroundJob(converse), []
        while isinstance(job.poll(), Running):
            if socket.poll(20):
                identity, frame = socket.recv_multipart()
                request_id = requests.decode(frame).request_id
                asked += [] if request_id in asked else [request_id]
                body, boot = bodies[min(asked.index(request_id), len(bodies) - 1)]
                socket.send_multipart([identity, encode(Reply(PROTOCOL, request_id, body, boot, 0.0))])
    return failure_of(job)


def test_an_order_that_must_not_outlive_its_agent_is_refused_where_another_process_answers():
    orders = told(lambda link: (link.ask(Stop(), Ok), link.ask(Stop(), Ok, once=True)), (Ok(), "a"), (Stale(), "b"))
    assert orders.code == "AGENT_RESTARTED"


def test_a_reply_that_answers_another_question_is_not_believed():
    reply = told(lambda link: link.ask(Stop(), Ok), (Pending(), "a"))
    assert reply.code == "BAD_REPLY" and "Pending" in reply.message


def test_an_agent_of_another_version_is_named():
    with Sockets().router(ANY_PORT)[0] as socket:
        endpoint = socket.get_string(zmq.LAST_ENDPOINT).rstrip("\0")
        client = BaseClient(Endpoints(endpoint, telemetry=ANY_PORT.replace("*", "1")), QUICK)
        job = client.info()
        identity, frame = socket.recv_multipart()
        socket.send_multipart(
            [identity, frame.replace(b"version" + bytes([PROTOCOL]), b"version" + bytes([PROTOCOL + 1]))]
        )
        failure = failure_of(job)
        client.close()
    assert failure.code == "PROTOCOL_MISMATCH" and failure.evidence["theirs"] == PROTOCOL + 1


def test_a_client_of_another_version_is_told(agent):
    with Sockets().dealer(agent.endpoints.control) as socket:
        socket.send(encode(Request(PROTOCOL + 1, "r", Stop())))
        reply = replies.decode(socket.recv())
    assert (reply.request_id, reply.body.code) == ("r", "PROTOCOL_MISMATCH")


def test_the_newest_telemetry_is_known_with_its_age(device, agent, client):
    eventually(lambda: client.state() is not None)
    state = client.state()
    np.testing.assert_allclose(state.odom_from_base, device.pose, atol=1e-12)
    assert (state.map_from_base, state.moving, state.battery, state.activity) == (None, False, 0.75, "idle")
    device.pose = transforms.planar(3.0, 0.0, 0.0)
    eventually(lambda: np.allclose(client.state().odom_from_base, device.pose))
    assert client.state().age < 5.0
    agent.close()
    eventually(lambda: client.state().age >= 0.3)


def test_telemetry_goes_on_after_a_restart_of_the_agent(device, agent, client):
    eventually(lambda: client.state() is not None)
    agent.close()
    second = FakeBase()
    second.in_map = transforms.planar(9.0, 9.0, 0.0)
    with restarted(lambda: base_agent(second, agent.endpoints)):
        eventually(lambda: client.state().map_from_base is not None)


def test_a_device_that_cannot_tell_its_state_once_is_asked_again(device, agent, client):
    telemetry, device.telemetry = device.telemetry, lambda: 1 / 0
    with base_agent(device, ANYWHERE) as second:
        patient = BaseClient(second.endpoints, QUICK)
        time.sleep(0.2)
        assert patient.state() is None
        patient.close()
    device.telemetry = telemetry
    eventually(lambda: client.state() is not None)


def test_old_and_garbled_telemetry_is_ignored():
    heard = []

    class NotingListener(Listener):
        def _accept(self, frame: bytes) -> None:
            super()._accept(frame)
            heard.append(self.state().battery)

    publisher, endpoint = Sockets().publisher(ANY_PORT)
    listener = NotingListener(Sockets().subscriber(endpoint))

    def message(boot: str, sequence: int, battery: float) -> bytes:
        pose = Pose.of(np.eye(4))
        return encode(Telemetry(PROTOCOL, boot, sequence, 1.0, pose, None, False, False, battery, "idle", 7, ""))

    def publish_until(battery: float, frame: bytes) -> None:
        eventually(lambda: publisher.send(frame) or ((s := listener.state()) and s.battery == battery))

    def publish(*frames: bytes, last: float) -> None:
        """What comes last has been heard after all that was sent before it."""
        for frame in frames:
            publisher.send(frame)
        eventually(lambda: heard[-1] == last)

    with publisher:
        publish_until(0.5, message("a", 7, 0.5))
        bad = (message("a", 6, 0.1), b"\xc1", message("a", 8, 0.1)[:-4])
        publish(*bad, message("a", 8, 0.4), last=0.4)
        publish(message("b", 1, 0.3), last=0.3)
        publish(message("a", 9, 0.2), message("b", 2, 0.6), last=0.6)
        assert 0.1 not in heard, "old or garbled"
        assert 0.2 not in heard, "nobody hears of a process that another has followed"
        assert (listener.state().odom_frame, listener.has_heard("a", 5.0)) == ("b", True)
        assert (listener.has_heard("b", 1.0), listener.has_heard("b", 1.1)) == (True, False)
        listener.close()


def test_the_process_function_leaves_the_base_at_rest(device):
    stop, announced = threading.Event(), []
    thread = threading.Thread(target=serve_base, args=(device, ANYWHERE, announced.append, stop))
    thread.start()
    eventually(lambda: announced)
    stop.set()
    thread.join(20.0)
    assert not thread.is_alive() and device.stops == 1
