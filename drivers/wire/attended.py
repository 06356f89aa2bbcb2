"""A thread that owns a socket, which no other may touch, and serves it until it is closed."""

import threading
from collections.abc import Callable

import zmq


class AttendedSocket:
    """Does one ``step`` with the socket after another; the socket is closed with it.

    Args:
        step: takes some 50 ms at most, for so long ``close`` may have to wait; must not raise.
    """

    def __init__(self, socket: zmq.Socket, step: Callable[[zmq.Socket], None], name: str) -> None:
        self._socket = socket
        self._step = step
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name=name, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Stop, and close the socket. Harmless when closed."""
        self._closing.set()
        self._thread.join()

    def _run(self) -> None:
        with self._socket as socket:
            while not self._closing.is_set():
                self._step(socket)
