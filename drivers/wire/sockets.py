"""The one place where sockets are made, so that their limits, and who may connect, are decided in one place.

A socket belongs to the thread that uses it. There is no REQ among them: one lost reply makes it useless for ever.
"""

import zmq

from drivers.messages import MAX_MESSAGE
from drivers.wire.endpoints import is_local
from perception.failure import FailureError

_LIMITS = {
    zmq.LINGER: 0,
    zmq.MAXMSGSIZE: MAX_MESSAGE,
    zmq.SNDHWM: 64,
    zmq.RCVHWM: 64,
    zmq.HANDSHAKE_IVL: 2000,
    zmq.BACKLOG: 32,
    # Of the link only: libzmq answers these even while the process behind it is stuck.
    zmq.HEARTBEAT_IVL: 1000,
    zmq.HEARTBEAT_TIMEOUT: 3000,
    zmq.RECONNECT_IVL: 50,
    zmq.RECONNECT_IVL_MAX: 1000,
    zmq.CONNECT_TIMEOUT: 2000,
}


class Sockets:
    """Makes the sockets of one process.

    Args:
        allow_remote: whether ``router`` and ``publisher`` may be reachable from other machines.
    """

    def __init__(self, allow_remote: bool = False) -> None:
        self._allow_remote = allow_remote

    def router(self, endpoint: str) -> tuple[zmq.Socket, str]:
        """A bound ROUTER and the address it got. Raises as :meth:`publisher`."""
        socket = self._make(zmq.ROUTER)
        socket.setsockopt(zmq.ROUTER_MANDATORY, 1)
        return socket, self._bind(socket, endpoint)

    def publisher(self, endpoint: str) -> tuple[zmq.Socket, str]:
        """A bound PUB and the address it got.

        Raises:
            FailureError: ``ENDPOINT_NOT_LOCAL`` or ``ENDPOINT_UNAVAILABLE``.
        """
        socket = self._make(zmq.PUB)
        return socket, self._bind(socket, endpoint)

    def dealer(self, endpoint: str) -> zmq.Socket:
        """A DEALER that connects when it can. Raises ``ENDPOINT_UNAVAILABLE`` for what is no address."""
        return self._connect(self._make(zmq.DEALER), endpoint)

    def subscriber(self, endpoint: str) -> zmq.Socket:
        """A SUB that keeps only the newest frame. Raises as :meth:`dealer`."""
        socket = self._make(zmq.SUB)
        socket.setsockopt(zmq.CONFLATE, 1)  # before connect, or it does nothing
        socket.setsockopt(zmq.SUBSCRIBE, b"")
        return self._connect(socket, endpoint)

    def _make(self, kind: int) -> zmq.Socket:
        socket: zmq.Socket = zmq.Context.instance().socket(kind)
        for option, value in _LIMITS.items():
            socket.setsockopt(option, value)
        return socket

    def _bind(self, socket: zmq.Socket, endpoint: str) -> str:
        if not (self._allow_remote or is_local(endpoint)):
            socket.close()
            raise FailureError(
                "ENDPOINT_NOT_LOCAL", f"{endpoint} is open to other machines, which was not allowed", endpoint=endpoint
            )
        try:
            socket.bind(endpoint)
        except zmq.ZMQError as error:
            socket.close()
            raise FailureError(
                "ENDPOINT_UNAVAILABLE", f"cannot listen on {endpoint}: {error.strerror}", endpoint=endpoint
            ) from error
        return socket.get_string(zmq.LAST_ENDPOINT).rstrip("\0")

    def _connect(self, socket: zmq.Socket, endpoint: str) -> zmq.Socket:
        try:
            socket.connect(endpoint)
        except zmq.ZMQError as error:
            socket.close()
            raise FailureError(
                "ENDPOINT_UNAVAILABLE", f"cannot connect to {endpoint}: {error.strerror}", endpoint=endpoint
            ) from error
        return socket
