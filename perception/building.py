"""The graph of rooms and doors (paper section 2): which rooms are done, which doors are still to be tried.

Everything is immutable: each operation returns a new :class:`Building`. A door is one edge, from whichever side and
however often it was seen.
"""

import heapq
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from perception.failure import FailureError
from perception.findings import Door, Polygon, RoomShape

_LATERAL_MERGE = 0.4
_SAME_SIDE_MERGE = 0.3
_MAX_THICKNESS = 0.7
_PARALLEL = float(np.cos(np.deg2rad(20.0)))
_STEP_BEYOND = 0.6


# --- doors ----------------------------------------------------------------------------------------------------------


def beyond(door: Door, distance: float) -> tuple[float, float]:
    """(x, y) on the door's axis, ``distance`` metres past the wall plane."""
    return door.x + distance * door.normal[0], door.y + distance * door.normal[1]


def before(door: Door, distance: float) -> tuple[float, float]:
    """(x, y) on the door's axis, ``distance`` metres before the wall plane, inside the room."""
    return beyond(door, -distance)


def door_pose(door: Door) -> tuple[float, float, float]:
    """(x, y, yaw) under the door: between its jambs, in the middle of the wall, looking out of the room."""
    x, y = beyond(door, door.thickness / 2)
    return x, y, float(np.arctan2(door.normal[1], door.normal[0]))


def door_to_dict(door: Door) -> dict[str, Any]:
    """The door as JSON-ready values."""
    return {**asdict(door), "normal": list(door.normal)}


def door_from_dict(values: Mapping[str, Any]) -> Door:
    """Inverse of :func:`door_to_dict`; keys that a door does not have are ignored."""
    known = {name: values[name] for name in Door.__dataclass_fields__ if name in values}
    return Door(**{**known, "normal": (values["normal"][0], values["normal"][1])})


def same_door(a: Door, b: Door) -> bool:
    """Whether two sightings are of one door: from the same side, or each from its own side of one wall."""
    cosine = float(np.dot(a.normal, b.normal))
    if abs(cosine) < _PARALLEL:
        return False
    along, sideways = _offset(a, b)
    depth = (-_SAME_SIDE_MERGE, _SAME_SIDE_MERGE) if cosine > 0 else (-_SAME_SIDE_MERGE, _MAX_THICKNESS)
    return abs(sideways) < _LATERAL_MERGE and depth[0] < along < depth[1]


def _offset(a: Door, b: Door) -> tuple[float, float]:
    """From a to b, along a's normal and sideways."""
    dx, dy = b.x - a.x, b.y - a.y
    return dx * a.normal[0] + dy * a.normal[1], dy * a.normal[0] - dx * a.normal[1]


def _of_both_sides(near: Door, far: Door) -> Door:
    """A door seen from both rooms, as seen from the near one: sides weigh as much as they saw of it."""
    along, sideways = _offset(near, far)
    share = far.confidence / max(near.confidence + far.confidence, 1e-9)
    return replace(
        near,
        x=near.x - share * sideways * near.normal[1],
        y=near.y + share * sideways * near.normal[0],
        width=(1 - share) * near.width + share * far.width,
        height=(1 - share) * near.height + share * far.height,
        net_width=min(near.net_width, far.net_width),
        confidence=max(near.confidence, far.confidence),
        thickness=along if along >= 0.05 else near.thickness,
    )


# --- rooms ----------------------------------------------------------------------------------------------------------


def contains(contour: Polygon, xy: ArrayLike) -> bool:
    """Whether a position lies inside a room's contour."""
    x, y = np.asarray(xy, float)[:2]
    x0, y0 = contour[:, 0], contour[:, 1]
    x1, y1 = np.roll(x0, -1), np.roll(y0, -1)
    crosses = (y0 > y) != (y1 > y)
    at = x0 + (y - y0) * (x1 - x0) / np.where(y1 == y0, 1.0, y1 - y0)
    return bool(np.count_nonzero(crosses & (x < at)) % 2)


def scanned_room_at(xy: ArrayLike, shapes: Mapping[str, RoomShape], apart_from: str | None = None) -> str | None:
    """The scanned room that a position lies in; the smallest where contours overlap, None where there is none."""
    holding = [r for r, shape in shapes.items() if r != apart_from and contains(shape.contour, xy)]
    return min(holding, key=lambda room_id: shapes[room_id].area, default=None)


@dataclass(frozen=True)
class Room:
    """A room that the robot has begun to scan.

    Args:
        id: name, unique within the building.
        seed: (x, y) in the map frame that surely lies inside.
        entry_door: id of the door it was entered by, None for the first.
        status: ``open``, ``complete``, ``partial`` or ``unreachable``.
        reason: why it ended.
    """

    id: str
    seed: tuple[float, float]
    entry_door: str | None
    status: str = "open"
    reason: str = ""


@dataclass(frozen=True)
class DoorEdge:
    """A door between two rooms, or into the unknown.

    Args:
        id: name, unique within the building.
        rooms: the room it was first seen from, and the one behind it or None.
        sightings: the newest sighting of each room that saw it, the first room's first.
        state: ``unexplored``, ``passed`` (by the robot), ``linked`` (leads between rooms that are known already),
            ``deferred`` (to be tried once more), ``refused``, or ``forbidden`` (none of this mission's).
        reason: of the last deferral.
        attempts: how often it could not be passed.
    """

    id: str
    rooms: tuple[str, str | None]
    sightings: tuple[tuple[str, Door], ...]
    state: str = "unexplored"
    reason: str = ""
    attempts: int = 0

    @property
    def door(self) -> Door:
        """What all sightings together say, seen from the first room."""
        first = self.sightings[0][1]
        for _, other in self.sightings[1:]:
            if np.dot(first.normal, other.normal) < 0:
                return _of_both_sides(first, other)
        return first

    def seen(self, room_id: str, door: Door) -> "DoorEdge":
        """With a sighting more. A room's newest replaces its older ones: it was made from more scans."""
        rest = dict(self.sightings)
        rest[room_id] = door
        return replace(self, sightings=tuple(rest.items()))

    def linked_to(self, room_id: str) -> "DoorEdge":
        """Known to lead to another room than its first one."""
        if self.rooms[1] is not None or room_id == self.rooms[0]:
            return self
        state = self.state if self.state == "passed" else "linked"
        return replace(self, rooms=(self.rooms[0], room_id), state=state, reason="")


@dataclass(frozen=True)
class Building:
    """Rooms in the order they were entered, doors in the order they were found."""

    rooms: tuple[Room, ...] = ()
    doors: tuple[DoorEdge, ...] = ()

    def room(self, room_id: str) -> Room:
        """Raises ``BUILDING_UNKNOWN_ROOM``."""
        for room in self.rooms:
            if room.id == room_id:
                return room
        raise FailureError("BUILDING_UNKNOWN_ROOM", f"there is no room {room_id}")

    def edge(self, door_id: str) -> DoorEdge:
        """Raises ``BUILDING_UNKNOWN_DOOR``."""
        for edge in self.doors:
            if edge.id == door_id:
                return edge
        raise FailureError("BUILDING_UNKNOWN_DOOR", f"there is no door {door_id}")

    def neighbours(self, room_id: str) -> tuple[str, ...]:
        """Rooms that a door joins this one with, in the order of the doors."""
        joined = [edge.rooms for edge in self.doors if room_id in edge.rooms and edge.rooms[1] is not None]
        return tuple(dict.fromkeys(str(b) if a == room_id else a for a, b in joined))

    def door_from_known_side(self, door_id: str) -> Door:
        """The door with its normal out of the room it was first seen from, towards what may be unknown."""
        return self.edge(door_id).door

    def add_room(self, seed: tuple[float, float], entry_door: str | None = None) -> tuple["Building", str]:
        """Begin a room, entered through a door (which thereby is passed); returns the building and the room's id."""
        room_id = f"R{len(self.rooms) + 1}"
        building = replace(self, rooms=(*self.rooms, Room(room_id, seed, entry_door)))
        if entry_door is None:
            return building, room_id
        edge = self.edge(entry_door)
        passed = replace(edge, rooms=(edge.rooms[0], room_id), state="passed", reason="")
        return building._with_edge(passed), room_id

    def end_room(self, room_id: str, status: str, reason: str) -> "Building":
        """Close a room's books."""
        ended = replace(self.room(room_id), status=status, reason=reason)
        return replace(self, rooms=tuple(ended if room.id == room_id else room for room in self.rooms))

    def observe_doors(
        self, room_id: str, doors: Sequence[Door], shapes: Mapping[str, RoomShape] | None = None
    ) -> "Building":
        """Take the doors found in a room into the graph.

        A door seen before, from this side or the other, is refined; one that leads into a room already scanned (its
        contour holds the place behind the door, or the door was found there too) is linked and never entered again.

        Args:
            doors: seen from ``room_id``, normals outwards.
            shapes: shapes of the rooms scanned so far by id.
        """
        building = self
        for door in doors:
            known = building._known(room_id, door)
            if known is None:
                new = DoorEdge(f"D{len(building.doors) + 1}", (room_id, None), ((room_id, door),))
                building = replace(building, doors=(*building.doors, new))
            else:
                building = building._with_edge(known.seen(room_id, door).linked_to(room_id))
        return building._linked_by(shapes or {})

    def next_door(self, position: tuple[float, float], room_id: str | None = None) -> DoorEdge | None:
        """The nearest door worth trying: unexplored ones first, then each deferred one once more, else None.

        Near is along the graph: within the room the robot is in, then through doors that join known rooms.

        Args:
            position: of the robot, map frame, metres.
            room_id: the room it is in; None measures straight lines.
        """
        distance = self._distances(position, room_id)
        for state in ("unexplored", "deferred"):
            waiting = [edge for edge in self.doors if edge.state == state]
            if waiting:
                return min(waiting, key=lambda edge: distance[edge.id])
        return None

    def defer(self, door_id: str, reason: str) -> "Building":
        """A door could not be passed: the first time it is left for later, the second time refused."""
        edge = self.edge(door_id)
        state = "deferred" if edge.attempts == 0 else "refused"
        return self._with_edge(replace(edge, state=state, reason=reason, attempts=edge.attempts + 1))

    def refuse(self, door_id: str, reason: str) -> "Building":
        """A door will never be passed, such as one too narrow."""
        return self._with_edge(replace(self.edge(door_id), state="refused", reason=reason))

    def forbid(self, door_id: str, reason: str) -> "Building":
        """A door that this mission is not to go through, whatever is behind it."""
        return self._with_edge(replace(self.edge(door_id), state="forbidden", reason=reason))

    def reconsider_doors(self) -> "Building":
        """Every refused door is as if it had never been tried."""
        again = {edge.id: replace(edge, state="unexplored", reason="", attempts=0) for edge in self.doors}
        doors = tuple(again[edge.id] if edge.state == "refused" else edge for edge in self.doors)
        return replace(self, doors=doors)

    def unfinished_doors(self) -> tuple[DoorEdge, ...]:
        """Doors with something unknown behind them."""
        return tuple(edge for edge in self.doors if edge.state in ("unexplored", "deferred", "refused"))

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready; each door's row holds the figures of all its sightings together."""
        rooms = [{**asdict(room), "seed": list(room.seed)} for room in self.rooms]
        doors = [
            {
                **door_to_dict(edge.door),
                "id": edge.id,
                "rooms": list(edge.rooms),
                "state": edge.state,
                "reason": edge.reason,
                "attempts": edge.attempts,
                "sightings": [{"room": room_id, **door_to_dict(door)} for room_id, door in edge.sightings],
            }
            for edge in self.doors
        ]
        return {"rooms": rooms, "doors": doors}

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> "Building":
        """Inverse of :meth:`to_dict`."""
        rooms = tuple(
            Room(row["id"], (row["seed"][0], row["seed"][1]), row["entry_door"], row["status"], row["reason"])
            for row in values["rooms"]
        )
        doors = tuple(
            DoorEdge(
                row["id"],
                (row["rooms"][0], row["rooms"][1]),
                tuple((sighting["room"], door_from_dict(sighting)) for sighting in row["sightings"]),
                row["state"],
                row["reason"],
                row["attempts"],
            )
            for row in values["doors"]
        )
        return cls(rooms, doors)

    def _known(self, room_id: str, door: Door) -> DoorEdge | None:
        """The edge that a sighting belongs to: the nearest that matches any of its sightings."""
        matching = [
            e for e in self.doors if any(_matches(seen_from, seen, room_id, door) for seen_from, seen in e.sightings)
        ]
        return min(matching, key=lambda e: np.hypot(e.door.x - door.x, e.door.y - door.y), default=None)

    def _with_edge(self, changed: DoorEdge) -> "Building":
        return replace(self, doors=tuple(changed if edge.id == changed.id else edge for edge in self.doors))

    def _linked_by(self, shapes: Mapping[str, RoomShape]) -> "Building":
        """Doors into the unknown that turn out to lead into a room whose shape is known."""
        building = self
        for edge in self.doors:
            if edge.rooms[1] is None:
                place = beyond(edge.door, edge.door.thickness + _STEP_BEYOND)
                behind = scanned_room_at(place, shapes, apart_from=edge.rooms[0])
                if behind is not None:
                    building = building._with_edge(edge.linked_to(behind))
        return building

    def _distances(self, position: tuple[float, float], room_id: str | None) -> dict[str, float]:
        """Way to each door (Dijkstra over doors that share a room); the straight line and 1 km where there is none."""
        place = {edge.id: np.array([edge.door.x, edge.door.y]) for edge in self.doors}
        straight = {key: float(np.linalg.norm(xy - position)) for key, xy in place.items()}
        reached: dict[str, float] = {}
        queue = [(straight[e.id], e.id) for e in self.doors if room_id is None or room_id in e.rooms]
        heapq.heapify(queue)
        while queue:
            length, door_id = heapq.heappop(queue)
            if door_id in reached:
                continue
            reached[door_id] = length
            here = self.edge(door_id)
            if here.state not in ("passed", "linked"):
                continue
            for other in self.doors:
                if other.id not in reached and set(here.rooms) & set(other.rooms) - {None}:
                    step = float(np.linalg.norm(place[other.id] - place[door_id]))
                    heapq.heappush(queue, (length + step, other.id))
        return {key: reached.get(key, 1000.0 + straight[key]) for key in place}


def _matches(seen_from: str, seen: Door, room_id: str, door: Door) -> bool:
    """Whether two sightings are of one door; a room sees its doors from its own side, so the normals must say so."""
    same_side = np.dot(seen.normal, door.normal) > 0
    return same_door(seen, door) and (same_side if seen_from == room_id else True)
