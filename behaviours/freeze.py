"""The composite that pauses: while its watch has something to wait for, the work is neither ticked nor stopped."""

from collections.abc import Iterator

import py_trees
from py_trees.behaviour import Behaviour
from py_trees.common import Status


class Freeze(py_trees.composites.Composite):
    """Ticks ``watch`` at every tick, and ``work`` only where the watch fails, its way to say "nothing to wait for".

    A selector would stop the work, and with it the scan under way and the place in every sequence. Here the jobs that
    the work has begun go on, and it finds their outcomes when it is ticked again. A watch that succeeds ends
    and stops it all; otherwise the result is the work's.
    """

    def __init__(self, name: str, watch: Behaviour, work: Behaviour) -> None:
        super().__init__(name, [watch, work])
        self.watch = watch
        self.work = work

    def tick(self) -> Iterator[Behaviour]:
        yield from self.watch.tick()
        frozen = self.watch.status != Status.FAILURE
        self.current_child = self.watch if frozen else self.work
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
