"""The simulated world as values: a triangle mesh to scan and to collide with, and the truth for the evaluation."""

import json
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from enum import IntEnum, StrEnum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.disk import read_arrays
from perception.failure import FailureError


class Surface(IntEnum):
    """What a triangle is part of. GLASS lets beams through, MIRROR reflects them."""

    WALL = 0
    FLOOR = 1
    CEILING = 2
    DOOR_LEAF = 3
    GLASS = 4
    MIRROR = 5
    FURNITURE = 6
    OTHER = 7


STRUCTURAL = (Surface.WALL, Surface.FLOOR, Surface.CEILING)
"""The elements whose sensed area Table 2 counts."""


class DoorState(StrEnum):
    """How far the leaf of a door stands open: 70 degrees or more (or no leaf at all), less, or not at all."""

    OPEN = "open"
    HALF = "half"
    SHUT = "shut"


@dataclass(frozen=True)
class RoomTruth:
    """A room as it is.

    Args:
        room_id: name, unique within the world.
        polygon: ``(N, 2)`` floor outline between the wall faces, metres, counter-clockwise, not closed.
        floor_z, ceiling_z: metres.
    """

    room_id: str
    polygon: NDArray[np.float64]
    floor_z: float
    ceiling_z: float

    @property
    def area(self) -> float:
        """Area of the floor, square metres."""
        x, y = self.polygon[:, 0], self.polygon[:, 1]
        return 0.5 * abs(float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))))


@dataclass(frozen=True)
class DoorTruth:
    """A door as it is.

    Args:
        door_id: name, unique within the world.
        x, y: centre of the opening, in the middle of the wall's thickness.
        normal: (nx, ny) unit vector across the wall, from ``rooms[0]`` to ``rooms[1]``.
        width: between the jambs, metres.
        net_width: what the leaf leaves of it to a straight passage along the normal, metres.
        clearance: diameter of the largest disc that passes between leaf and jamb, obliquely if need be, metres.
        height: of the opening, metres.
        thickness: of the wall, metres.
        rooms: ids on both sides; None is outside, or nothing that the truth knows.
        state: of the leaf.
        passable: whether the robot fits through (a disc of 0.72 m does).
    """

    door_id: str
    x: float
    y: float
    normal: tuple[float, float]
    width: float
    net_width: float
    clearance: float
    height: float
    thickness: float
    rooms: tuple[str | None, str | None]
    state: DoorState
    passable: bool


@dataclass(frozen=True)
class Truth:
    """Rooms and doors as they are; for the evaluation only, it never crosses the sockets."""

    rooms: tuple[RoomTruth, ...] = ()
    doors: tuple[DoorTruth, ...] = ()

    def room(self, room_id: str) -> RoomTruth:
        """The room of that name; raises ``WORLD_NO_ROOM``."""
        for room in self.rooms:
            if room.room_id == room_id:
                return room
        known = [room.room_id for room in self.rooms]
        raise FailureError(
            "WORLD_NO_ROOM", f"the world has no room '{room_id}', but {', '.join(known) or 'none'}", room=room_id
        )


@dataclass(frozen=True)
class World:
    """A building to scan: z up, metres, the floor at the start at z = 0.

    Args:
        name: what it was made from.
        vertices: ``(V, 3)`` float32.
        triangles: ``(T, 3)`` int32 indices into ``vertices``.
        surface: ``(T,)`` uint8 of :class:`Surface`.
        start: (x, y, yaw) of the base before the mission.
        truth: rooms and doors.
    """

    name: str
    vertices: NDArray[np.float32]
    triangles: NDArray[np.int32]
    surface: NDArray[np.uint8]
    start: tuple[float, float, float]
    truth: Truth

    def corners(self, surfaces: Iterable[Surface] | None = None) -> NDArray[np.float32]:
        """Corner positions ``(K, 3, 3)`` of the triangles of the given classes (of all by default)."""
        chosen = self.triangles if surfaces is None else self.triangles[np.isin(self.surface, list(surfaces))]
        return self.vertices[chosen]


def save_world(world: World, path: Path) -> None:
    """Write a world as one ``.npz`` file that every process can load."""
    described = {"name": world.name, "start": world.start, "truth": asdict(world.truth)}
    text = json.dumps(described, default=lambda array: array.tolist())
    with path.open("wb") as file:
        np.savez_compressed(
            file,
            vertices=world.vertices,
            triangles=world.triangles,
            surface=world.surface,
            described=np.frombuffer(text.encode(), np.uint8),
        )


def read_world(path: Path) -> World:
    """Read what :func:`save_world` wrote; raises ``WORLD_UNREADABLE``."""
    try:
        saved = read_arrays(path)
        described = json.loads(saved["described"].tobytes())
        arrays = {name: saved[name] for name in ("vertices", "triangles", "surface")}
        x, y, yaw = described["start"]
        return World(described["name"], **arrays, start=(x, y, yaw), truth=_truth(described["truth"]))
    except OSError as error:
        raise FailureError("WORLD_UNREADABLE", f"cannot read {path}: {error}", path=str(path)) from error
    except (ValueError, KeyError, TypeError) as error:
        expected = "expected a saved world, as a simulated mission leaves it in its simulation/world.npz"
        raise FailureError("WORLD_UNREADABLE", f"{path}: {expected}, found none", path=str(path)) from error


def _truth(described: dict[str, Any]) -> Truth:
    rooms = (RoomTruth(**{**room, "polygon": np.array(room["polygon"], float)}) for room in described["rooms"])
    doors = (
        DoorTruth(
            **{
                **door,
                "normal": tuple(door["normal"]),
                "rooms": tuple(door["rooms"]),
                "state": DoorState(door["state"]),
            }
        )
        for door in described["doors"]
    )
    return Truth(tuple(rooms), tuple(doors))
