"""Who is let through a handshake (ZAP, ZeroMQ RFC 27): those whose key is known, and nobody when in doubt.

libzmq asks no more questions when nobody listens on the address below: it then lets everybody in. So the socket that is
bound there stays bound, whatever becomes of the thread that answers on it, until all others of its context are closed:
without an answer a handshake runs into its time limit.
"""

import logging
import threading
from collections.abc import Callable

import zmq

from drivers.wire.rates import Rates

log = logging.getLogger(__name__)

ADDRESS = "inproc://zeromq.zap.01"
DOMAIN = b"mission"
HANDSHAKES_PER_SECOND = 50.0
_POLL_MS = 50
_KEY_BYTES = 32


class Authenticator:
    """Answers, in a thread of its own, the handshakes of one context.

    Args:
        socket: a ROUTER, owned from now on.
        knows: whether a public key (hexadecimal) may come in; whatever it raises means no.
    """

    def __init__(self, socket: zmq.Socket, knows: Callable[[str], bool]) -> None:
        self._socket = socket
        self._knows = knows
        self._rates = Rates(HANDSHAKES_PER_SECOND)
        self._told = Rates(1 / 60, burst=1)
        self._closing = threading.Event()
        socket.bind(ADDRESS)
        self._thread = threading.Thread(target=self._run, name="authenticator", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Let nobody in any more and free the address; only when all other sockets of the context are closed."""
        self._closing.set()
        self._thread.join()
        self._socket.close()

    def mourn(self, died: Callable[[], None]) -> None:
        """Call ``died``, from a thread of its own, if this ends without having been closed."""

        def wait() -> None:
            self._thread.join()
            if not self._closing.is_set():
                died()

        threading.Thread(target=wait, name="mourner", daemon=True).start()

    def _run(self) -> None:
        while not self._closing.is_set():
            if self._socket.poll(_POLL_MS):
                self._answer(self._socket.recv_multipart())

    def _answer(self, frames: list[bytes]) -> None:
        if len(frames) < 4:
            return  # there is not even a number to answer under
        *route, version, number = frames[:4]
        try:
            key = self._admitted(version, *frames[4:])
        except Exception:
            log.exception("a handshake could not be judged, so it is refused")
            key = None
        status, text = (b"400", b"not paired") if key is None else (b"200", b"OK")
        self._socket.send_multipart([*route, b"1.0", number, status, text, (key or "").encode(), b""])

    def _admitted(
        self, version: bytes, domain: bytes, address: bytes, identity: bytes, mechanism: bytes, *credentials: bytes
    ) -> str | None:
        """The key that is let in, or None. Whatever is not CURVE in our domain by a known key is not."""
        key = credentials[0].hex() if credentials else ""
        if (version, domain, mechanism) != (b"1.0", DOMAIN, b"CURVE") or [len(c) for c in credentials] != [_KEY_BYTES]:
            why = f"by {mechanism!r} in {domain!r}"
        elif self._knows(key) is not True:
            why = f"key {key} is not paired"
        elif not self._rates.admits(key):
            why = f"key {key} comes too often"
        else:
            return key
        if self._told.admits(address):
            log.warning("%s was refused: %s", address.decode("ascii", "replace"), why)
        return None
