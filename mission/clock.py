"""Mission time: monotonic, from zero, and faster than the wall where a rehearsal runs at scaled time."""

import time


class MissionClock:
    """Seconds since it was made, ``rate`` of them for one second of the wall."""

    def __init__(self, rate: float = 1.0) -> None:
        self.rate = rate
        self._start = time.monotonic()

    def now(self) -> float:
        return (time.monotonic() - self._start) * self.rate

    def sleep(self, seconds: float) -> None:
        """Wait for so many seconds of the wall: a tick costs real time whatever the rate."""
        time.sleep(seconds)
