"""A cable that can be cut: carries TCP, and while it is cut keeps what was sent and delivers it late."""

import socket
import threading
from urllib.parse import urlsplit

_PIECE = 1 << 16


class TcpLink:
    """Stands before a TCP endpoint; neither side is told when it is cut, as with a radio that is out of reach."""

    def __init__(self, target: str) -> None:
        address = urlsplit(target)
        self._target = (address.hostname, address.port)
        self._whole = threading.Event()
        self._whole.set()
        self._ends: list[socket.socket] = []
        self._door = socket.create_server(("127.0.0.1", 0))
        self.endpoint = f"tcp://127.0.0.1:{self._door.getsockname()[1]}"
        threading.Thread(target=self._accept, daemon=True).start()

    def __enter__(self) -> "TcpLink":
        return self

    def __exit__(self, *exception: object) -> None:
        self._whole.set()
        for end in (self._door, *self._ends):
            end.close()

    def cut(self) -> None:
        self._whole.clear()

    def heal(self) -> None:
        """Deliver all that was held back, and carry on."""
        self._whole.set()

    def _accept(self) -> None:
        while True:
            try:
                near, _ = self._door.accept()
                far = socket.create_connection(self._target)
            except OSError:  # one of the ends is gone
                return
            self._ends += [near, far]
            for source, sink in ((near, far), (far, near)):
                threading.Thread(target=self._carry, args=(source, sink), daemon=True).start()

    def _carry(self, source: socket.socket, sink: socket.socket) -> None:
        try:
            while piece := source.recv(_PIECE):
                self._whole.wait()
                sink.sendall(piece)
        except OSError:  # closed on either side
            pass
        finally:
            source.close()
            sink.close()
