"""Standing by for a set time."""

from py_trees.common import Status

from behaviours.leaf import Leaf


class Wait(Leaf):
    """Waits for so many mission seconds; a subclass says how many, and what for."""

    def seconds(self) -> float:
        raise NotImplementedError(type(self).__name__)

    def begin(self) -> None:
        self._began = self.services.clock.now()

    def step(self) -> Status:
        return Status.RUNNING if self.services.clock.now() - self._began < self.seconds() else Status.SUCCESS


class LetTheWatchLook(Wait):
    """Waits for as long as it takes the watch to see what stopped the work, and to hold the mission if it must."""

    def seconds(self) -> float:
        return 5.0
