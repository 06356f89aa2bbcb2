"""The base's state by PUB/SUB: nobody asks, nothing queues, the newest wins."""

import logging
import time
from collections.abc import Callable
from dataclasses import replace

import zmq

from drivers.devices import BaseTelemetry
from drivers.interfaces import BaseState
from drivers.lease import LeaseKeeper
from drivers.messages import PROTOCOL, Pose, Telemetry
from drivers.wire.attended import AttendedSocket
from drivers.wire.codec import Codec, UndecodableError, encode

log = logging.getLogger(__name__)

PERIOD_S = 0.05
_POLL_MS = 50

_telemetry: Codec[Telemetry] = Codec(Telemetry)


class Publisher:
    """Publishes what ``sample`` returns every ``period`` seconds in a thread of its own; owns the bound PUB.

    Each time with a nonce of ``keeper``, which whoever moves the base echoes in time.
    """

    def __init__(
        self,
        socket: zmq.Socket,
        sample: Callable[[], BaseTelemetry],
        boot: str,
        keeper: LeaseKeeper,
        period: float = PERIOD_S,
    ) -> None:
        self._sample = sample
        self._boot = boot
        self._keeper = keeper
        self._period = period
        self._sequence = 0
        self._attended = AttendedSocket(socket, self._publish, "telemetry")

    def close(self) -> None:
        """Stop publishing and close the socket. Harmless when closed."""
        self._attended.close()

    def _publish(self, socket: zmq.Socket) -> None:
        time.sleep(self._period)
        self._sequence += 1
        try:
            socket.send(encode(self._message(self._sequence)), zmq.NOBLOCK)
        except Exception:
            # A silence is what the other side notices; a dead publisher would never speak again.
            log.exception("no telemetry this time")

    def _message(self, sequence: int) -> Telemetry:
        at, now = time.monotonic(), self._sample()
        return Telemetry(
            PROTOCOL,
            self._boot,
            sequence,
            at,
            Pose.of(now.odom_from_base),
            None if now.map_from_base is None else Pose.of(now.map_from_base),
            bool(now.moving),
            bool(now.emergency_stop),
            min(max(float(now.battery), 0.0), 1.0),
            now.activity,
            self._keeper.nonce(),
            self._keeper.owner,
        )


class Listener:
    """Keeps the newest telemetry, received in a thread of its own; owns the connected SUB."""

    def __init__(self, socket: zmq.Socket) -> None:
        self._boot, self._sequence = "", -1
        self._heard: tuple[str, float] = "", 0.0
        self._gone: set[str] = set()
        self._newest: tuple[BaseState, float] | None = None
        self.nonce: int | None = None
        """Of the newest telemetry; None before the first."""
        self._attended = AttendedSocket(socket, self._listen, "telemetry")

    def state(self) -> BaseState | None:
        """The newest state with its age by this side's monotonic clock; None before the first."""
        newest = self._newest
        if newest is None:
            return None
        state, received = newest
        return replace(state, age=time.monotonic() - received)

    def has_heard(self, boot: str | None, clock: float) -> bool:
        """Whether the newest telemetry is of this instant of an agent's clock or later, or of a later process of it."""
        speaks, at = self._heard
        return boot is None or boot in self._gone or (speaks == boot and at >= clock)

    def close(self) -> None:
        """Stop listening and close the socket. Harmless when closed."""
        self._attended.close()

    def _listen(self, socket: zmq.Socket) -> None:
        if socket.poll(_POLL_MS):
            self._accept(socket.recv())

    def _accept(self, frame: bytes) -> None:
        try:
            message = _telemetry.decode(frame)
        except UndecodableError as error:
            log.warning("telemetry that is none: %s", error)
            return
        if message.boot in self._gone:
            return  # a word that was held up, of a process that another has followed
        if message.boot != self._boot or message.sequence > self._sequence:
            self._gone |= {self._boot} - {message.boot}
            self._boot, self._sequence = message.boot, message.sequence
            # Computed here rather than when asked: whoever asks is the tick, which has no time for it.
            self._newest = _state(message), time.monotonic()
            self._heard = message.boot, message.clock
            self.nonce = message.nonce


def _state(message: Telemetry) -> BaseState:
    return BaseState(
        message.odom_from_base.matrix(),
        None if message.map_from_base is None else message.map_from_base.matrix(),
        message.moving,
        message.emergency_stop,
        message.battery,
        message.activity,
        age=0.0,
        owner=message.owner,
        odom_frame=message.boot,
    )
