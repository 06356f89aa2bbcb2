"""Following a device from a thread of the agent until it has an outcome, and telling that outcome on the wire."""

import time
from collections import OrderedDict
from collections.abc import Callable
from typing import Any, TypeVar

from drivers.jobs import BackgroundJob, Done, Failed, Outcome, Progress, Running
from drivers.messages import Body, Pending, Problem
from perception.failure import FailureError

INTERVAL_S = 0.02
LAST_WORD_S = 2.0
REMEMBERED = 1000

T = TypeVar("T")


def follow(status: Callable[[], Outcome[T] | None], progress: Progress, name: str) -> T:
    """Wait for the device's outcome.

    A job that was cancelled still gives the device ``LAST_WORD_S`` to come to an end with evidence of its own.

    Raises:
        FailureError: the device's failure; ``CANCELLED``; ``DEVICE_FORGOT`` when it no longer knows what it does.
    """
    give_up = float("inf")
    while True:
        outcome = status()
        if isinstance(outcome, Done):
            return outcome.value
        if isinstance(outcome, Failed):
            raise Problem.of(outcome.failure).error()
        if outcome is None and not progress.cancelled:
            raise FailureError("DEVICE_FORGOT", f"the device knows nothing of {name} any more")
        if isinstance(outcome, Running):
            progress.report(outcome.fraction, outcome.note)
        if progress.cancelled:
            give_up = min(give_up, time.monotonic() + LAST_WORD_S)
            if outcome is None or time.monotonic() >= give_up:
                raise FailureError("CANCELLED", f"{name} was cancelled")
        time.sleep(INTERVAL_S)


def tell(outcome: Outcome[T], done: Callable[[T], Body]) -> Body:
    """The outcome of a job as a reply."""
    if isinstance(outcome, Done):
        return done(outcome.value)
    if isinstance(outcome, Failed):
        return Problem.of(outcome.failure)
    fraction = None if outcome.fraction is None else min(max(float(outcome.fraction), 0.0), 1.0)
    return Pending(fraction, outcome.note[:256])


class Errands:
    """The jobs of an agent by name; the oldest are forgotten when there are more than ``REMEMBERED``."""

    def __init__(self) -> None:
        self._jobs: OrderedDict[str, BackgroundJob[Any]] = OrderedDict()

    def get(self, name: str) -> BackgroundJob[Any] | None:
        return self._jobs.get(name)

    def begin(self, name: str, function: Callable[[Progress], Any]) -> BackgroundJob[Any]:
        self._jobs.pop(name, None)
        job = self._jobs[name] = BackgroundJob(function, name)
        if len(self._jobs) > REMEMBERED:
            self._jobs.popitem(last=False)
        return job

    def cancel(self, name: str) -> None:
        job = self._jobs.get(name)
        if job is not None:
            job.cancel()

    def cancel_all(self) -> list[str]:
        """Cancel what is under way; its names."""
        running = [name for name, job in self._jobs.items() if isinstance(job.poll(), Running)]
        for name in running:
            self._jobs[name].cancel()
        return running
