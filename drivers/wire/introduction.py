"""Who answers, and what its wall clock says: asked a few times, for the shortest round trip tells the clock best."""

import time
from typing import TypeVar

from drivers.interfaces import ClockOffset
from drivers.messages import BaseIdentity, Identify, ScannerIdentity
from drivers.wire.client import Link

ROUNDS = 5
"""The first round waits for the connection too, and any may meet a busy machine."""

I = TypeVar("I", ScannerIdentity, BaseIdentity)  # noqa: E741


def introduced(link: Link, expected: type[I]) -> tuple[I, ClockOffset]:
    """The agent's identity, and how far its wall clock is ahead of ours.

    Raises:
        FailureError: as :meth:`drivers.wire.client.Link.ask`.
    """
    rounds = [_asked(link, expected) for _ in range(ROUNDS)]
    return min(rounds, key=lambda found: found[1].uncertainty)


def _asked(link: Link, expected: type[I]) -> tuple[I, ClockOffset]:
    wall, began = time.time(), time.monotonic()
    identity = link.ask(Identify(), expected)
    # The trip by the monotonic clock: our own wall clock may be set while we wait.
    half = (time.monotonic() - began) / 2
    return identity, ClockOffset(identity.wall_clock - (wall + half), half)
