"""Leaves for what moves through a scan: whether anybody stood in it, and time for them to go."""

from py_trees.common import Status

from behaviours.keys import Key
from behaviours.mapping import poses
from behaviours.scanning import StageLeaf
from behaviours.survey import Survey
from behaviours.waiting import Wait
from perception.failure import Failure
from perception.findings import Movement


class LookForMovement(StageLeaf):
    """Looks for what the newest scan has where an earlier one of the room saw that nothing was.

    FAILURE with ``DYN_POINTS`` when that is more than ``scanning.moved_share``. The scan keeps its share in any case.
    The room's contour is that of its last cycle.
    """

    reads = (Key.ROOM,)
    writes = (Key.SURVEY,)
    stage = "find_movement"

    def arguments(self) -> dict[str, object]:
        survey, room_id = self.read(Key.SURVEY), self.read(Key.ROOM)
        newest = survey.scans[-1]
        earlier = tuple(scan for scan in survey.scans_near(room_id) if scan.scan_id != newest.scan_id)
        return {
            "scan_id": newest.scan_id,
            "pose": newest.map_from_scanner.tolist(),
            "earlier": poses(earlier),
            "shape": survey.shapes[room_id],
        }

    def finish(self, value: Movement) -> Status:
        survey: Survey = self.read(Key.SURVEY)
        self.write(Key.SURVEY, survey.with_movement(value.share))
        words = f"{value.share:.1%} of {survey.scans[-1].scan_id} was not there before"
        if value.place is not None:
            words += " around ({:.1f}, {:.1f})".format(*value.place)
        if value.share <= self.services.settings.scanning.moved_share:
            self.say(words)
            return Status.SUCCESS
        return self.fail(Failure("DYN_POINTS", words, {"share": value.share, "place": value.place}))


class LetThemPass(Wait):
    """Waits for whoever stood in the scan to go."""

    def seconds(self) -> float:
        return self.services.settings.scanning.calm_s
