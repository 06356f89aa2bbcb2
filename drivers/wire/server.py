"""The agent's side of a conversation: answers requests, obeys each command once and only while it is fresh."""

import logging
import time
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import zmq

from drivers.messages import PROTOCOL, Body, Command, Problem, Reply, Request, Stale
from drivers.wire.attended import AttendedSocket
from drivers.wire.codec import Codec, UndecodableError, encode
from drivers.wire.rates import Rates
from drivers.wire.roles import Gate
from perception.failure import FailureError

log = logging.getLogger(__name__)

REMEMBERED = 1000
"""Replies kept. A command is void after some seconds, so none can come again after its reply was forgotten."""
MAX_FRAMES = 4
"""Frames of a message: the way back, over up to two brokers, and the request."""
CONTROL_RATE = 200.0
BULK_RATE = 4000.0
"""Requests a second that each client may send; what is more is dropped unread."""
POLL_MS = 50


class Server:
    """Answers on one ROUTER in one thread.

    Args:
        socket: bound; owned, and closed, by the server from now on.
        requests: the union of bodies that are understood here.
        handle: gives the reply to a body, at once; what it raises becomes a :class:`Problem`.
        boot: name of this run of the agent.
        gate: who may ask what; None only for a plain socket, whose clients are this machine's own.
        rate: requests a second that each client may send.
    """

    def __init__(
        self,
        socket: zmq.Socket,
        requests: Any,
        handle: Callable[[Any], Body],
        boot: str,
        name: str,
        gate: Gate | None = None,
        rate: float = CONTROL_RATE,
    ) -> None:
        if gate is None and socket.getsockopt(zmq.MECHANISM) != zmq.NULL:
            raise ValueError("whoever must prove who he is must be asked what he may do: a gate is missing")
        self._codec: Codec[Request[Any]] = Codec(Request[requests])
        self._handle = handle
        self._boot = boot
        self._gate = gate
        self._rates = Rates(rate)
        self._replies: OrderedDict[tuple[str | None, str], Body] = OrderedDict()
        self._attended = AttendedSocket(socket, self._serve, name)

    def close(self) -> None:
        """Stop answering and close the socket. Harmless when closed."""
        self._attended.close()

    def _serve(self, socket: zmq.Socket) -> None:
        if not socket.poll(POLL_MS):
            return
        *route, frame = _receive(socket)
        if not route or frame.more:
            return
        key = _proven_key(frame) if self._gate else None
        if self._rates.admits(key or route[0].bytes):
            self._send(socket, [part.bytes for part in route], self._answer(frame.bytes, key))

    def _send(self, socket: zmq.Socket, route: list[bytes], reply: bytes) -> None:
        try:
            socket.send_multipart([*route, reply], zmq.NOBLOCK)
        except zmq.ZMQError as error:
            # Whoever asked is gone or does not read; it will ask again by the same id if it still wants to know.
            log.debug("a reply could not be delivered: %s", error)

    def _answer(self, frame: bytes, key: str | None) -> bytes:
        try:
            request = self._codec.decode(frame)
        except UndecodableError as error:
            code = "PROTOCOL_MISMATCH" if error.foreign else "BAD_MESSAGE"
            return self._encode(error.request_id, Problem(code, str(error)[:4096]))
        return self._encode(request.request_id, self._reply(request, key))

    def _encode(self, request_id: str, body: Body) -> bytes:
        try:
            return encode(Reply(PROTOCOL, request_id, body, self._boot, time.monotonic()))
        except FailureError as error:
            return self._encode(request_id, Problem.of(error.failure))
        except (TypeError, ValueError, OverflowError, RecursionError) as error:
            return self._encode(request_id, _exception(error))

    def _reply(self, request: Request[Any], key: str | None) -> Body:
        body = request.body
        refusal = self._gate.refusal(key, type(body)) if self._gate else None
        if refusal is not None:
            return Problem.of(refusal)
        if not isinstance(body, Command):
            return self._obey(body)
        # By its sender too: nobody is told what another one's command came to.
        named = (key, request.request_id)
        if named in self._replies:
            return self._replies[named]
        if not (body.always or self._is_fresh(request)):
            return Stale()
        reply = self._replies[named] = self._obey(body)
        if len(self._replies) > REMEMBERED:
            self._replies.popitem(last=False)
        return reply

    def _is_fresh(self, request: Request[Any]) -> bool:
        until = request.valid_until
        return request.boot == self._boot and until is not None and time.monotonic() <= until

    def _obey(self, body: Body) -> Body:
        try:
            return self._handle(body)
        except FailureError as error:
            return Problem.of(error.failure)
        except Exception as error:
            log.exception("%s could not be handled", type(body).__name__)
            return _exception(error)


def _receive(socket: zmq.Socket) -> list[zmq.Frame]:
    """The next message; of one with too many frames only the first few, the last of which says that there is more."""
    frames = [socket.recv(copy=False)]
    while frames[-1].more and len(frames) < MAX_FRAMES:
        frames.append(socket.recv(copy=False))
    dropped = frames[-1]
    while dropped.more:
        dropped = socket.recv(copy=False)
    return frames


def _proven_key(frame: zmq.Frame) -> str | None:
    """The key that the handshake's judge wrote down for the sender; None when there was no judge."""
    try:
        key = frame.get("User-Id")
    except zmq.ZMQError:
        return None
    return str(key)


def _exception(error: Exception) -> Problem:
    return Problem("AGENT_EXCEPTION", f"{type(error).__name__}: {error}"[:4096])
