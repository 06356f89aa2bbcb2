"""The agents' processes: a device, real or simulated, put on the wire until somebody ends it."""

import logging
import resource
import signal
import threading
import time
import uuid
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from drivers.devices import BaseDevice, ScannerDevice
from drivers.lease import LeaseKeeper
from drivers.messages import BaseRequest, BulkRequest, ScannerRequest
from drivers.wire.base_server import BaseService
from drivers.wire.endpoints import Endpoints
from drivers.wire.keys import Keyring
from drivers.wire.scanner_server import ScannerService
from drivers.wire.server import BULK_RATE, Server
from drivers.wire.sockets import Sockets
from drivers.wire.telemetry import Publisher
from perception.failure import FailureError

log = logging.getLogger(__name__)

FILES = 4096
"""Files and connections that an agent's process may have open at once, where the system lets it."""


class Agent:
    """A device being served. Use as a context manager, or ``close``.

    It closes by itself when the thread that judges who may come in has died.

    Attributes:
        endpoints: what was really bound, where ``*`` was asked for.
        broken: whether it closed by itself.
    """

    def __init__(self, endpoints: Endpoints, sockets: Sockets, resources: ExitStack) -> None:
        self.endpoints = endpoints
        self.broken = threading.Event()
        self._resources = resources
        self._closing = threading.Lock()
        sockets.watch(self._break)

    def __enter__(self) -> "Agent":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop answering, then stop the device. Harmless when closed."""
        with self._closing:
            self._resources.close()

    def _break(self) -> None:
        log.critical("nobody judges any more who may come in: closing")
        self.close()
        self.broken.set()


def scanner_agent(device: ScannerDevice, endpoints: Endpoints, spool: Path, keyring: Keyring | None = None) -> Agent:
    """Serve a scanner.

    Args:
        spool: folder that keeps its scans until they were fetched.
        keyring: who may come in; without one only this machine can.

    Raises:
        FailureError: ``ENDPOINT_NEEDS_KEYS``, ``ENDPOINT_UNAVAILABLE``, or what is wrong with the keys.
    """
    boot, sockets = uuid.uuid4().hex, Sockets(keyring)
    with ExitStack() as resources:
        resources.callback(sockets.close)
        control_socket, control = sockets.router(endpoints.control)
        resources.enter_context(control_socket)
        bulk_socket, bulk = sockets.router(endpoints.bulk)
        service = ScannerService(device, spool)
        resources.callback(service.close)
        gate = sockets.gate
        resources.callback(Server(bulk_socket, BulkRequest, service.bulk, boot, "bulk", gate, BULK_RATE).close)
        resources.callback(Server(control_socket, ScannerRequest, service.control, boot, "control", gate).close)
        return Agent(Endpoints(control, bulk=bulk, server_key=sockets.public_key), sockets, resources.pop_all())


def base_agent(
    device: BaseDevice, endpoints: Endpoints, keyring: Keyring | None = None, keeper: LeaseKeeper | None = None
) -> Agent:
    """Serve a base, to one owner at a time. Raises as :func:`scanner_agent`."""
    # Nanoseconds, because a computer without a battery boots at the same second every day.
    keeper = keeper or LeaseKeeper(time.time_ns())
    boot, sockets = uuid.uuid4().hex, Sockets(keyring)
    with ExitStack() as resources:
        resources.callback(sockets.close)
        control_socket, control = sockets.router(endpoints.control)
        resources.enter_context(control_socket)
        telemetry_socket, telemetry = sockets.publisher(endpoints.telemetry)
        service = BaseService(device, keeper)
        resources.callback(service.close)
        resources.callback(Publisher(telemetry_socket, device.telemetry, boot, keeper).close)
        resources.callback(Server(control_socket, BaseRequest, service.control, boot, "control", sockets.gate).close)
        found = Endpoints(control, telemetry=telemetry, server_key=sockets.public_key)
        return Agent(found, sockets, resources.pop_all())


def serve_scanner(
    device: ScannerDevice,
    endpoints: Endpoints,
    spool: Path,
    announce: Callable[[Endpoints], None] | None = None,
    stop: threading.Event | None = None,
    keyring: Keyring | None = None,
) -> None:
    """The scanner agent's whole process: serve until SIGTERM, SIGINT or ``stop``. Raises as :func:`scanner_agent`.

    Args:
        announce: called with the bound endpoints once the agent answers.
    """
    _serve(scanner_agent(device, endpoints, spool, keyring), announce, stop)


def serve_base(
    device: BaseDevice,
    endpoints: Endpoints,
    announce: Callable[[Endpoints], None] | None = None,
    stop: threading.Event | None = None,
    keyring: Keyring | None = None,
) -> None:
    """The base agent's whole process; the base stands still when it ends. See :func:`serve_scanner`."""
    _serve(base_agent(device, endpoints, keyring), announce, stop)


def _allow_many_files() -> None:
    """Connections are files: a crowd of them must not be what keeps a scan from being stored."""
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    wanted = FILES if hard == resource.RLIM_INFINITY else min(FILES, hard)
    if soft != resource.RLIM_INFINITY and soft < wanted:
        resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))


def _serve(agent: Agent, announce: Callable[[Endpoints], None] | None, stop: threading.Event | None) -> None:
    stop = stop or threading.Event()
    _allow_many_files()
    with agent:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGTERM, signal.SIGINT):
                signal.signal(number, lambda *_: stop.set())
        log.info("serving at %s", agent.endpoints)
        if announce is not None:
            announce(agent.endpoints)
        while not (stop.wait(0.5) or agent.broken.is_set()):  # with a timeout, so that signals get a turn
            pass
    if agent.broken.is_set():
        raise FailureError("AUTHENTICATOR_DIED", "nobody judged any more who may come in, so the agent ended")
