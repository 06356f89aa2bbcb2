"""The composite that pauses: while its watch has something to wait for, the work is neither ticked nor stopped."""

from collections.abc import Iterator

import py_trees
from py_trees.behaviour import Behaviour
from py_trees.common import Status

from behaviours.job import JobLeaf
from behaviours.services import Clock, connect


class Freeze(py_trees.composites.Composite):
    """Ticks ``watch`` at every tick, and ``work`` only where the watch fails, its way to say "nothing to wait for".

    A selector would stop the work, and with it the scan under way and the place in every sequence. Here the jobs that
    the work has begun go on, and it finds their outcomes when it is ticked again; their deadlines bear the time in
    between. A watch that succeeds ends and stops it all; otherwise the result is the work's.
    """

    def __init__(self, name: str, watch: Behaviour, work: Behaviour) -> None:
        super().__init__(name, [watch, work])
        self.watch = watch
        self.work = work
        self._clock: Clock | None = None
        self._frozen_at: float | None = None

    def setup(self, **kwargs: object) -> None:
        self._clock = connect(kwargs).clock

    def tick(self) -> Iterator[Behaviour]:
        yield from self.watch.tick()
        frozen = self.watch.status != Status.FAILURE
        self.current_child = self.watch if frozen else self.work
        self._count(frozen)
        if not frozen:
            yield from self.work.tick()
        result = self.current_child.status
        self.feedback_message = f"frozen: {self.watch.feedback_message}" if frozen else ""
        if result != Status.RUNNING:
            if self.work.status == Status.RUNNING:
                self.work.stop(Status.INVALID)
            self.stop(result)
        self.status = result
        yield self

    def _count(self, frozen: bool) -> None:
        """A drive that a hold kept from going on is not late for that."""
        if self._clock is None:
            return
        if frozen:
            self._frozen_at = self._clock.now() if self._frozen_at is None else self._frozen_at
        elif self._frozen_at is not None:
            seconds, self._frozen_at = self._clock.now() - self._frozen_at, None
            for node in self.work.iterate():
                if isinstance(node, JobLeaf) and node.status == Status.RUNNING:
                    node.bear(seconds)
