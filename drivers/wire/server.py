"""The agent's side of a conversation: answers requests, obeys each command once and only while it is fresh."""

import logging
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

import zmq

from drivers.messages import PROTOCOL, Body, Command, Problem, Reply, Request, Stale
from drivers.wire.codec import Codec, UndecodableError, encode
from perception.failure import FailureError

log = logging.getLogger(__name__)

REMEMBERED = 1000
"""Replies kept. A command is void after some seconds, so none can come again after its reply was forgotten."""
MAX_FRAMES = 8
POLL_MS = 50


class Server:
    """Answers on one ROUTER in one thread.

    Args:
        socket: bound; owned, and closed, by the server from now on.
        requests: the union of bodies that are understood here.
        handle: gives the reply to a body, at once; what it raises becomes a :class:`Problem`.
        boot: name of this run of the agent.
    """

    def __init__(self, socket: zmq.Socket, requests: Any, handle: Callable[[Any], Body], boot: str, name: str) -> None:
        self._socket = socket
        self._codec: Codec[Request[Any]] = Codec(Request[requests])
        self._handle = handle
        self._boot = boot
        self._replies: OrderedDict[str, Body] = OrderedDict()
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop answering and close the socket. Harmless when closed."""
        self._closing.set()
        self._thread.join()

    def _run(self) -> None:
        with self._socket as socket:
            while not self._closing.is_set():
                if not socket.poll(POLL_MS):
                    continue
                *route, frame = socket.recv_multipart()
                if route and len(route) < MAX_FRAMES:
                    self._send(socket, route, self._answer(frame))

    def _send(self, socket: zmq.Socket, route: list[bytes], reply: bytes) -> None:
        try:
            socket.send_multipart([*route, reply], zmq.NOBLOCK)
        except zmq.ZMQError as error:
            # Whoever asked is gone or does not read; it will ask again by the same id if it still wants to know.
            log.debug("a reply could not be delivered: %s", error)

    def _answer(self, frame: bytes) -> bytes:
        try:
            request = self._codec.decode(frame)
        except UndecodableError as error:
            code = "PROTOCOL_MISMATCH" if error.foreign else "BAD_MESSAGE"
            return self._encode(error.request_id, Problem(code, str(error)[:4096]))
        return self._encode(request.request_id, self._reply(request))

    def _encode(self, request_id: str, body: Body) -> bytes:
        try:
            return encode(Reply(PROTOCOL, request_id, body, self._boot, time.monotonic()))
        except FailureError as error:
            return self._encode(request_id, Problem.of(error.failure))
        except TypeError as error:
            return self._encode(request_id, _exception(error))

    def _reply(self, request: Request[Any]) -> Body:
        body = request.body
        if not isinstance(body, Command):
            return self._obey(body)
        if request.request_id in self._replies:
            return self._replies[request.request_id]
        if not (body.always or self._is_fresh(request)):
            return Stale()
        reply = self._replies[request.request_id] = self._obey(body)
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


def _exception(error: Exception) -> Problem:
    return Problem("AGENT_EXCEPTION", f"{type(error).__name__}: {error}"[:4096])
