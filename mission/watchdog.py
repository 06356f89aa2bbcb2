"""Tells systemd that the mission is alive, from the tick loop and nowhere else, so that a stuck loop is noticed."""

import os
import socket
import time


class ServiceManager:
    """``sd_notify`` over the socket that systemd names; does nothing where the process is no service of it."""

    INTERVAL_S = 1.0

    def __init__(self) -> None:
        address = os.environ.get("NOTIFY_SOCKET", "")
        self._address = "\0" + address[1:] if address.startswith("@") else address
        self._next = 0.0

    def ready(self) -> None:
        self._send("READY=1")

    def tick(self, status: str) -> None:
        """Call at every tick; tells at most once a second."""
        if self._address and time.monotonic() >= self._next:
            self._next = time.monotonic() + self.INTERVAL_S
            self._send(f"WATCHDOG=1\nSTATUS={status}")

    def stopping(self) -> None:
        self._send("STOPPING=1")

    def _send(self, text: str) -> None:
        if self._address:
            with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
                link.setblocking(False)
                try:
                    link.sendto(text.encode(), self._address)
                except OSError:
                    return  # who does not listen decides by the silence
