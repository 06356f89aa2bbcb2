"""Leaves that begin and end rooms and walk the graph of rooms and doors."""

from dataclasses import replace

from py_trees.common import Status

from behaviours.conditions import Condition
from behaviours.fence import fence_of, within
from behaviours.keys import Key
from behaviours.leaf import Leaf
from behaviours.mapping import poses
from behaviours.scanning import StageLeaf
from behaviours.survey import Survey, Target
from perception import building as plan
from perception.failure import Failure, FailureError
from perception.findings import Door, DoorFindings


class BeginRoom(Leaf):
    """Opens the books of a room: behind the door the base stands in, or around the start."""

    reads = (Key.DOOR,)
    writes = (Key.SURVEY, Key.ROOM, Key.AVOID)

    def step(self) -> Status:
        survey: Survey = self.read(Key.SURVEY)
        door_id = self.read(Key.DOOR)
        seed = (0.0, 0.0) if door_id is None else plan.beyond(survey.building.door_from_known_side(door_id), 0.8)
        building, room_id = survey.building.add_room(seed, door_id)
        self.write(Key.SURVEY, replace(survey, building=building))
        self.write(Key.ROOM, room_id)
        self.write(Key.AVOID, ())
        self.services.journal.record("room_started", room_id=room_id, entry_door=door_id, seed=seed)
        self.say(room_id)
        return Status.SUCCESS


class GiveUpRoom(Leaf):
    """Ends a room that cannot be finished, with the failure that first stood in the way as its reason."""

    reads = (Key.ROOM, Key.FAILURE)
    writes = (Key.SURVEY,)

    def step(self) -> Status:
        survey: Survey = self.read(Key.SURVEY)
        room_id = self.read(Key.ROOM)
        if survey.building.room(room_id).status == "partial":
            return Status.SUCCESS
        failure: Failure | None = self.read(Key.FAILURE)
        reason = failure.code if failure else "UNKNOWN"
        self.write(Key.SURVEY, replace(survey, building=survey.building.end_room(room_id, "partial", reason)))
        self.services.journal.record("room_ended", room_id=room_id, status="partial", reason=reason)
        self.say(f"{room_id} stays partial: {failure}")
        return Status.SUCCESS


class FindDoors(StageLeaf):
    """Section 2: open passages in the walls of the room, by what the beams did at the wall planes."""

    reads = (Key.ROOM,)
    writes = (Key.SURVEY,)
    stage = "find_doors"

    def arguments(self) -> dict[str, object]:
        survey, room_id = self.read(Key.SURVEY), self.read(Key.ROOM)
        if room_id not in survey.shapes:
            raise FailureError("DOORS_NO_ROOM", f"{room_id} has no contour, so no walls to look for doors in")
        return {"room_id": room_id, "shape": survey.shapes[room_id], "scans": poses(survey.scans_near(room_id))}

    def finish(self, value: DoorFindings) -> Status:
        survey, room_id = self.read(Key.SURVEY), self.read(Key.ROOM)
        building = survey.building.observe_doors(room_id, value.doors, survey.shapes)
        building = within(building, fence_of(survey, self.services.settings))
        self.write(Key.SURVEY, replace(survey, building=building, suspects=value.suspects))
        self.services.journal.record(
            "doors",
            room_id=room_id,
            found=[plan.door_to_dict(door) for door in value.doors],
            refused=[{**plan.door_to_dict(door), "gate": gate} for door, gate in value.refused],
        )
        self.say(f"{len(value.doors)} open, {len(value.refused)} openings turned down")
        return Status.SUCCESS


class ChooseSuspect(Leaf):
    """Picks an opening that may be a door but was seen too obliquely, and a place before it; each is looked at once."""

    reads = (Key.ROOM,)
    writes = (Key.SURVEY, Key.TARGET)

    def step(self) -> Status:
        survey: Survey = self.read(Key.SURVEY)
        suspect = next((door for door in survey.suspects if not _among(door, survey.looked_at)), None)
        if suspect is None:
            return self.decline(Failure("NO_SUSPECT_LEFT", "every opening was seen well enough"))
        survey, goal_id = replace(survey, looked_at=(*survey.looked_at, suspect)).next_goal()
        x, y = plan.before(suspect, self.services.settings.driving.look_m)
        self.write(Key.SURVEY, survey)
        self.write(Key.TARGET, Target(goal_id, x, y, None, "suspect"))
        self.say(f"an opening at ({suspect.x:.1f}, {suspect.y:.1f}) may be a door")
        return Status.SUCCESS


class ChooseDoor(Leaf):
    """Picks the next unexplored open door and the pose under it; fails with NO_DOOR_LEFT when the building is done."""

    reads = (Key.ROOM,)
    writes = (Key.SURVEY, Key.DOOR, Key.TARGET)

    def step(self) -> Status:
        survey: Survey = self.read(Key.SURVEY)
        if len(survey.building.rooms) >= self.services.settings.building.max_rooms:
            raise FailureError("MAX_ROOMS", f"{len(survey.building.rooms)} rooms, the most this mission may have")
        edge = survey.building.next_door(survey.position, self.read(Key.ROOM))
        if edge is None:
            return self.decline(Failure("NO_DOOR_LEFT", "no unexplored door is left"))
        survey, goal_id = survey.next_goal()
        # Any heading will do: past a leaf that stands half open the base must turn a little.
        x, y, _ = plan.door_pose(survey.building.door_from_known_side(edge.id))
        self.write(Key.SURVEY, survey)
        self.write(Key.DOOR, edge.id)
        self.write(Key.TARGET, Target(goal_id, x, y, None, "door"))
        self.say(f"{edge.id}, {edge.door.net_width:.2f} m wide, at ({edge.door.x:.1f}, {edge.door.y:.1f})")
        return Status.SUCCESS


class DeferDoor(Leaf):
    """Leaves a door that cannot be passed for later; it is tried once more when no other is left."""

    reads = (Key.DOOR, Key.FAILURE)
    writes = (Key.SURVEY,)

    def step(self) -> Status:
        survey: Survey = self.read(Key.SURVEY)
        failure: Failure | None = self.read(Key.FAILURE)
        building = survey.building.defer(self.read(Key.DOOR), failure.code if failure else "UNKNOWN")
        self.write(Key.SURVEY, replace(survey, building=building))
        self.say(f"{self.read(Key.DOOR)} is left for later")
        return Status.SUCCESS


class DoorsWereRefused(Condition):
    """Whether a door is left that could not be passed."""

    reads = (Key.SURVEY,)

    def holds(self) -> bool:
        refused = [edge for edge in self.read(Key.SURVEY).building.doors if edge.state == "refused"]
        self.say(", ".join(f"{edge.id} ({edge.reason})" for edge in refused))
        return bool(refused)


class RefuseDoors(Leaf):
    """No door will be passed any more, for the newest failure's reason."""

    reads = (Key.FAILURE,)
    writes = (Key.SURVEY,)

    def step(self) -> Status:
        survey: Survey = self.read(Key.SURVEY)
        failure: Failure | None = self.read(Key.FAILURE)
        building = survey.building
        for edge in building.unfinished_doors():
            building = building.refuse(edge.id, failure.code if failure else "UNKNOWN")
        self.write(Key.SURVEY, replace(survey, building=building))
        return Status.SUCCESS


class TryDoorsAgain(Leaf):
    """Every door that could not be passed is unexplored again: somebody has opened it."""

    writes = (Key.SURVEY,)

    def step(self) -> Status:
        survey: Survey = self.read(Key.SURVEY)
        building = survey.building.reconsider_doors()
        self.write(Key.SURVEY, replace(survey, building=building))
        return Status.SUCCESS


def _among(door: Door, others: tuple[Door, ...]) -> bool:
    return any(plan.same_door(door, other) for other in others)
