"""What systemd hears."""

import socket
from pathlib import Path

import pytest

from mission.watchdog import ServiceManager


@pytest.fixture
def manager(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> socket.socket:
    link = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    link.bind(str(tmp_path / "notify"))
    link.setblocking(False)
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "notify"))
    return link


def test_a_service_is_ready_alive_and_stopping(manager: socket.socket) -> None:
    service = ServiceManager()
    service.ready()
    service.tick("RUNNING")
    service.tick("RUNNING")
    service.stopping()
    told = [manager.recv(100).decode() for _ in range(3)]
    assert told == ["READY=1", "WATCHDOG=1\nSTATUS=RUNNING", "STOPPING=1"]
    with pytest.raises(BlockingIOError):
        manager.recv(100)


def test_a_manager_that_is_gone_or_never_was_does_no_harm(
    manager: socket.socket, monkeypatch: pytest.MonkeyPatch
) -> None:
    gone = ServiceManager()
    manager.close()
    gone.tick("RUNNING")
    monkeypatch.delenv("NOTIFY_SOCKET")
    ServiceManager().tick("RUNNING")
