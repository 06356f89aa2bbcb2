"""Leaves that send the base somewhere; the base plans, drives and stops before obstacles by itself."""

import math
from collections.abc import Mapping
from dataclasses import replace

from py_trees.common import Status

from behaviours.job import JobLeaf
from behaviours.keys import Key
from behaviours.leaf import Leaf
from behaviours.survey import PlanarPose, Survey, Target
from drivers.interfaces import BaseState, DriveGoal, DriveReport
from drivers.jobs import Job
from perception import transforms
from perception.failure import Failure, FailureError
from perception.transforms import Matrix

_STILL_M, _STILL_RAD = 0.01, 0.005


class DriveToTarget(JobLeaf):
    """Drives to the target in the robot map M(t); what it drove over is free floor from then on."""

    reads = (Key.TARGET, Key.BASE)
    writes = (Key.SURVEY,)
    timeout_code = "NAV_TIMEOUT"

    def start(self) -> Job[DriveReport]:
        target: Target | None = self.read(Key.TARGET)
        survey: Survey = self.read(Key.SURVEY)
        if target is None or not math.isfinite(target.x + target.y):
            raise FailureError("NAV_NO_TARGET", "no place to drive to was chosen")
        if survey.map_id is None:
            raise FailureError("NAV_NO_MAP", "no robot map yet, so nowhere is known to be free")
        base: BaseState | None = self.read(Key.BASE)
        if base is not None and not survey.knows_place(base):
            # It began anew since the scan that was to tell where it stands: another one must be taken.
            raise FailureError("NAV_INTERRUPTED", "the base began anew before it set out, so its place is not known")
        robot_map = self.services.files.robot_map(survey.map_id)
        self._set_out = base
        known = _registered_pose(survey, base)
        self.services.interlock.set_out(self.name)
        return self.services.base.drive(
            DriveGoal(target.goal_id, robot_map, survey.map_id, known, target.x, target.y, target.yaw)
        )

    def timeout(self) -> float:
        return self.services.settings.driving.timeout_s

    def terminate(self, new_status: Status) -> None:
        super().terminate(new_status)
        if hasattr(self, "services"):
            self.services.interlock.arrive(self.name)

    def finish(self, value: DriveReport) -> Status:
        survey: Survey = self.read(Key.SURVEY)
        self.write(Key.SURVEY, survey.with_drive(value.track, value.distance))
        self._record("arrived", value.distance)
        self.say(f"arrived after {value.distance:.1f} m")
        return Status.SUCCESS

    def failed(self, failure: Failure) -> Status:
        survey: Survey = self.read(Key.SURVEY)
        track, distance = _driven(failure.evidence) if "distance" in failure.evidence else self._sensed()
        self.write(Key.SURVEY, survey.with_drive(track, distance))
        self._record(failure.code, distance)
        return super().failed(failure)

    def _sensed(self) -> tuple[tuple[PlanarPose, ...], float]:
        """Track and distance of a drive whose end nobody reported, as far as telemetry tells."""
        base: BaseState | None = self.read(Key.BASE)
        if base is None or self._set_out is None or base.odom_frame != self._set_out.odom_frame:
            return (), 0.0
        place = () if base.map_from_base is None else (transforms.to_planar(base.map_from_base),)
        return place, transforms.difference(self._set_out.odom_from_base, base.odom_from_base)[0]

    def _record(self, result: str, distance: float) -> None:
        target: Target = self.read(Key.TARGET)
        self.services.journal.record(
            "drive",
            goal_id=target.goal_id,
            purpose=target.purpose,
            x=target.x,
            y=target.y,
            result=result,
            distance=distance,
            seconds=self.services.clock.now() - self._began,
        )


class BrokenOffByTouch(Leaf):
    """Fails as a drive does that was interrupted: what it touched was seen to, and it may be ordered anew."""

    def step(self) -> Status:
        raise FailureError("NAV_INTERRUPTED", "the robot touched something, and the operator lets it drive on")


class TargetHere(Leaf):
    """Names a place of which the survey knows that the base has stood there; a subclass says which."""

    writes = (Key.SURVEY, Key.TARGET)
    purpose = "here"

    def place(self, survey: Survey) -> tuple[float, float, float | None]:
        raise NotImplementedError(type(self).__name__)

    def step(self) -> Status:
        survey: Survey = self.read(Key.SURVEY)
        x, y, yaw = self.place(survey)
        survey, goal_id = survey.next_goal()
        self.write(Key.SURVEY, survey)
        self.write(Key.TARGET, Target(goal_id, x, y, yaw, self.purpose))
        self.say(f"({x:.1f}, {y:.1f})")
        return Status.SUCCESS


class TargetNearby(TargetHere):
    """Half a metre back along the way the base came: for a scan that does not work at this very spot."""

    purpose = "nearby"
    distance = 0.5

    def place(self, survey: Survey) -> tuple[float, float, float | None]:
        return back_along(survey, self.distance)


class TargetHalfWayBack(TargetHere):
    """Half-way back to the last registered scan, where a bridging scan sees both sides."""

    purpose = "bridge"

    def place(self, survey: Survey) -> tuple[float, float, float | None]:
        return back_along(survey, max(survey.driven / 2, TargetNearby.distance))


class TargetStart(TargetHere):
    """Where the mission began."""

    purpose = "start"

    def place(self, survey: Survey) -> tuple[float, float, float | None]:
        if not survey.scans:
            raise FailureError("NAV_NO_MAP", "nothing was registered, so the start has no place in a map")
        return survey.scans[0].base_pose


class TargetLastScan(TargetHere):
    """Where the newest scan was taken: back to the work after an errand."""

    purpose = "back"

    def place(self, survey: Survey) -> tuple[float, float, float | None]:
        if not survey.scans:
            raise FailureError("NAV_NO_MAP", "nothing was registered, so there is no work to go back to")
        return survey.scans[-1].base_pose


class RenewGoal(Leaf):
    """Names the same place again under a new goal, once telemetry had time to say why the drive broke off.

    Whatever stopped the base from outside is seen there, and holds the mission before another goal is sent.
    """

    writes = (Key.SURVEY, Key.TARGET)
    settle_s = 1.5

    def begin(self) -> None:
        self._began = self.services.clock.now()

    def step(self) -> Status:
        if self.services.clock.now() - self._began < self.settle_s:
            return Status.RUNNING
        target: Target | None = self.read(Key.TARGET)
        if target is None:
            raise FailureError("NAV_NO_TARGET", "no place to drive to was chosen")
        survey: Survey = self.read(Key.SURVEY)
        survey, goal_id = survey.next_goal()
        self.write(Key.SURVEY, survey)
        self.write(Key.TARGET, replace(target, goal_id=goal_id))
        self.say(f"{goal_id} in place of {target.goal_id}")
        return Status.SUCCESS


def back_along(survey: Survey, distance: float) -> tuple[float, float, float | None]:
    """The place ``distance`` metres back along the track, any heading; the track's start if it is shorter.

    Raises:
        FailureError: ``NAV_NO_TRACK`` if the base has not moved yet.
    """
    if len(survey.track) < 2:
        raise FailureError("NAV_NO_TRACK", "the base has not moved yet, so there is no way back that is known free")
    left = distance
    for (x, y, _), (x_before, y_before, _) in zip(survey.track[:0:-1], survey.track[-2::-1], strict=True):
        step = ((x - x_before) ** 2 + (y - y_before) ** 2) ** 0.5
        if step >= left > 0:
            share = left / step
            return x + share * (x_before - x), y + share * (y_before - y), None
        left -= step
    return survey.track[0][0], survey.track[0][1], None


def _registered_pose(survey: Survey, base: BaseState | None) -> Matrix | None:
    """``map_from_base`` as registration found it, better than the base's own estimate; None once the wheels turned.

    Odometry tells, because nobody may have reported a drive that timed out, or one that only turned the base.
    """
    last = survey.scans[-1]
    if base is None or not survey.knows_place(base):
        return None
    metres, radians = transforms.difference(last.odom_from_base, base.odom_from_base)
    return last.map_from_base if metres < _STILL_M and radians < _STILL_RAD else None


def _driven(evidence: Mapping[str, object]) -> tuple[tuple[PlanarPose, ...], float]:
    """Track and distance out of a drive that failed half-way."""
    track = evidence.get("track") or ()
    distance = evidence.get("distance") or 0.0
    assert isinstance(track, list | tuple) and isinstance(distance, int | float)
    return tuple((float(x), float(y), float(yaw)) for x, y, yaw in track), float(distance)
