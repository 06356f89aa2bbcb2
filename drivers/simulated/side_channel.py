"""The one place where truth crosses between the two simulated agents.

A real scanner stands on a real base; the simulated ones are two processes, so the scanner must ask the base where it
truly stands before it can cast a ray. Nothing but the simulated scanner may ask: the executive knows no such endpoint,
and what it is told holds no truth.
"""

import logging
import time
from collections.abc import Callable

import msgspec
import zmq

from drivers.simulated.bodies import Body
from drivers.simulated.stance import Stance
from drivers.wire.attended import AttendedSocket
from drivers.wire.sockets import Sockets
from perception import transforms
from perception.failure import FailureError

log = logging.getLogger(__name__)

_POLL_MS = 50
_TRY_S = 0.5


class _Told(msgspec.Struct, frozen=True):
    """A stance as it travels, under the number of the question that it answers."""

    question: int
    pose: tuple[float, float, float]
    tilt: tuple[float, float]
    bodies: tuple[Body, ...]
    moving: bool


class StanceServer:
    """Answers, in a thread of the base's process, where the base stands.

    Args:
        stance: tells the truth as of now; must not block.
        endpoint: loopback address to listen on; port ``*`` takes any, see :attr:`endpoint`.
    """

    def __init__(self, stance: Callable[[], Stance], endpoint: str = "tcp://127.0.0.1:*") -> None:
        self._stance = stance
        socket, self.endpoint = Sockets().router(endpoint)
        self._attended = AttendedSocket(socket, self._serve, "stance")

    def close(self) -> None:
        """Stop answering. Harmless when closed."""
        self._attended.close()

    def _serve(self, socket: zmq.Socket) -> None:
        if not socket.poll(_POLL_MS):
            return
        *route, frame = socket.recv_multipart()
        try:
            question = msgspec.msgpack.decode(frame, type=int)
            socket.send_multipart([*route, msgspec.msgpack.encode(self._tell(question))], zmq.NOBLOCK)
        except (ValueError, RecursionError, zmq.ZMQError) as error:  # what msgspec raises are ValueErrors
            log.debug("a question for the stance was not answered: %s", error)

    def _tell(self, question: int) -> _Told:
        stance = self._stance()
        return _Told(question, transforms.to_planar(stance.map_from_base), stance.tilt, stance.bodies, stance.moving)


def ask_stance(endpoint: str, timeout: float = 20.0) -> Stance:
    """Where the base truly stands, asked anew until ``timeout`` real seconds are over; raises ``SCAN_FAILED``.

    Each question is given twice the time of the one before: on a busy machine every answer may come late, and a late
    answer to an earlier question tells where the base was, not where it is.
    """
    deadline, patience = time.monotonic() + timeout, _TRY_S
    question = 0
    with Sockets().dealer(endpoint) as socket:
        while time.monotonic() < deadline:
            question += 1
            socket.send(msgspec.msgpack.encode(question))
            told = _answer(socket, question, min(deadline, time.monotonic() + patience))
            if told is not None:
                return Stance(transforms.planar(*told.pose), told.tilt, told.bodies, told.moving)
            patience *= 2
    raise FailureError("SCAN_FAILED", f"no simulated base answers at {endpoint}", endpoint=endpoint)


def _answer(socket: zmq.Socket[bytes], question: int, deadline: float) -> _Told | None:
    while (left := deadline - time.monotonic()) > 0:
        if socket.poll(int(1000 * left)):
            told = msgspec.msgpack.decode(socket.recv(), type=_Told)
            if told.question == question:
                return told
    return None
