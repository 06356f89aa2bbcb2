"""How often each client may ask, in a table that no number of clients makes larger."""

import time
from collections.abc import Callable, Hashable

CLIENTS = 64


class Rates:
    """A token bucket for each client.

    Args:
        per_second: what each client may have in the long run, and the room of its bucket unless ``burst`` says so.
        clients: how many may be busy at once; a newcomer waits until one of them was idle long enough.
    """

    def __init__(
        self,
        per_second: float,
        burst: float | None = None,
        clients: int = CLIENTS,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._per_second = per_second
        self._burst = per_second if burst is None else burst
        self._clients = clients
        self._clock = clock
        self._buckets: dict[Hashable, tuple[float, float]] = {}  # tokens, at; the longest idle first

    def admits(self, who: Hashable) -> bool:
        """Whether this client may have one more now."""
        now = self._clock()
        bucket = self._buckets.pop(who, None)
        if bucket is None and len(self._buckets) >= self._clients and not self._forgot_one(now):
            return False
        tokens = self._burst if bucket is None else self._tokens(bucket, now)
        admitted = tokens >= 1.0
        self._buckets[who] = (tokens - admitted, now)
        return admitted

    def _tokens(self, bucket: tuple[float, float], now: float) -> float:
        tokens, at = bucket
        return min(self._burst, tokens + (now - at) * self._per_second)

    def _forgot_one(self, now: float) -> bool:
        """A client whose bucket is full again is as good as new, and the first one that can be forgotten."""
        idlest = next(iter(self._buckets))
        if self._tokens(self._buckets[idlest], now) < self._burst:
            return False
        del self._buckets[idlest]
        return True
