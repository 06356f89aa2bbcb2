"""The agents' processes: a device, real or simulated, put on the wire until somebody ends it."""

import logging
import signal
import threading
import uuid
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from drivers.devices import BaseDevice, ScannerDevice
from drivers.messages import BaseRequest, BulkRequest, ScannerRequest
from drivers.wire.base_server import BaseService
from drivers.wire.endpoints import Endpoints
from drivers.wire.scanner_server import ScannerService
from drivers.wire.server import Server
from drivers.wire.sockets import Sockets
from drivers.wire.telemetry import Publisher

log = logging.getLogger(__name__)


class Agent:
    """A device being served. Use as a context manager, or ``close``.

    Attributes:
        endpoints: what was really bound, where ``*`` was asked for.
    """

    def __init__(self, endpoints: Endpoints, resources: ExitStack) -> None:
        self.endpoints = endpoints
        self._resources = resources

    def __enter__(self) -> "Agent":
        return self

    def __exit__(self, *exception: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop answering, then stop the device. Harmless when closed."""
        self._resources.close()


def scanner_agent(device: ScannerDevice, endpoints: Endpoints, spool: Path, allow_remote: bool = False) -> Agent:
    """Serve a scanner; ``spool`` is the folder that keeps its scans until they were fetched.

    Raises:
        FailureError: ``ENDPOINT_NOT_LOCAL``, ``ENDPOINT_UNAVAILABLE``.
    """
    boot, sockets = uuid.uuid4().hex, Sockets(allow_remote)
    with ExitStack() as resources:
        control_socket, control = sockets.router(endpoints.control)
        resources.enter_context(control_socket)
        bulk_socket, bulk = sockets.router(endpoints.bulk)
        service = ScannerService(device, spool)
        resources.callback(service.close)
        resources.callback(Server(bulk_socket, BulkRequest, service.bulk, boot, "bulk").close)
        resources.callback(Server(control_socket, ScannerRequest, service.control, boot, "control").close)
        return Agent(Endpoints(control, bulk=bulk), resources.pop_all())


def base_agent(device: BaseDevice, endpoints: Endpoints, allow_remote: bool = False) -> Agent:
    """Serve a base. Raises as :func:`scanner_agent`."""
    boot, sockets = uuid.uuid4().hex, Sockets(allow_remote)
    with ExitStack() as resources:
        control_socket, control = sockets.router(endpoints.control)
        resources.enter_context(control_socket)
        telemetry_socket, telemetry = sockets.publisher(endpoints.telemetry)
        service = BaseService(device)
        resources.callback(service.close)
        resources.callback(Publisher(telemetry_socket, device.telemetry, boot).close)
        resources.callback(Server(control_socket, BaseRequest, service.control, boot, "control").close)
        return Agent(Endpoints(control, telemetry=telemetry), resources.pop_all())


def serve_scanner(
    device: ScannerDevice,
    endpoints: Endpoints,
    spool: Path,
    announce: Callable[[Endpoints], None] | None = None,
    stop: threading.Event | None = None,
    allow_remote: bool = False,
) -> None:
    """The scanner agent's whole process: serve until SIGTERM, SIGINT or ``stop``. Raises as :func:`scanner_agent`.

    Args:
        announce: called with the bound endpoints once the agent answers.
    """
    _serve(scanner_agent(device, endpoints, spool, allow_remote), announce, stop)


def serve_base(
    device: BaseDevice,
    endpoints: Endpoints,
    announce: Callable[[Endpoints], None] | None = None,
    stop: threading.Event | None = None,
    allow_remote: bool = False,
) -> None:
    """The base agent's whole process; the base stands still when it ends. See :func:`serve_scanner`."""
    _serve(base_agent(device, endpoints, allow_remote), announce, stop)


def _serve(agent: Agent, announce: Callable[[Endpoints], None] | None, stop: threading.Event | None) -> None:
    stop = stop or threading.Event()
    with agent:
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGTERM, signal.SIGINT):
                signal.signal(number, lambda *_: stop.set())
        log.info("serving at %s", agent.endpoints)
        if announce is not None:
            announce(agent.endpoints)
        while not stop.wait(1.0):  # with a timeout, so that signals get a turn
            pass
