"""Every operation by every role and by no role, over real sockets: exactly what the table says, and nothing else."""

from contextlib import ExitStack, suppress

import pytest
import zmq

from drivers.agent import base_agent, scanner_agent
from drivers.messages import PROTOCOL, AnyReply, Body, Identify, Problem, Reply, Request
from drivers.wire.base_client import BaseClient
from drivers.wire.codec import Codec, encode
from drivers.wire.endpoints import Endpoints
from drivers.wire.keys import Keyring
from drivers.wire.roles import PERMITTED, Gate, Role
from drivers.wire.server import CONTROL_RATE, MAX_FRAMES, Server
from drivers.wire.sockets import Sockets
from perception.failure import FailureError
from tests.drivers import wire_samples
from tests.drivers.wire_fakes import ANY_PORT, ANYWHERE, IMPATIENT, FakeBase, FakeScanner, failure_of

OBSERVER, OPERATOR, EXECUTIVE = Role
TABLE = {
    "Identify": {OBSERVER, OPERATOR, EXECUTIVE},
    "SelfTest": {OBSERVER, OPERATOR, EXECUTIVE},
    "ScanStatus": {OBSERVER, OPERATOR, EXECUTIVE},
    "DriveStatus": {OBSERVER, OPERATOR, EXECUTIVE},
    "Open": {OPERATOR, EXECUTIVE},
    "Read": {OPERATOR, EXECUTIVE},
    "Stop": {OPERATOR, EXECUTIVE},
    "Abort": {OPERATOR, EXECUTIVE},
    "Take": {EXECUTIVE},
    "Release": {EXECUTIVE},
    "AcquireLease": {EXECUTIVE},
    "ReleaseLease": {EXECUTIVE},
    "Beat": {EXECUTIVE},
    "Drive": {EXECUTIVE},
}
"""Written down a second time, so that nobody changes it without meaning to."""
SILENCE_MS = 400

replies: Codec = Codec(Reply[AnyReply])


class Site:
    """Two agents with keys, and the keys of everybody who will try."""

    def __init__(self, folder, stack: ExitStack) -> None:
        self.keyring = Keyring(folder / "agent")
        self.people = {role: Keyring(folder / role) for role in Role}
        self.stranger = Keyring(folder / "stranger")
        for role, own in self.people.items():
            self.keyring.authorise(own.own.public, role, f"the-{role}")
        self.device = FakeBase()
        self.base = stack.enter_context(base_agent(self.device, ANYWHERE, self.keyring))
        self.scanner = stack.enter_context(scanner_agent(FakeScanner(), ANYWHERE, folder / "spool", self.keyring))

    def address(self, group: str) -> str:
        return {
            "base": self.base.endpoints.control,
            "scanner": self.scanner.endpoints.control,
            "bulk": self.scanner.endpoints.bulk,
        }[group]


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    with ExitStack() as stack:
        yield Site(tmp_path_factory.mktemp("site"), stack)


def ask(socket: zmq.Socket, body: Body, request_id: str = "r") -> Body:
    socket.send(encode(Request(PROTOCOL, request_id, body)))
    assert socket.poll(20_000), f"no reply to {body}"
    return replies.decode(socket.recv()).body


def refused(reply: Body) -> bool:
    return isinstance(reply, Problem) and reply.code == "NOT_ALLOWED"


def groups() -> list[tuple[str, type[Body]]]:
    members = [(group, body) for group, union in wire_samples.REQUESTS.items() for body in union.__args__]
    return sorted(members, key=lambda member: (member[0], member[1].__name__))


def test_every_operation_stands_in_the_table():
    assert {body.__name__ for body in wire_samples.operations()} == {body.__name__ for body in PERMITTED} == set(TABLE)


@pytest.mark.parametrize("role", list(Role))
def test_each_role_may_ask_exactly_what_the_table_says(site, role):
    answers = {}
    for group in wire_samples.REQUESTS:
        with Sockets(site.people[role], site.keyring.own.public).dealer(site.address(group)) as socket:
            for number, (_, body) in enumerate(member for member in groups() if member[0] == group):
                answers[group, body] = not refused(ask(socket, wire_samples.sample(body), f"{role}{number}"))
    assert answers == {(group, body): role in TABLE[body.__name__] for group, body in groups()}


@pytest.mark.parametrize("who", ["nobody", "stranger", "wrong server key"])
@pytest.mark.parametrize("group", list(wire_samples.REQUESTS))
def test_who_is_not_paired_gets_no_answer_to_anything(site, who, group):
    sockets = {
        "nobody": Sockets(),
        "stranger": Sockets(site.stranger, site.keyring.own.public),
        "wrong server key": Sockets(site.people[EXECUTIVE], site.stranger.own.public),
    }[who]
    driven, stops = len(site.device.driven), site.device.stops
    with sockets.dealer(site.address(group)) as socket:
        for _, body in (member for member in groups() if member[0] == group):
            with suppress(zmq.Again):  # hung up on already
                socket.send(encode(Request(PROTOCOL, "r", wire_samples.sample(body))), zmq.NOBLOCK)
        assert not socket.poll(SILENCE_MS)
    assert (len(site.device.driven), site.device.stops) == (driven, stops)


@pytest.mark.parametrize(("who", "heard"), [*((role, True) for role in Role), ("stranger", False), ("nobody", False)])
def test_the_telemetry_is_for_those_who_are_paired(site, who, heard):
    keyring = site.people.get(who, site.stranger)
    sockets = Sockets() if who == "nobody" else Sockets(keyring, site.keyring.own.public)
    with sockets.subscriber(site.base.endpoints.telemetry) as socket:
        assert bool(socket.poll(20_000 if heard else SILENCE_MS)) == heard


def test_a_role_that_is_taken_away_counts_from_the_next_message_on(site, tmp_path):
    late = Keyring(tmp_path)
    site.keyring.authorise(late.own.public, EXECUTIVE, "late")
    with Sockets(late, site.keyring.own.public).dealer(site.address("base")) as socket:
        assert not refused(ask(socket, Identify()))
        site.keyring.revoke("late")
        assert refused(ask(socket, Identify()))


def test_the_way_out_is_told_to_one_who_gets_no_answer(site):
    agent = site.base.endpoints
    client = BaseClient(agent, IMPATIENT, Sockets(site.stranger, agent.server_key))
    failure = failure_of(client.info())
    client.close()
    assert failure.code == "AGENT_UNREACHABLE" and "paired" in failure.message


def test_what_is_not_in_the_table_nobody_may():
    class Fly(Body, frozen=True):
        pass

    assert all(Gate(lambda _, role=role: role).refusal("key", Fly) for role in Role)


@pytest.mark.parametrize("key", [None, "", "anonymous"])
def test_a_message_without_a_proven_key_is_refused(key):
    assert Gate({"key": EXECUTIVE}.get).refusal(key, Identify).code == "NOT_ALLOWED"
    assert Gate({"key": EXECUTIVE}.get).refusal("key", Identify) is None


def test_a_guarded_socket_is_not_served_without_a_gate(tmp_path):
    sockets = Sockets(Keyring(tmp_path))
    socket, _ = sockets.router(ANY_PORT)
    with socket, pytest.raises(ValueError, match="gate"):
        Server(socket, wire_samples.REQUESTS["base"], lambda body: body, "boot", "name")
    sockets.close()


def test_nobody_is_told_what_came_of_anothers_command(site):
    stop = wire_samples.sample(next(body for body in wire_samples.operations() if body.__name__ == "Stop"))
    before = site.device.stops
    for number, role in enumerate((EXECUTIVE, OPERATOR), 1):
        with Sockets(site.people[role], site.keyring.own.public).dealer(site.address("base")) as socket:
            ask(socket, type(stop)(None), "the same id")
            assert site.device.stops == before + number


def test_a_local_user_may_do_everything():
    device = FakeBase()
    with base_agent(device, ANYWHERE) as agent, Sockets().dealer(agent.endpoints.control) as socket:
        members = [body for group, body in groups() if group == "base"]
        assert not any(refused(ask(socket, wire_samples.sample(body), body.__name__)) for body in members)


def test_one_client_that_floods_does_not_keep_another_waiting(site):
    flood = encode(Request(PROTOCOL, "r", Identify()))
    with (
        Sockets(site.people[OBSERVER], site.keyring.own.public).dealer(site.address("base")) as loud,
        Sockets(site.people[EXECUTIVE], site.keyring.own.public).dealer(site.address("base")) as quiet,
    ):
        ask(loud, Identify())
        answered = 0
        for number in range(5000):
            loud.send(flood)
            while loud.poll(0):
                loud.recv()
                answered += 1
            if number % 500 == 0:
                assert not refused(ask(quiet, Identify()))
        while loud.poll(SILENCE_MS):
            loud.recv()
            answered += 1
        assert answered < 5000 - CONTROL_RATE


@pytest.mark.parametrize(("more", "answered"), [(MAX_FRAMES - 2, True), (MAX_FRAMES - 1, False), (2000, False)])
def test_a_message_of_too_many_frames_is_dropped_and_the_next_one_heard(more, answered):
    with base_agent(FakeBase(), ANYWHERE) as agent, Sockets().dealer(agent.endpoints.control) as socket:
        frame = encode(Request(PROTOCOL, "many", Identify()))
        socket.send_multipart([b"x"] * more + [frame])
        socket.send(encode(Request(PROTOCOL, "next", Identify())))
        assert socket.poll(20_000)
        first = replies.decode(socket.recv_multipart()[-1])
        assert first.request_id == ("many" if answered else "next")


def test_a_plain_agent_is_not_opened_to_other_machines(tmp_path):
    for endpoint in ("tcp://0.0.0.0:*", "tcp://*:*", "tcp://[::]:*"):
        with pytest.raises(FailureError, match=r"ENDPOINT_NEEDS_KEYS.*--keys"):
            base_agent(FakeBase(), Endpoints(endpoint, telemetry=ANY_PORT))
        with pytest.raises(FailureError, match=r"ENDPOINT_NEEDS_KEYS"):
            base_agent(FakeBase(), Endpoints(ANY_PORT, telemetry=endpoint))


def test_an_agent_with_keys_may_be_reached_from_other_machines(site, tmp_path):
    wide = Endpoints("tcp://0.0.0.0:*", telemetry="tcp://0.0.0.0:*")
    with base_agent(FakeBase(), wide, site.keyring) as agent:
        local = agent.endpoints.control.replace("0.0.0.0", "127.0.0.1")
        with Sockets(site.people[OBSERVER], agent.endpoints.server_key).dealer(local) as socket:
            assert not refused(ask(socket, Identify()))
    assert not agent.broken.is_set()
