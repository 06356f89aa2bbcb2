"""The link to a base: old commands, garbage and other versions move nothing, and what is said twice is done once."""

import threading
from collections.abc import Callable
from contextlib import suppress

import numpy as np
import zmq

from drivers.agent import serve_base
from drivers.interfaces import BaseInfo
from drivers.jobs import BackgroundJob, Progress, Running
from drivers.messages import PROTOCOL, BaseRequest, Body, Drive, Goal, Ok, Pending, Reply, Request, Stale, Stop
from drivers.wire.base_client import BaseClient
from drivers.wire.client import Link
from drivers.wire.codec import Codec, encode
from drivers.wire.endpoints import Endpoints
from drivers.wire.sockets import Sockets
from perception.failure import Failure
from tests.drivers.wire_fakes import ANY_PORT, ANYWHERE, QUICK, eventually, failure_of, make_goal, value_of
from tests.drivers.wire_talk import ask, heard, replies


def test_the_base_says_who_it_is(client):
    assert value_of(client.info()) == BaseInfo("fake base", "0002", PROTOCOL, (0.9, 0.6))


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


def test_the_process_function_leaves_the_base_at_rest(device):
    stop, announced = threading.Event(), []
    thread = threading.Thread(target=serve_base, args=(device, ANYWHERE, announced.append, stop))
    thread.start()
    eventually(lambda: announced)
    stop.set()
    thread.join(20.0)
    assert not thread.is_alive() and device.stops == 1
