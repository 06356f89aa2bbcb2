"""Leaves that choose the next best view and judge whether the room still needs one."""

from dataclasses import replace

from py_trees.common import Status

from behaviours.keys import Key
from behaviours.leaf import Leaf
from behaviours.mapping import poses
from behaviours.scanning import StageLeaf
from behaviours.survey import Avoided, Cycle, Labelled, Survey, Target
from perception import stopping
from perception.findings import ViewChoice


class ChooseView(StageLeaf):
    """Section 4.2: the candidate from which most occluded voxels would be seen, and all others' scores as evidence."""

    reads = (Key.SURVEY, Key.ROOM, Key.COUNTS)
    writes = (Key.VIEW, Key.AVOID)
    stage = "choose_view"

    def arguments(self) -> dict[str, object]:
        survey, room_id = self.read(Key.SURVEY), self.read(Key.ROOM)
        now = self.services.clock.now()
        avoid = tuple(view for view in self.read(Key.AVOID) or () if view.until > now)
        self.write(Key.AVOID, avoid)
        room, driving = self.services.settings.room, self.services.settings.driving
        return {
            "room_id": room_id,
            "cycle": survey.cycle_number(room_id, self.read(Key.COUNTS).scan_id),
            "shape": survey.shapes[room_id],
            "scan_id": survey.scans[-1].scan_id,
            "pose": survey.track[-1],
            "stations": poses(survey.scans_near(room_id)),
            "track": list(survey.track),
            "map_id": survey.map_id,
            "avoid": [(view.x, view.y, driving.avoid_radius_m) for view in avoid],
            "rule": room.candidate_rule,
            "gain": room.gain,
            "path_clearance": driving.path_clearance_m,
            "goal_clearance": driving.goal_clearance_m,
        }

    def finish(self, value: ViewChoice) -> Status:
        self.write(Key.VIEW, value)
        best = value.best[0] if value.best else None
        self.say(
            "no candidate meets the three requirements"
            if best is None
            else f"({best.x:.1f}, {best.y:.1f}) shows {best.gain:,} occluded voxels, best of {value.candidates:,}"
        )
        return Status.SUCCESS


class AssessRoom(Leaf):
    """Section 5: ends the room by λ and μ, or because no view promises enough; else names the view as the target."""

    reads = (Key.ROOM, Key.COUNTS, Key.VIEW, Key.AVOID)
    writes = (Key.SURVEY, Key.TARGET)

    def step(self) -> Status:
        survey, room_id = self.read(Key.SURVEY), self.read(Key.ROOM)
        view: ViewChoice = self.read(Key.VIEW)
        labelled: Labelled = self.read(Key.COUNTS)
        scan_id = labelled.scan_id
        earlier = tuple(cycle for cycle in survey.cycles.get(room_id, ()) if cycle.scan_id != scan_id)
        history = [cycle.counts for cycle in earlier] + [labelled.counts]
        decision = stopping.assess(
            history,
            view.best[0].gain if view.best else None,
            thresholds(self),
        )
        survey = replace(survey, cycles={**survey.cycles, room_id: (*earlier, Cycle(scan_id, history[-1], decision))})
        self._record(room_id, scan_id, survey)
        if decision.stop:
            status, reason = self._verdict(decision.reason)
            survey = replace(survey, building=survey.building.end_room(room_id, status, reason))
            self.services.journal.record(
                "room_ended",
                room_id=room_id,
                status=status,
                reason=reason,
                growing_rate=decision.growing_rate,
                occluded_decrease_rate=decision.occluded_decrease_rate,
            )
            self.write(Key.TARGET, None)
        else:
            survey, goal_id = survey.next_goal()
            best = view.best[0]
            self.write(Key.TARGET, Target(goal_id, best.x, best.y, None, "view"))
        self.write(Key.SURVEY, survey)
        self.say(f"λ {decision.growing_rate:.3f}, μ {decision.occluded_decrease_rate:.3f}: {decision.reason}")
        return Status.SUCCESS

    def _verdict(self, reason: str) -> tuple[str, str]:
        """Status and reason of a room that gets no more scans: complete only where another one would show little."""
        if reason == stopping.NO_CANDIDATE and self.read(Key.AVOID):
            return "partial", "views_blocked"
        return "partial" if reason == stopping.MAX_SCANS else "complete", reason

    def _record(self, room_id: str, scan_id: str, survey: Survey) -> None:
        cycle = survey.cycles[room_id][-1]
        self.services.journal.record(
            "assessed",
            room_id=room_id,
            scan_id=scan_id,
            occupied=cycle.counts.occupied,
            empty=cycle.counts.empty,
            occluded=cycle.counts.occluded,
            growing_rate=cycle.decision.growing_rate,
            occluded_decrease_rate=cycle.decision.occluded_decrease_rate,
            predicted_rate=cycle.decision.predicted_rate,
            reason=cycle.decision.reason,
        )


class AvoidView(Leaf):
    """Gives up the view that could not be reached, for a while and not for ever."""

    reads = (Key.TARGET,)
    writes = (Key.AVOID,)

    def step(self) -> Status:
        target: Target | None = self.read(Key.TARGET)
        if target is None:
            return Status.FAILURE
        until = self.services.clock.now() + self.services.settings.driving.avoid_s
        self.write(Key.AVOID, (*(self.read(Key.AVOID) or ()), Avoided(target.x, target.y, until)))
        self.say(f"({target.x:.1f}, {target.y:.1f}) is left aside, the next best takes its place")
        return Status.SUCCESS


def thresholds(leaf: Leaf) -> stopping.StopThresholds:
    room = leaf.services.settings.room
    return stopping.StopThresholds(room.growing_rate, room.occluded_decrease_rate, room.predicted_rate, room.max_scans)
