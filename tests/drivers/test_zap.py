"""Handshakes: only a known key gets through, whatever is asked, and nobody at all when there is nobody to judge."""

import threading
import time
from contextlib import ExitStack, suppress
from typing import get_args

import pytest
import zmq

from drivers.agent import base_agent, scanner_agent, serve_base
from drivers.messages import PROTOCOL, AnyReply, Body, Identify, Reply, Request
from drivers.wire import sockets as sockets_module
from drivers.wire import zap
from drivers.wire.codec import Codec, encode
from drivers.wire.keys import Keyring
from drivers.wire.roles import Role
from drivers.wire.sockets import Sockets
from drivers.wire.zap import ADDRESS, DOMAIN, Authenticator
from perception.failure import FailureError
from tests.drivers import wire_samples
from tests.drivers.wire_fakes import ANYWHERE, FakeBase, FakeScanner, eventually

KEY = bytes(range(32))
GOOD = [b"1.0", b"7", DOMAIN, b"127.0.0.1", b"", b"CURVE", KEY]
SILENCE_MS = 300

replies: Codec = Codec(Reply[AnyReply])


class Judge:
    """An authenticator that is asked by hand."""

    def __init__(self, knows) -> None:
        self.context = zmq.Context()
        self.authenticator = Authenticator(self.context.socket(zmq.ROUTER), knows)
        self.socket = self.context.socket(zmq.DEALER)
        self.socket.connect(ADDRESS)

    def __enter__(self) -> "Judge":
        return self

    def __exit__(self, *exception: object) -> None:
        self.socket.close(linger=0)
        self.authenticator.close()
        self.context.term()

    def verdict(self, frames: list[bytes]) -> list[bytes]:
        self.socket.send_multipart([b"", *frames])
        assert self.socket.poll(20_000), "no verdict"
        return self.socket.recv_multipart()[1:]


def changed(index: int, value: bytes) -> list[bytes]:
    return [*GOOD[:index], value, *GOOD[index + 1 :]]


def test_a_known_key_is_let_in_under_its_own_name():
    with Judge(lambda key: key == KEY.hex()) as judge:
        assert judge.verdict(GOOD) == [b"1.0", b"7", b"200", b"OK", KEY.hex().encode(), b""]


@pytest.mark.parametrize(
    "frames",
    [
        changed(6, bytes(32)),
        changed(0, b"2.0"),
        changed(2, b""),
        changed(2, b"*"),
        changed(5, b"NULL")[:6],
        changed(5, b"NULL"),
        [*changed(5, b"PLAIN")[:6], b"user", b"password"],
        changed(5, b"GSSAPI"),
        changed(6, KEY[:31]),
        changed(6, KEY + b"x"),
        changed(6, b""),
        [*GOOD, KEY],
        GOOD[:6],
        GOOD[:4],
        GOOD[:2],
    ],
    ids=lambda frames: b" ".join(frames[2:6]).decode() + f" {len(frames)} frames",
)
def test_whatever_else_is_refused_and_the_next_one_judged(frames):
    with Judge(lambda key: key == KEY.hex()) as judge:
        version, number, status, _, user, metadata = judge.verdict(frames)
        assert (version, number, status, user, metadata) == (b"1.0", frames[1], b"400", b"", b"")
        assert judge.verdict(GOOD)[2] == b"200"


@pytest.mark.parametrize("frames", [[], [b"1.0"]])
def test_what_is_no_question_has_no_answer(frames):
    with Judge(lambda key: True) as judge:
        judge.socket.send_multipart([b"", *frames])
        assert judge.verdict(GOOD)[2] == b"200"


@pytest.mark.parametrize("answer", [None, "yes", 1, object()])
def test_only_a_plain_yes_lets_in(answer):
    with Judge(lambda key: answer) as judge:
        assert judge.verdict(GOOD)[2] == b"400"


def test_an_error_while_judging_means_no_and_does_not_end_the_judge():
    known = iter([ZeroDivisionError("x"), FailureError("KEYS_UNREADABLE", "x"), RecursionError(), None])

    def knows(key: str) -> bool:
        if error := next(known):
            raise error
        return True

    with Judge(knows) as judge:
        assert [judge.verdict(GOOD)[2] for _ in range(4)] == [b"400"] * 3 + [b"200"]


def test_a_key_that_comes_back_too_often_has_to_wait(monkeypatch):
    monkeypatch.setattr(zap, "HANDSHAKES_PER_SECOND", 5.0)
    with Judge(lambda key: True) as judge:
        verdicts = [judge.verdict(GOOD)[2] for _ in range(50)]
        assert verdicts[:5] == [b"200"] * 5 and b"400" in verdicts
        assert judge.verdict(changed(6, bytes(32)))[2] == b"200"
        time.sleep(0.25)
        assert judge.verdict(GOOD)[2] == b"200"


@pytest.fixture
def keyrings(tmp_path):
    agent, friend = Keyring(tmp_path / "agent"), Keyring(tmp_path / "friend")
    agent.authorise(friend.own.public, Role.EXECUTIVE, "friend")
    return agent, friend


class Mortal(Keyring):
    """Its judge dies of a question once told to: SystemExit is no Exception."""

    dies = False

    def role_of(self, key: str) -> Role | None:
        if self.dies and threading.current_thread().name == "authenticator":
            raise SystemExit
        return super().role_of(key)


def mortal(keyring: Keyring) -> Mortal:
    return Mortal(keyring.folder)


def call(socket: zmq.Socket, body: Body | None = None, request_id: str = "r") -> None:
    with suppress(zmq.Again):  # hung up on already
        socket.send(encode(Request(PROTOCOL, request_id, body or Identify())), zmq.NOBLOCK)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_an_agent_whose_judge_died_stops_the_device_and_ends(keyrings):
    own, device, announced, ended = mortal(keyrings[0]), FakeBase(), [], []

    def process() -> None:
        with pytest.raises(FailureError, match="AUTHENTICATOR_DIED"):
            serve_base(device, ANYWHERE, announced.append, keyring=own)
        ended.append(True)

    thread = threading.Thread(target=process, daemon=True)
    thread.start()
    eventually(lambda: announced)
    own.dies = True
    with Sockets(keyrings[1], own.own.public).dealer(announced[0].control) as socket:
        call(socket)
        thread.join(20.0)
        assert ended and device.stops >= 1
        assert not socket.poll(SILENCE_MS)
    with Sockets().router(announced[0].control)[0]:
        pass  # nobody listens there any more


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_nobody_new_gets_in_while_there_is_no_judge_even_if_nobody_noticed(keyrings, monkeypatch):
    monkeypatch.setattr(Authenticator, "mourn", lambda self, died: None)
    own, device = mortal(keyrings[0]), FakeBase()
    with base_agent(device, ANYWHERE, own) as agent:
        inside = Sockets(keyrings[1], own.own.public).dealer(agent.endpoints.control)
        call(inside)
        assert inside.poll(20_000)
        own.dies = True
        for keyring in (keyrings[1], Keyring(own.folder.with_name("stranger"))):
            sockets = Sockets(keyring, own.own.public)
            with (
                sockets.dealer(agent.endpoints.control) as socket,
                sockets.subscriber(agent.endpoints.telemetry) as ear,
            ):
                call(socket)
                assert not socket.poll(SILENCE_MS) and not ear.poll(SILENCE_MS)
        inside.close()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
@pytest.mark.parametrize("group", list(wire_samples.REQUESTS))
def test_without_a_judge_no_operation_of_any_agent_is_done_for_anybody(group, keyrings, monkeypatch, tmp_path):
    """Asked by one who is paired as much as by a stranger, each on a connection of its own."""
    monkeypatch.setattr(Authenticator, "mourn", lambda self, died: None)
    own, base, scanner = mortal(keyrings[0]), FakeBase(), FakeScanner()
    operations = get_args(wire_samples.REQUESTS[group])
    with base_agent(base, ANYWHERE, own) as of_base, scanner_agent(scanner, ANYWHERE, tmp_path, own) as of_scanner:
        address = {
            "base": of_base.endpoints.control,
            "scanner": of_scanner.endpoints.control,
            "bulk": of_scanner.endpoints.bulk,
        }[group]
        own.dies = True
        for keyring in (keyrings[1], Keyring(own.folder.with_name("stranger"))):
            with ExitStack() as stack:
                sockets = Sockets(keyring, own.own.public)
                asking = [stack.enter_context(sockets.dealer(address)) for _ in operations]
                for number, (socket, body) in enumerate(zip(asking, operations, strict=True)):
                    call(socket, wire_samples.sample(body), f"r{number}")
                assert not asking[0].poll(SILENCE_MS)
                assert [body for socket, body in zip(asking, operations, strict=True) if socket.poll(0)] == []
        assert (base.driven, base.stops, scanner.started) == ([], 0, [])


def test_a_stranger_is_refused_by_each_message_too_should_handshakes_not_be_judged(keyrings, monkeypatch):
    class Absent:
        def __init__(self, socket: zmq.Socket, knows: object) -> None:
            socket.close()

        def mourn(self, died: object) -> None:
            pass

        def close(self) -> None:
            pass

    monkeypatch.setattr(sockets_module, "Authenticator", Absent)
    own, friend = keyrings
    with (
        base_agent(FakeBase(), ANYWHERE, own) as agent,
        Sockets(friend, own.own.public).dealer(agent.endpoints.control) as socket,
    ):
        call(socket)
        assert socket.poll(20_000)
        assert replies.decode(socket.recv()).body.code == "NOT_ALLOWED"


def test_plain_clients_of_other_mechanisms_are_hung_up_on(keyrings):
    own, _ = keyrings
    with base_agent(FakeBase(), ANYWHERE, own) as agent:
        for mechanism in ("NULL", "PLAIN"):
            context = zmq.Context()
            socket = context.socket(zmq.DEALER)
            if mechanism == "PLAIN":
                socket.plain_username, socket.plain_password = b"user", b"password"
            socket.linger = 0
            socket.connect(agent.endpoints.control)
            call(socket)
            assert not socket.poll(SILENCE_MS)
            socket.close()
            context.term()


def test_closing_gives_the_address_back(keyrings):
    own, friend = keyrings
    for _ in range(3):
        with (
            base_agent(FakeBase(), ANYWHERE, own) as agent,
            Sockets(friend, own.own.public).dealer(agent.endpoints.control) as socket,
        ):
            call(socket)
            assert socket.poll(20_000)
    assert not [thread for thread in threading.enumerate() if thread.name in ("authenticator", "mourner")]
