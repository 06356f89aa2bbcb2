"""Whose time the simulation runs on: scaled in the agents, advanced by hand in tests."""

import time
from typing import Protocol


class Clock(Protocol):
    """Simulated seconds since the simulation began."""

    def now(self) -> float: ...

    def sleep(self, seconds: float) -> None: ...


class ScaledClock:
    """Real time multiplied by ``speed``; two agents agree on it only up to the moments they were started."""

    def __init__(self, speed: float = 1.0) -> None:
        self._speed = speed
        self._origin = time.monotonic()

    def now(self) -> float:
        return (time.monotonic() - self._origin) * self._speed

    def sleep(self, seconds: float) -> None:
        time.sleep(max(0.0, seconds) / self._speed)


class VirtualClock:
    """Time that stands still until somebody advances it; sleeping advances it."""

    def __init__(self) -> None:
        self._now = 0.0

    def now(self) -> float:
        return self._now

    def sleep(self, seconds: float) -> None:
        self._now += max(0.0, seconds)
