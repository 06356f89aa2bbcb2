"""A building on paper: rectangular rooms joined by doors, in a row, in a star, or as a scenario wants them."""

from collections import deque
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from perception.findings import Door, RoomShape

THICKNESS = 0.2
HEIGHT = 3.0
LONG, WIDE = 6.0, 8.0
"""Sides of each room along x and y, metres."""

_PITCH_X, _PITCH_Y = LONG + THICKNESS, WIDE + THICKNESS
_VIEWS = ((0.25, 0.25), (0.75, 0.25), (0.75, 0.75), (0.25, 0.75))


@dataclass(frozen=True)
class Passage:
    """A door in the wall between two rooms: middle of its face in the first one, and the normal out of it."""

    rooms: tuple[str, str]
    x: float
    y: float
    normal: tuple[float, float]

    @property
    def middle(self) -> tuple[float, float]:
        return self.x + THICKNESS / 2 * self.normal[0], self.y + THICKNESS / 2 * self.normal[1]

    def seen_from(self, room: str) -> Door:
        if room == self.rooms[0]:
            return Door(self.x, self.y, self.normal, 0.9, 0.9, 2.1, 0.95, THICKNESS)
        x, y = self.x + THICKNESS * self.normal[0], self.y + THICKNESS * self.normal[1]
        return Door(x, y, (-self.normal[0], -self.normal[1]), 0.9, 0.9, 2.1, 0.95, THICKNESS)

    def before(self, room: str, metres: float) -> tuple[float, float]:
        """The place so far before the door, in one of its rooms."""
        away = -metres if room == self.rooms[0] else metres + THICKNESS
        return self.x + away * self.normal[0], self.y + away * self.normal[1]


@dataclass(frozen=True)
class Site:
    """Rooms by name with their middles, and passages by name. The mission starts at the origin, in room A."""

    rooms: dict[str, tuple[float, float]]
    passages: dict[str, Passage]

    def room_at(self, x: float, y: float) -> str:
        """The room whose middle is nearest in units of its sides; under a door, either of the two."""
        return min(self.rooms, key=lambda name: self._off(name, x, y))

    def rooms_at(self, x: float, y: float) -> set[str]:
        """Both rooms under a door, else the one."""
        under = self.passage_at(x, y)
        return {self.room_at(x, y)} if under is None else set(self.passages[under].rooms)

    def passage_at(self, x: float, y: float) -> str | None:
        """The passage that a place lies under."""
        near = (name for name, passage in self.passages.items() if np.hypot(*np.subtract(passage.middle, (x, y))) < 0.3)
        return next(near, None)

    def shape(self, room: str) -> RoomShape:
        x, y = self.rooms[room]
        corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (LONG / 2, WIDE / 2) + (x, y)
        return RoomShape(corners, 0.0, HEIGHT, np.hstack([corners, np.roll(corners, -1, axis=0)]))

    def views(self, room: str) -> list[tuple[float, float]]:
        """The four places to see the room from, the best one first."""
        x, y = self.rooms[room]
        return [(x + (u - 0.5) * LONG, y + (v - 0.5) * WIDE) for u, v in _VIEWS]

    def way(self, start: tuple[float, float], goal: tuple[float, float]) -> list[str] | None:
        """Passages from one place to another by the fewest doors, taking every door for open; None if apart."""
        goals = self.rooms_at(*goal)
        queue: deque[tuple[str, list[str]]] = deque((room, []) for room in self.rooms_at(*start))
        seen = set(self.rooms_at(*start))
        while queue:
            room, way = queue.popleft()
            if room in goals:
                return way
            for name, passage in self.passages.items():
                for other in set(passage.rooms) - seen if room in passage.rooms else ():
                    seen.add(other)
                    queue.append((other, [*way, name]))
        return None

    def _off(self, name: str, x: float, y: float) -> float:
        middle = self.rooms[name]
        return max(abs(x - middle[0]) / LONG, abs(y - middle[1]) / WIDE)


def row(count: int) -> Site:
    """Rooms A, B, C ... side by side; ``A-B`` is the door between the first two."""
    names = [chr(ord("A") + i) for i in range(count)]
    rooms = {name: (i * _PITCH_X, 0.0) for i, name in enumerate(names)}
    return Site(rooms, {f"{a}-{b}": _eastward(rooms, a, b) for a, b in pairwise(names)})


def star() -> Site:
    """A in the middle; B east, C west and D north of it."""
    rooms = {"A": (0.0, 0.0), "B": (_PITCH_X, 0.0), "C": (-_PITCH_X, 0.0), "D": (0.0, _PITCH_Y)}
    west = Passage(("A", "C"), -LONG / 2, 0.0, (-1.0, 0.0))
    north = Passage(("A", "D"), 0.0, WIDE / 2, (0.0, 1.0))
    return Site(rooms, {"A-B": _eastward(rooms, "A", "B"), "A-C": west, "A-D": north})


def twice_joined() -> Site:
    """A and B with two doors between them."""
    rooms = row(2).rooms
    return Site(rooms, {name: _eastward(rooms, "A", "B", y) for name, y in (("south", -2.5), ("north", 2.5))})


def _eastward(rooms: dict[str, tuple[float, float]], a: str, b: str, y: float = 0.0) -> Passage:
    return Passage((a, b), rooms[a][0] + LONG / 2, rooms[a][1] + y, (1.0, 0.0))
