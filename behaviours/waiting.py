"""Standing by for a set time."""

from py_trees.common import Status

from behaviours.leaf import Leaf


class LetTheWatchLook(Leaf):
    """Waits for as long as it takes the watch to see what stopped the work, and to hold the mission if it must."""

    settle_s = 5.0

    def begin(self) -> None:
        self._began = self.services.clock.now()

    def step(self) -> Status:
        return Status.RUNNING if self.services.clock.now() - self._began < self.settle_s else Status.SUCCESS
