"""The one composite that py_trees lacks: try, recover, try again, a bounded number of times."""

from collections.abc import Iterator

import py_trees
from py_trees.common import Status

from behaviours.keys import Key, access_to


class Recover(py_trees.composites.Composite):
    """Runs ``primary``; when it fails, ``recovery``, and then ``primary`` again, ``attempts`` times in all.

    SUCCESS as soon as the primary succeeds. FAILURE when the recovery fails, or with the last attempt: the recovery
    never runs after it. A recovery that fails does not hide what it was to help with: the primary's failure stands
    on the blackboard again. Like a sequence with memory it goes on where it was at the next tick.

    Raises:
        ValueError: if ``attempts`` is less than one.
    """

    def __init__(
        self,
        name: str,
        primary: py_trees.behaviour.Behaviour,
        recovery: py_trees.behaviour.Behaviour,
        attempts: int,
    ) -> None:
        if attempts < 1:
            raise ValueError(f"{name}: attempts must be at least 1, found {attempts}")
        super().__init__(name, [primary, recovery])
        self.primary = primary
        self.recovery = recovery
        self.attempts = attempts
        self._attempt = 1
        self._keys = access_to(type(self).__name__)
        self._cause: object = None

    def tick(self) -> Iterator[py_trees.behaviour.Behaviour]:
        if self.status != Status.RUNNING:
            self._attempt = 1
            self.current_child = self.primary
            for finished in self.children:
                if finished.status != Status.INVALID:
                    finished.stop(Status.INVALID)
        child = self.current_child
        assert child is not None
        yield from child.tick()
        result = self._after(child, child.status)
        if result != Status.RUNNING:
            self.stop(result)
        self.status = result
        self.feedback_message = f"attempt {self._attempt} of {self.attempts}"
        yield self

    def _after(self, child: py_trees.behaviour.Behaviour, status: Status) -> Status:
        """Where to go on once a child has been ticked."""
        if status == Status.RUNNING:
            return Status.RUNNING
        if child is self.primary:
            if status == Status.SUCCESS:
                return Status.SUCCESS
            if self._attempt >= self.attempts:
                return Status.FAILURE
            self._cause = self._keys.get(Key.FAILURE) if self._keys.exists(Key.FAILURE) else None
            self.current_child = self.recovery
            return Status.RUNNING
        if status != Status.SUCCESS:
            self._keys.set(Key.FAILURE, self._cause)
            return Status.FAILURE
        self._attempt += 1
        self.current_child = self.primary
        return Status.RUNNING
