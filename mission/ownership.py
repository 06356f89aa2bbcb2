"""Being the one who moves the base: the lease is taken before anything moves, and given back at the end."""

import getpass
import os
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager

from drivers.interfaces import Base, Lease
from drivers.jobs import wait_for
from perception.failure import Failure, FailureError

_PATIENCE_S = 30.0
_GIVE_BACK_S = 2.0
_ALIVE_S = 1.0
"""An owner who beats is heard of ten times in this; one who does not may have been killed."""


def myself() -> str:
    """Host, process and user, as the next one reads them who wants the base."""
    try:
        user = getpass.getuser()
    except (KeyError, OSError):  # a container's user need not have a name
        user = str(os.getuid())
    return f"{user}@{socket.gethostname()} process {os.getpid()}"


@contextmanager
def ownership(base: Base) -> Iterator[Lease]:
    """Own the base inside.

    A base whose owner beats is refused at once. One whose owner fell silent is waited for, some seconds at most: so
    long the base keeps it for a link that comes back, and a mission that was killed is resumed meanwhile.

    Raises:
        FailureError: ``LEASE_HELD``, ``AGENT_UNREACHABLE``.
    """
    lease = _acquire(base, time.monotonic() + _PATIENCE_S)
    _await_word_of(lease, base)
    try:
        yield lease
    finally:
        wait_for(base.release(), _GIVE_BACK_S)


def _acquire(base: Base, give_up: float) -> Lease:
    while isinstance(answer := wait_for(base.acquire(myself()), _PATIENCE_S), Failure):
        wait = _silent_for(answer)
        if wait is None or time.monotonic() + wait > give_up:
            raise FailureError(answer.code, answer.message, **answer.evidence)
        time.sleep(wait)
    return answer


def _await_word_of(lease: Lease, base: Base) -> None:
    """Telemetry tells it a little later, and a mission that is taken up is told again before it could come."""
    until = time.monotonic() + _ALIVE_S
    while ((state := base.state()) is None or state.owner != lease.owner) and time.monotonic() < until:
        time.sleep(0.01)


def _silent_for(failure: Failure) -> float | None:
    """How long until the base is free of an owner who fell silent; None where it will not be."""
    silent, free_in = failure.evidence.get("silent_s"), failure.evidence.get("free_in_s")
    if failure.code != "LEASE_HELD" or not isinstance(silent, float) or not isinstance(free_in, float):
        return None
    return max(free_in, 0.05) if silent > _ALIVE_S else None
