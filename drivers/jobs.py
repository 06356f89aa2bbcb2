"""Work that takes longer than a tick: something to poll and to cancel, whoever does it."""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

from perception.failure import Failure, FailureError

T = TypeVar("T")
T_co = TypeVar("T_co", covariant=True)


@dataclass(frozen=True)
class Running:
    """Not finished; ``fraction`` in [0, 1] where known, and a note for the operator."""

    fraction: float | None = None
    note: str = ""


@dataclass(frozen=True)
class Done(Generic[T_co]):
    """Finished with a value."""

    value: T_co


@dataclass(frozen=True)
class Failed:
    """Finished without one."""

    failure: Failure


Outcome = Running | Done[T_co] | Failed


class Job(Protocol[T_co]):
    """A request under way. Neither method blocks; both may be called at any time, any number of times."""

    def poll(self) -> Outcome[T_co]: ...

    def cancel(self) -> None: ...


class Progress:
    """What a job's own thread sees of its owner: a place to report, and whether to give up."""

    def __init__(self) -> None:
        self.latest = Running()
        self._cancelled = threading.Event()

    def report(self, fraction: float | None = None, note: str = "") -> None:
        self.latest = Running(fraction, note)

    def cancel(self) -> None:
        self._cancelled.set()

    @property
    def cancelled(self) -> bool:
        return self._cancelled.is_set()

    def wait(self, seconds: float) -> None:
        """Sleep; raise ``CANCELLED`` if the owner gave up meanwhile."""
        if self._cancelled.wait(seconds):
            raise FailureError("CANCELLED", "the request was cancelled")


class BackgroundJob(Generic[T]):
    """A blocking function in a thread of its own, seen as a :class:`Job`.

    A function that raises :class:`FailureError` fails with it; any other exception fails as ``DRIVER_EXCEPTION``.
    """

    def __init__(self, function: Callable[[Progress], T], name: str = "job") -> None:
        self._progress = Progress()
        self._outcome: Outcome[T] | None = None
        self._function = function
        threading.Thread(target=self._run, name=name, daemon=True).start()

    def _run(self) -> None:
        try:
            self._outcome = Done(self._function(self._progress))
        except FailureError as error:
            self._outcome = Failed(error.failure)
        except Exception as error:
            self._outcome = Failed(Failure("DRIVER_EXCEPTION", f"{type(error).__name__}: {error}"))

    def poll(self) -> Outcome[T]:
        return self._outcome or self._progress.latest

    def cancel(self) -> None:
        self._progress.cancel()


def wait_for(job: Job[T], seconds: float) -> T | Failure:
    """Block until a job has ended; only for use outside of the tick."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        outcome = job.poll()
        if isinstance(outcome, Done):
            return outcome.value
        if isinstance(outcome, Failed):
            return outcome.failure
        time.sleep(0.02)
    job.cancel()
    return Failure("AGENT_UNREACHABLE", f"no answer within {seconds:.0f} s")
