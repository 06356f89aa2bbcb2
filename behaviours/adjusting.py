"""The leaf that reconsiders all poses together."""

from dataclasses import replace

from py_trees.common import Status

from behaviours.keys import Key
from behaviours.mapping import poses
from behaviours.scanning import StageLeaf
from behaviours.survey import Survey
from perception.findings import PoseAdjustment

MAPS_BEAR_M = 0.025
"""Half a cell of the robot map: what was drawn from poses that were wrong by less is not drawn again."""


class OptimisePoses(StageLeaf):
    """Beyond section 5: the building's pose graph takes out what crept along the chain of registrations.

    Args:
        most_m: how far a scan may be moved now, metres. Robot map, contours and doors stay as they are, so while they
            are driven by, a larger adjustment has to wait for the end of the mission.
    """

    writes = (Key.SURVEY,)
    stage = "optimise_poses"

    def __init__(self, name: str, most_m: float) -> None:
        super().__init__(name)
        self.most_m = most_m

    def arguments(self) -> dict[str, object]:
        return {"scans": poses(self.read(Key.SURVEY).scans)}

    def finish(self, value: PoseAdjustment) -> Status:
        survey: Survey = self.read(Key.SURVEY)
        waits = value.moved_m > self.most_m
        reason = f"a scan would move by more than {self.most_m} m while maps are in use" if waits else value.reason
        adjusted = survey if waits else survey.adjusted(value.poses, value.residuals)
        self.write(Key.SURVEY, replace(adjusted, loops_closed=survey.loops))
        self.services.journal.record(
            "poses_optimised",
            loops=survey.loops,
            compared=value.compared,
            refused=value.refused,
            disbelieved=value.disbelieved,
            rms_before=value.rms_before,
            rms_after=value.rms_after,
            moved_m=value.moved_m,
            taken=not reason,
            reason=reason,
        )
        self.say(reason or f"{value.compared} pairs, scans moved by up to {1000 * value.moved_m:.1f} mm")
        return Status.SUCCESS
