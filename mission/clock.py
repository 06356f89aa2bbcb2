"""Mission time: monotonic, from zero; it stands still while the mission is paused, and so no deadline passes."""

import threading
import time
from collections.abc import Callable


class MissionClock:
    """Seconds of the mission, ``rate`` of them for one second of the wall. May be read from any thread.

    Args:
        rate: other than 1 only in a rehearsal.
        source: monotonic seconds of the wall; scripted in tests.
        wait: sleeps so many of them.
        begin: mission time to begin at, of a mission that is taken up again.
    """

    def __init__(
        self,
        rate: float = 1.0,
        source: Callable[[], float] = time.monotonic,
        wait: Callable[[float], None] = time.sleep,
        begin: float = 0.0,
    ) -> None:
        self.rate = rate
        self._source = source
        self._wait = wait
        self._start = source() - begin / rate
        self._stopped_at: float | None = None
        self._woke = source()
        self._lock = threading.Lock()

    def now(self) -> float:
        with self._lock:
            at = self._source() if self._stopped_at is None else self._stopped_at
            return (at - self._start) * self.rate

    def stand_still(self, still: bool) -> None:
        """Stop the time, or let it go on from where it stopped. Harmless when it does so already."""
        with self._lock:
            if still and self._stopped_at is None:
                self._stopped_at = self._source()
            elif not still and self._stopped_at is not None:
                self._start += self._source() - self._stopped_at
                self._stopped_at = None

    def sleep(self, seconds: float) -> None:
        """Wait until so many seconds of the wall after the last wait was over, so that ticks come regularly.

        A tick costs real time whatever the rate, and in a pause too. Whoever was late is not made to hurry after it.
        """
        self._wait(max(0.0, seconds - (self._source() - self._woke)))
        self._woke = self._source()
