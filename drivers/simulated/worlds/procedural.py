"""Draws plans of whole buildings: rooms along a corridor, straight or bent, L-shaped rooms, doors of every state."""

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Literal

import numpy as np
import shapely

from drivers.simulated.worlds.plan import DoorPlan, MirrorPlan, NichePlan, OutsidePlan, Plan, RoomPlan, WindowPlan
from drivers.simulated.worlds.shell import hull_of

WALL = 0.15
OUTER_WALL = 0.35
MARGIN = 0.15
Box = tuple[float, float, float, float]
"""(x0, y0, x1, y1) in metres."""


@dataclass
class _Draft:
    """A plan under way: outlines first, then what is cut into their walls."""

    rng: np.random.Generator
    outlines: dict[str, shapely.Polygon] = field(default_factory=dict)
    doors: list[DoorPlan] = field(default_factory=list)
    windows: list[WindowPlan] = field(default_factory=list)
    niches: list[NichePlan] = field(default_factory=list)
    mirrors: list[MirrorPlan] = field(default_factory=list)
    used: list[shapely.Polygon] = field(default_factory=list)

    def take(self, a: np.ndarray, b: np.ndarray, width: float) -> tuple[float, float] | None:
        """The middle of a free place of that width on the wall from ``a`` to ``b``, or None; it is marked as used."""
        length = float(np.linalg.norm(b - a))
        if length < width + 2 * MARGIN:
            return None
        along = (b - a) / length
        for _ in range(12):
            u = self.rng.uniform(width / 2 + MARGIN, length - width / 2 - MARGIN)
            middle = a + along * u
            span = shapely.LineString([middle - along * width / 2, middle + along * width / 2]).buffer(0.12 + WALL)
            if not any(span.intersects(other) for other in self.used):
                self.used.append(span)
                return float(middle[0]), float(middle[1])
        return None


def draw_plan(seed: int, rooms: int | None = None) -> Plan:
    """A building of 2 to 12 rooms (drawn when not given), the same for the same seed.

    Most doors can be passed; some are shut, some narrower than 0.7 m. Windows, niches as tall as a door, open
    cupboards and mirrors are there to be mistaken for doors.
    """
    rng = np.random.default_rng([seed, 2015])
    count = int(rng.integers(2, 13)) if rooms is None else rooms
    draft = _Draft(rng)
    if count <= 4:
        _draw_suite(draft, count)
    else:
        _draw_wing(draft, count)
    _add_front_door(draft)
    _cut_windows(draft)
    _add_decoys(draft)
    return Plan(
        name="procedural",
        height=round(float(rng.uniform(2.6, 3.3)), 2),
        outer_wall=OUTER_WALL,
        rooms={name: _furnished(outline, name, rng) for name, outline in draft.outlines.items()},
        doors=tuple(draft.doors),
        windows=tuple(draft.windows),
        niches=tuple(draft.niches),
        mirrors=tuple(draft.mirrors),
        outside=_surroundings(draft.outlines, rng),
    )


def _draw_suite(draft: _Draft, count: int) -> None:
    """Rooms in a row that open into each other, without a corridor; each may be set back."""
    rng, x = draft.rng, 0.0
    for index in range(count):
        width, depth = rng.uniform(4.0, 7.5), rng.uniform(4.0, 7.0)
        outline = shapely.box(x, 0.0, x + width, depth)
        draft.outlines[f"room-{index + 1}"] = _maybe_cut_corner(outline, rng)
        x += width + WALL
    names = list(draft.outlines)
    home = max(names, key=lambda name: _spaciousness(draft.outlines[name]))
    for first, second in pairwise(names):
        _join(draft, second, first, sure=home in (first, second))


def _draw_wing(draft: _Draft, count: int) -> None:
    """Rooms on both sides of a corridor; a long one bends at its end and serves the last rooms from its branch."""
    rng = draft.rng
    width = rng.uniform(1.7, 2.4)
    bends = count >= 8 and rng.random() < 0.6
    sides = _split(count - 1 - (1 if bends else 0), rng)
    rows = [_row(number, rng) for number in sides]
    length = max(row[-1][1] for row in rows) + rng.uniform(0.0, 1.0)
    corridor = shapely.box(0.0, 0.0, length, width)
    number = 0
    for row, north in zip(rows, (True, False), strict=True):
        for outline in _side_rooms(row, width, north, rng):
            number += 1
            draft.outlines[f"room-{number}"] = outline
    if bends:
        reach = rng.uniform(3.5, 5.5)
        x0 = length + WALL
        corridor = corridor.union(shapely.box(length - 0.01, -reach, x0 + width, width)).simplify(1e-6)
        draft.outlines[f"room-{number + 1}"] = shapely.box(x0 + width + WALL, -reach, x0 + width + 4.5, width)
    sides_of_corridor = list(draft.outlines)
    draft.outlines["corridor"] = corridor
    # The mission starts in the most spacious room, so that one must have a door to leave by.
    by_space = sorted(sides_of_corridor, key=lambda name: -_spaciousness(draft.outlines[name]))
    for index, name in enumerate(by_space):
        _join(draft, name, "corridor", sure=index < 2)
    for first, second in pairwise(sides_of_corridor):
        if rng.random() < 0.2:
            _join(draft, first, second, sure=False)


def _split(count: int, rng: np.random.Generator) -> tuple[int, int]:
    """How many rooms lie on each side of the corridor."""
    north = int(np.clip(round(count * rng.uniform(0.35, 0.65)), 1, count - 1))
    return north, count - north


def _row(count: int, rng: np.random.Generator) -> list[tuple[float, float]]:
    """The x intervals of the rooms on one side, the first of them a large one."""
    x, intervals = 0.0, []
    for index in range(count):
        width = rng.uniform(5.0, 8.0) if index == 0 else rng.uniform(2.4, 6.5)
        intervals.append((x, x + width))
        x += width + WALL
    return intervals


def _side_rooms(
    row: list[tuple[float, float]], corridor: float, north: bool, rng: np.random.Generator
) -> list[shapely.Polygon]:
    """The outlines of one side; a deep room may reach around behind a shallow neighbour and become an L."""
    depths = [rng.uniform(4.5, 6.5) if index == 0 else rng.uniform(3.0, 6.5) for index in range(len(row))]
    outlines = []
    for index, ((x0, x1), depth) in enumerate(zip(row, depths, strict=True)):
        outline = shapely.box(x0, 0.0, x1, depth)
        follows = index + 1 < len(row) and depths[index + 1] < depth - 2.2
        if follows and rng.random() < 0.8:
            behind = shapely.box(x1 - 0.01, depths[index + 1] + WALL, row[index + 1][1], depth)
            outline = outline.union(behind).simplify(1e-6)
        elif not _reached_around(index, depths):
            outline = _maybe_cut_corner(outline, rng)
        outlines.append(outline)
    placed = []
    for outline in outlines:
        corners = np.array(outline.exterior.coords)
        y = corners[:, 1] + corridor + WALL if north else -corners[:, 1] - WALL
        placed.append(shapely.Polygon(np.stack([corners[:, 0], y], axis=1)))
    return placed


def _spaciousness(outline: shapely.Polygon) -> float:
    """Radius of the largest disc in a room, metres."""
    return float(shapely.maximum_inscribed_circle(outline).length)


def _reached_around(index: int, depths: list[float]) -> bool:
    return index > 0 and depths[index] < depths[index - 1] - 2.2


def _maybe_cut_corner(outline: shapely.Polygon, rng: np.random.Generator) -> shapely.Polygon:
    """Now and then a corner away from the corridor is missing, square or slanting."""
    x0, y0, x1, y1 = outline.bounds
    if min(x1 - x0, y1 - y0) < 4.0 or rng.random() < 0.6:
        return outline
    a, b = rng.uniform(0.8, 0.4 * (x1 - x0)), rng.uniform(0.8, 0.4 * (y1 - y0))
    square = rng.random() < 0.6
    corner = shapely.box(x1 - a, y1 - b, x1, y1) if square else shapely.Polygon([(x1 - a, y1), (x1, y1 - b), (x1, y1)])
    return outline.difference(corner)


def _join(draft: _Draft, room: str, other: str, sure: bool) -> None:
    """A door between two rooms where their walls run side by side, if there is a place for one."""
    rng = draft.rng
    kind = (
        "open" if sure else str(rng.choice(["open", "half", "shut", "narrow", "none"], p=[0.62, 0.1, 0.1, 0.1, 0.08]))
    )
    width = {"narrow": rng.uniform(0.55, 0.66), "half": rng.uniform(1.15, 1.25)}.get(kind, rng.uniform(0.9, 1.1))
    angle = {"half": rng.uniform(58, 66), "shut": 0.0}.get(kind, rng.uniform(88, 112))
    for a, b in _shared_walls(draft.outlines[room], draft.outlines[other]):
        at = draft.take(a, b, width)
        if at is not None:
            hinge: Literal["left", "right"] = "left" if rng.random() < 0.5 else "right"
            height = round(float(rng.uniform(2.0, 2.15)), 2)
            leaf = 0.0 if kind == "none" else None
            door = DoorPlan(room=room, at=at, width=width, height=height, angle=angle, hinge=hinge, leaf=leaf)
            draft.doors.append(door)
            return


def _shared_walls(room: shapely.Polygon, other: shapely.Polygon) -> list[tuple[np.ndarray, np.ndarray]]:
    """The stretches of a room's outline that have the other room right behind the wall, longest first."""
    behind = other.buffer(WALL + 0.01, join_style="mitre")
    stretches = []
    for a, b in _edges(room):
        # Ends are taken in so that the wall has its full thickness behind a whole door.
        common = shapely.LineString([a, b]).intersection(behind)
        if isinstance(common, shapely.LineString) and common.length > 0.8:
            p, q = np.array(common.coords[0]), np.array(common.coords[-1])
            inset = (q - p) / common.length * (WALL + 0.01)
            stretches.append((p + inset, q - inset))
    return sorted(stretches, key=lambda pair: -float(np.linalg.norm(pair[1] - pair[0])))


def _edges(polygon: shapely.Polygon) -> list[tuple[np.ndarray, np.ndarray]]:
    corners = np.array(shapely.orient_polygons(polygon).exterior.coords)
    return list(pairwise(corners))


def _outer_walls(draft: _Draft, name: str) -> list[tuple[np.ndarray, np.ndarray]]:
    """The stretches of a room's outline that have nothing but the outside behind them."""
    outside = hull_of(list(draft.outlines.values()), OUTER_WALL).exterior.buffer(1e-6)
    walls = []
    for a, b in _edges(draft.outlines[name]):
        along = (b - a) / np.linalg.norm(b - a)
        through = np.array([along[1], -along[0]]) * OUTER_WALL
        free = shapely.LineString([a + through, b + through]).intersection(outside)
        if isinstance(free, shapely.LineString) and free.length > 1.2:
            walls.append((np.array(free.coords[0]) - through, np.array(free.coords[-1]) - through))
    return walls


def _add_front_door(draft: _Draft) -> None:
    """The way out of the building; it is locked."""
    for name in reversed(draft.outlines):
        for a, b in _outer_walls(draft, name):
            at = draft.take(a, b, 1.0)
            if at is not None:
                draft.doors.append(DoorPlan(room=name, at=at, width=1.0, angle=0.0))
                return


def _cut_windows(draft: _Draft) -> None:
    rng = draft.rng
    for name in draft.outlines:
        for a, b in _outer_walls(draft, name):
            for _ in range(int(rng.integers(0, 3))):
                width = rng.uniform(0.8, 2.0)
                at = draft.take(a, b, width)
                if at is not None:
                    sill, height = rng.uniform(0.7, 1.0), rng.uniform(1.0, 1.4)
                    draft.windows.append(WindowPlan(room=name, at=at, width=width, sill=sill, height=height))


def _add_decoys(draft: _Draft) -> None:
    """Niches and mirrors as tall as doors, in outer walls (which are thick enough)."""
    rng = draft.rng
    for name in draft.outlines:
        for a, b in _outer_walls(draft, name):
            kind = rng.choice(["niche", "mirror", "nothing"], p=[0.12, 0.12, 0.76])
            width = rng.uniform(0.8, 1.0)
            at = None if kind == "nothing" else draft.take(a, b, width)
            if at is not None and kind == "niche":
                depth = rng.uniform(0.12, 0.25)
                draft.niches.append(NichePlan(room=name, at=at, width=width, height=2.0, depth=depth))
            elif at is not None:
                sill = 0.0 if rng.random() < 0.5 else 0.4
                draft.mirrors.append(MirrorPlan(room=name, at=at, width=width, sill=sill, height=1.95 - sill))


def _furnished(outline: shapely.Polygon, name: str, rng: np.random.Generator) -> RoomPlan:
    """The room with as much furniture as its floor bears."""
    corners = tuple((float(x), float(y)) for x, y in shapely.orient_polygons(outline).exterior.coords[:-1])
    area, lamps = outline.area, max(1, round(outline.area / 12))
    if name == "corridor":
        return RoomPlan(polygon=corners, seeded={"lamp": lamps, "board": int(rng.integers(3))})
    if area < 12:
        return RoomPlan(polygon=corners, seeded={"lamp": 1, "shelf": int(rng.integers(2))})
    clutter = rng.uniform(0.5, 1.2) * area
    return RoomPlan(
        polygon=corners,
        seeded={
            "desk": round(clutter / 9),
            "table": int(rng.integers(2)),
            "chair": round(clutter / 14),
            "shelf": round(clutter / 12),
            "cabinet": round(clutter / 14),
            "cupboard": int(rng.random() < 0.4),
            "box": round(clutter / 12),
            "board": int(rng.integers(2)),
            "bar": int(rng.integers(4)) if rng.random() < 0.3 else 0,
            "curtain": int(rng.integers(3)),
            "radiator": int(rng.integers(2)),
            "column": int(rng.random() < 0.15),
            "beam": int(rng.random() < 0.2),
            "lamp": lamps,
        },
    )


def _surroundings(outlines: dict[str, shapely.Polygon], rng: np.random.Generator) -> tuple[OutsidePlan, ...]:
    """Facades across the street on all four sides and a few trees."""
    x0, y0, x1, y1 = shapely.union_all(list(outlines.values())).bounds
    cx, cy, away = (x0 + x1) / 2, (y0 + y1) / 2, rng.uniform(8, 14)
    sides = [
        ((cx, y1 + away), 0.0, x1 - x0),
        ((cx, y0 - away), 0.0, x1 - x0),
        ((x0 - away, cy), 90.0, y1 - y0),
        ((x1 + away, cy), 90.0, y1 - y0),
    ]
    chosen = [side for side in sides if rng.random() < 0.8]
    facades = [OutsidePlan(kind="facade", at=at, yaw=yaw, size=(span + 10, 3.0, 7.0)) for at, yaw, span in chosen]
    trees = [
        OutsidePlan(kind="tree", at=(rng.uniform(x0, x1), y + side * rng.uniform(3, 6)), size=(2.4, 2.4, 5.5))
        for y, side in ((y0, -1), (y1, 1))
        for _ in range(int(rng.integers(1, 4)))
    ]
    return (*facades, *trees)
