"""Who may move the base, and until when its wheels may turn: judged by the base alone, by its own monotonic clock.

The base publishes a fresh nonce with every telemetry. Its owner echoes the newest one in each beat, so that the age of
a beat is the age of its nonce, whatever held it back and whatever the clocks of others say. A lease has a number that
only grows, so that an owner who was thought dead and wakes up is refused for ever.

This is a promise of software. It is no safety function: the hardware stop and the bumper cut the motors without it.
"""

import secrets
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping

from drivers.interfaces import Lease
from perception.failure import Failure, FailureError

LIMIT_S = 0.45
"""A nonce counts for so long; wheels that stop within 50 ms after it keep the promise of half a second."""
STALE_S = 5.0
"""An owner that was not heard of for so long may be succeeded."""
NEVER = float("-inf")


class LeaseKeeper:
    """Keeps the one lease of a base, and judges orders and beats by it. May be used from any thread.

    Args:
        epoch: of this boot, greater than that of any boot before.
        clock: monotonic seconds, as the device's control loop knows them.
        stale_after: seconds of silence after which another may have the lease.
    """

    def __init__(self, epoch: int, clock: Callable[[], float] = time.monotonic, stale_after: float = STALE_S) -> None:
        self._epoch = epoch
        self._clock = clock
        self._stale_after = stale_after
        self._sequence = 0
        self._lease: Lease | None = None
        self._heard = NEVER
        self._tick = -1
        self._moves_until = NEVER
        self._nonces: deque[tuple[int, float]] = deque()  # each with the instant until which it counts
        self._lock = threading.RLock()

    @property
    def owner(self) -> str:
        """Of the lease, empty while anybody may have it."""
        with self._lock:
            lease = self._lease
            return "" if lease is None or self._silence() >= self._stale_after else lease.owner

    @property
    def moves_until(self) -> float:
        """The instant up to which the wheels may turn; ``NEVER`` when they may not."""
        return self._moves_until

    def nonce(self) -> int:
        """A fresh nonce, to be published now."""
        with self._lock:
            now = self._clock()
            while self._nonces and now >= self._nonces[0][1]:
                self._nonces.popleft()
            self._nonces.append((secrets.randbits(63), now + LIMIT_S))
            return self._nonces[-1][0]

    def acquire(self, owner: str) -> Lease:
        """A new lease, with a greater number than any before.

        Raises:
            FailureError: ``LEASE_HELD`` while the owner of the last one is alive.
        """
        with self._lock:
            holder, silent = self.owner, self._silence()
            if holder:
                raise FailureError(
                    "LEASE_HELD",
                    f"the base is held by {holder}, last heard of {silent:.1f} s ago",
                    owner=holder,
                    silent_s=silent,
                    free_in_s=self._stale_after - silent,
                )
            self._sequence += 1
            self._lease = Lease(self._epoch, self._sequence, owner)
            self._heard, self._tick, self._moves_until = self._clock(), -1, NEVER
            return self._lease

    def release(self, number: tuple[int, int]) -> bool:
        """Give a lease back; False for one that is none any more."""
        with self._lock:
            if not self.holds(number):
                return False
            self._lease, self._moves_until = None, NEVER
            return True

    def holds(self, number: tuple[int, int]) -> bool:
        """Whether a lease is the one that counts."""
        with self._lock:
            return self._lease is not None and self._lease.number == number

    def require(self, number: tuple[int, int]) -> None:
        """Raises ``LEASE_LOST``, naming who has it now, unless a lease is the one that counts."""
        with self._lock:
            if not self.holds(number):
                raise self.lost()

    def lost(self, evidence: Mapping[str, object] | None = None) -> FailureError:
        """What somebody is told who orders with a lease that does not count; ``evidence`` of how far he came."""
        owner = self.owner
        error = FailureError("LEASE_LOST", f"the base is held by {owner or 'nobody'} now")
        error.failure = Failure("LEASE_LOST", error.failure.message, {**(evidence or {}), "owner": owner})
        return error

    def is_fresh(self, nonce: int) -> bool:
        """Whether a nonce is so young that an order which echoes it was given just now."""
        return self._counts_until(nonce) is not None

    def beat(self, number: tuple[int, int], nonce: int, tick: int, may_move: bool) -> bool:
        """Hear the owner; whether that counts. What is late, repeated or overtaken does not.

        Raises:
            FailureError: ``LEASE_LOST``.
        """
        with self._lock:
            self.require(number)
            until = self._counts_until(nonce)
            if until is None or tick <= self._tick:
                return False
            self._tick, self._heard = tick, self._clock()
            self._moves_until = until if may_move else NEVER
            return True

    def _counts_until(self, nonce: int) -> float | None:
        """The instant at which a nonce is too old; None once it is, and for one that never was published."""
        with self._lock:
            now = self._clock()
            return next((until for known, until in self._nonces if known == nonce and now < until), None)

    def _silence(self) -> float:
        return self._clock() - self._heard
