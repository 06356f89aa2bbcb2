"""Questions to the blackboard: one tick, SUCCESS for yes, FAILURE for no, and no note in the failure record."""

from py_trees.common import Status

from behaviours.keys import Key
from behaviours.leaf import Leaf
from drivers.interfaces import BaseState
from perception.failure import Failure


class Condition(Leaf):
    """Asks :meth:`holds`."""

    def holds(self) -> bool:
        raise NotImplementedError(type(self).__name__)

    def step(self) -> Status:
        return Status.SUCCESS if self.holds() else Status.FAILURE


class FailureIs(Condition):
    """Whether the newest failure has one of these codes; a prefix ends with ``_``. Picks the recovery that can help."""

    reads = (Key.FAILURE,)

    def __init__(self, name: str, *codes: str) -> None:
        super().__init__(name)
        self.codes = codes

    def holds(self) -> bool:
        failure: Failure | None = self.read(Key.FAILURE)
        if failure is None:
            return False
        self.say(failure.code)
        return any(
            failure.code == code or (code.endswith("_") and failure.code.startswith(code)) for code in self.codes
        )


class FailureIsNot(FailureIs):
    """Whether the newest failure has none of these codes: where any other can be helped."""

    def holds(self) -> bool:
        return not super().holds()


class NoScanYet(Condition):
    """Whether the map frame is still to be made."""

    reads = (Key.SURVEY,)

    def holds(self) -> bool:
        return not self.read(Key.SURVEY).scans


class MapFrameIsMade(NoScanYet):
    """Whether there is something to register to."""

    def holds(self) -> bool:
        return not super().holds()


class PlaceIsKnown(Condition):
    """Whether odometry leads on from the last scan that has its place to where the base stands now."""

    reads = (Key.SURVEY, Key.BASE)

    def holds(self) -> bool:
        base: BaseState | None = self.read(Key.BASE)
        return base is None or self.read(Key.SURVEY).knows_place(base)


class ScanHasGuess(Condition):
    """Whether odometry led to where the scan was taken, so that its guess is worth something."""

    reads = (Key.SCAN,)

    def holds(self) -> bool:
        return not self.read(Key.SCAN).adrift


class ScanIsSetAside(Condition):
    """Whether a scan waits for a place that more is known for since: not the newest one, just refused."""

    reads = (Key.SURVEY, Key.SCAN)

    def holds(self) -> bool:
        waiting = self.read(Key.SURVEY).set_aside
        return bool(waiting) and waiting[0].scan_id != self.read(Key.SCAN).scan_id


class RoomIsNew(Condition):
    """Whether the room's first scan is still to be looked at: there is nothing to compare it with."""

    reads = (Key.SURVEY, Key.ROOM)

    def holds(self) -> bool:
        return self.read(Key.ROOM) not in self.read(Key.SURVEY).shapes


class LoopIsClosed(Condition):
    """Whether doors close a loop of rooms that the poses do not know of yet."""

    reads = (Key.SURVEY,)

    def holds(self) -> bool:
        survey = self.read(Key.SURVEY)
        return bool(survey.loops > survey.loops_closed)


class RoomIsOpen(Condition):
    """Whether the room being scanned still wants scans."""

    reads = (Key.SURVEY, Key.ROOM)

    def holds(self) -> bool:
        return bool(self.read(Key.SURVEY).building.room(self.read(Key.ROOM)).status == "open")


class RoomIsEnded(RoomIsOpen):
    """Whether the room being scanned is done with."""

    def holds(self) -> bool:
        return not super().holds()
