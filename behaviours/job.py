"""The one leaf for remote and background work: a goal builder and a result mapper are all a concrete leaf adds."""

from typing import Any, ClassVar

from py_trees.common import Status

from behaviours.leaf import Leaf
from behaviours.sound import unsound
from drivers.jobs import Done, Failed, Job
from perception.failure import Failure


class JobLeaf(Leaf):
    """Starts a job, polls it, and cancels it when it is interrupted or its deadline passes.

    A concrete leaf implements :meth:`start` and :meth:`finish`; ``timeout`` gives the deadline in mission seconds,
    None for a job that has a deadline of its own. Who gives one names ``timeout_code`` too.
    """

    timeout_code: ClassVar[str]

    def start(self) -> Job[Any]:
        raise NotImplementedError(type(self).__name__)

    def finish(self, value: Any) -> Status:
        """Take the job's value; SUCCESS unless a concrete leaf finds fault with it."""
        return Status.SUCCESS

    def timeout(self) -> float | None:
        return None

    def begin(self) -> None:
        self._job: Job[Any] | None = None
        self._job = self.start()
        # Not before: when a mission is resumed its jobs are told from the instant at which each was written down.
        self._began = self.services.clock.now()

    def step(self) -> Status:
        assert self._job is not None
        outcome = self._job.poll()
        if isinstance(outcome, Done):
            self._job = None
            no_number = unsound(outcome.value)
            if no_number:
                return self.failed(Failure("RESULT_NOT_FINITE", f"{self.name}: {no_number} holds what is no number"))
            return self.finish(outcome.value)
        if isinstance(outcome, Failed):
            self._job = None
            return self.failed(outcome.failure)
        limit = self.timeout()
        if limit is not None and self.services.clock.now() - self._began > limit:
            self._job.cancel()
            self._job = None
            return self.failed(Failure(self.timeout_code, f"{self.name}: no end after {limit:.0f} s"))
        share = "" if outcome.fraction is None else f"{100 * outcome.fraction:.0f} % "
        self.say(f"{share}{outcome.note}".strip())
        return Status.RUNNING

    def bear(self, seconds: float) -> None:
        """Leave so many seconds, in which nothing was let happen, out of the deadline."""
        self._began += seconds

    def failed(self, failure: Failure) -> Status:
        """The job failed; a concrete leaf may keep what its evidence holds."""
        return self.fail(failure)

    def terminate(self, new_status: Status) -> None:
        # Whoever ends a job sets it to None; one that is left here was interrupted, or its driver raised.
        job, self._job = getattr(self, "_job", None), None
        if job is not None:
            job.cancel()
