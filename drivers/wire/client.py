"""The executive's side of a conversation: one DEALER, asked again by the same id until it answers or patience ends."""

import math
import time
import uuid
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, TypeVar

import zmq

from drivers.jobs import Progress
from drivers.messages import PROTOCOL, AnyReply, Body, Command, Problem, Reply, Request, Stale
from drivers.wire.codec import Codec, UndecodableError, encode
from drivers.wire.sockets import Sockets
from perception.failure import FailureError

CANCEL_LATENCY_S = 0.02

_replies: Codec[Reply[Any]] = Codec(Reply[AnyReply])

R = TypeVar("R", bound=Body)


@dataclass(frozen=True)
class Patience:
    """How long an answer is waited for before asking again, from ``first`` doubling to ``longest``, ``total`` in all.

    All in seconds. ``longest`` is also the life of a command: it is void after that, wherever it was held up.
    """

    first: float = 0.5
    longest: float = 2.0
    total: float = 10.0

    def attempts(self) -> Iterator[float]:
        """How long to wait, each time."""
        end = time.monotonic() + self.total
        wait = self.first
        while (left := end - time.monotonic()) > 0:
            yield min(wait, left)
            wait = min(2 * wait, self.longest)


class Link:
    """A conversation with one agent, for the thread that made it. Use as a context manager.

    Args:
        progress: the job that is served; its cancelling ends any waiting with ``CANCELLED``.
        replies: reads what comes back; by default whatever an agent may say.
    """

    def __init__(
        self,
        sockets: Sockets,
        endpoint: str,
        patience: Patience,
        progress: Progress,
        replies: Codec[Reply[Any]] = _replies,
    ) -> None:
        self._sockets = sockets
        self._endpoint = endpoint
        self._patience = patience
        self._progress = progress
        self._replies = replies
        self._socket = sockets.dealer(endpoint)
        self._boot: str | None = None
        self._clock = self._clock_offset = 0.0
        self._undecodable = ""

    def __enter__(self) -> "Link":
        return self

    def __exit__(self, *exception: object) -> None:
        self._socket.close()

    @property
    def boot(self) -> str | None:
        """Which process of the agent spoke last; None before the first word."""
        return self._boot

    @property
    def clock(self) -> float:
        """When it spoke last, by its own clock."""
        return self._clock

    def ask(self, body: Body, expected: type[R] | tuple[type[R], ...], once: bool = False) -> R:
        """The agent's answer to ``body``.

        Args:
            expected: the replies that make sense.
            once: whether the request dies with the agent's process, instead of being put to the next one too.

        Raises:
            FailureError: what the agent replied; ``AGENT_UNREACHABLE`` when patience ended, ``AGENT_RESTARTED``
                (with ``once``), ``PROTOCOL_MISMATCH``, ``CANCELLED``.
        """
        request_id = uuid.uuid4().hex
        for wait in self._patience.attempts():
            self.send(body, request_id)
            reply = self._answer_to(request_id, body, wait, once)
            if reply is None:
                self.renew()
            elif isinstance(reply, expected):
                return reply
            else:
                raise FailureError("BAD_REPLY", f"{self._endpoint} answered {body} by {reply}"[:500])
        raise self.unreachable()

    def send(self, body: Body, request_id: str) -> None:
        """Send one request, stamped for the agent last heard of."""
        boot, until = None, None
        if isinstance(body, Command) and self._boot is not None:
            boot, until = self._boot, time.monotonic() + self._clock_offset + self._patience.longest
        frame = encode(Request(PROTOCOL, request_id, body, boot, until))
        try:
            self._socket.send(frame, zmq.NOBLOCK)
        except zmq.Again:
            self.renew()

    def receive(self, seconds: float) -> Reply[Any] | None:
        """The next reply to anything, or None after so long. Raises ``PROTOCOL_MISMATCH`` and ``CANCELLED``."""
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            self._progress.wait(0.0)
            if not self._socket.poll(math.ceil(1000 * min(left, CANCEL_LATENCY_S))):
                continue
            reply = self._decode(self._socket.recv())
            if reply is not None:
                self._boot, self._clock = reply.boot, reply.clock
                self._clock_offset = reply.clock - time.monotonic()
                return reply
        return None

    def renew(self) -> None:
        """Drop a link that is silent, with all that waits in its queues, and make a new one."""
        self._socket.close()
        self._socket = self._sockets.dealer(self._endpoint)

    def unreachable(self) -> FailureError:
        return FailureError(
            "AGENT_UNREACHABLE",
            f"no answer from {self._endpoint} in {self._patience.total:g} s{self._sockets.advice}",
            endpoint=self._endpoint,
            waited_s=self._patience.total,
            undecodable=self._undecodable,
        )

    def _answer_to(self, request_id: str, body: Body, seconds: float, once: bool) -> Body | None:
        end = time.monotonic() + seconds
        while (left := end - time.monotonic()) > 0:
            known = self._boot
            reply = self.receive(left)
            if reply is None or reply.request_id != request_id:
                continue
            if isinstance(reply.body, Problem):
                raise reply.body.error()
            if not isinstance(reply.body, Stale):
                return reply.body
            if once and known not in (None, reply.boot):
                raise FailureError(
                    "AGENT_RESTARTED", f"the agent at {self._endpoint} restarted", endpoint=self._endpoint
                )
            self.send(body, request_id)
        return None

    def _decode(self, frame: bytes) -> Reply[Any] | None:
        try:
            return self._replies.decode(frame)
        except UndecodableError as error:
            if error.foreign:
                raise FailureError(
                    "PROTOCOL_MISMATCH",
                    f"{self._endpoint} speaks version {error.version} of the protocol, this side {PROTOCOL}",
                    theirs=error.version,
                    ours=PROTOCOL,
                ) from error
            self._undecodable = str(error)
            return None
