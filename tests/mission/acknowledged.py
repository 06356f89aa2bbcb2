"""How long an order takes to be acknowledged, told apart from how long the machine did not let this process run."""

import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from mission.control import Requests, order

ACK_S = 0.2
"""Both ways, at the 99th percentile."""
_GLANCE_S = 0.002


@dataclass(frozen=True)
class Wait:
    """Seconds for an acknowledgement, and the longest in them for which no thread of this process was let run."""

    whole: float
    starved: float

    @property
    def own(self) -> float:
        return self.whole - self.starved


def acknowledged(run: Path, body: Requests) -> Wait:
    """Give an order to whoever serves the run folder."""
    with _starvation() as gaps:
        began = time.monotonic()
        order(run, body)
        whole = time.monotonic() - began
    return Wait(whole, max(0.0, *gaps) - _GLANCE_S if gaps else 0.0)


@contextmanager
def _starvation() -> Iterator[list[float]]:
    """Filled inside with how long each of many short sleeps took."""
    gaps: list[float] = []
    over = threading.Event()

    def glance() -> None:
        looked = time.monotonic()
        while not over.wait(_GLANCE_S):
            now = time.monotonic()
            gaps.append(now - looked)
            looked = now

    thread = threading.Thread(target=glance, daemon=True)
    thread.start()
    try:
        yield gaps
    finally:
        over.set()
        thread.join()
