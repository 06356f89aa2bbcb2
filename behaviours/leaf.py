"""The base of every leaf: declared keys, typed failures, and exceptions that never leave the tick."""

import logging
from typing import Any, ClassVar

import py_trees
from py_trees.common import Status

from behaviours.keys import Key, access_to
from behaviours.services import Services, connect
from perception.failure import Failure, FailureError


class Leaf(py_trees.behaviour.Behaviour):
    """A behaviour that names the keys it reads and writes, and answers only SUCCESS, FAILURE or RUNNING.

    A concrete leaf implements :meth:`begin` (clear and start) and :meth:`step` (poll, at most 5 ms). Any
    exception becomes FAILURE with a typed error, so that no bug of a leaf can leave the base driving.
    """

    reads: ClassVar[tuple[Key, ...]] = ()
    writes: ClassVar[tuple[Key, ...]] = ()

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self.logger = logging.getLogger(f"mission.tree.{name}")  # type: ignore[assignment]
        self.services: Services
        self._keys = access_to(type(self).__name__, self.reads, self.writes)

    def setup(self, **kwargs: object) -> None:
        self.services = connect(kwargs)

    def begin(self) -> None:
        """Clear what the last run left and start; may raise FailureError."""

    def step(self) -> Status:
        """Poll; may raise FailureError."""
        raise NotImplementedError(type(self).__name__)

    def initialise(self) -> None:
        self._stillborn: Failure | None = None
        try:
            self.begin()
        except Exception as error:
            self._stillborn = as_failure(error, self.name)

    def update(self) -> Status:
        if self._stillborn is not None:
            return self.fail(self._stillborn)
        try:
            status = self.step()
        except Exception as error:
            return self.fail(as_failure(error, self.name))
        if status not in (Status.SUCCESS, Status.FAILURE, Status.RUNNING):
            return self.fail(Failure("LEAF_STATUS", f"{self.name} answered {status!r}"))
        return status

    def read(self, key: Key) -> Any:
        """Value of a declared key; None where nobody has written it yet."""
        return self._keys.get(key) if self._keys.exists(key) else None

    def write(self, key: Key, value: object) -> None:
        self._keys.set(key, value)

    def say(self, message: str) -> None:
        """Plain words for whoever looks at the tree."""
        self.feedback_message = message

    def fail(self, failure: Failure) -> Status:
        """FAILURE, with its typed error on the blackboard and in the journal."""
        return self._end_with("failure", failure)

    def decline(self, failure: Failure) -> Status:
        """FAILURE that is an ordinary end, such as "no more of them": no trouble, but others branch by its code."""
        return self._end_with("declined", failure)

    def _end_with(self, kind: str, failure: Failure) -> Status:
        self.write(Key.FAILURE, failure)
        evidence = dict(failure.evidence)
        self.services.journal.record(
            kind, leaf=self.name, code=failure.code, message=failure.message, evidence=evidence
        )
        self.say(str(failure))
        return Status.FAILURE


def as_failure(error: Exception, leaf: str) -> Failure:
    """The typed error of an exception; an unexpected one is a bug of the leaf and named as such."""
    if isinstance(error, FailureError):
        return error.failure
    logging.getLogger("mission.tree").exception("leaf %s", leaf, exc_info=error)
    return Failure("LEAF_EXCEPTION", f"{leaf}: {type(error).__name__}: {error}")
