"""From a plan to the structure of a building: floors, ceilings, walls with openings, leaves, glass and mirrors."""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray

from drivers.simulated.world import DoorTruth, RoomTruth, Surface
from drivers.simulated.worlds.builder import MeshBuilder, Rectangle
from drivers.simulated.worlds.doors import FLOOR_GAP, Leaf
from drivers.simulated.worlds.plan import DoorPlan, MirrorPlan, NichePlan, Plan, Point, WindowPlan
from perception.failure import FailureError

MAX_WALL = 1.5
MIRROR_OFFSET = 0.01
Vector = NDArray[np.float64]


@dataclass
class Face:
    """One straight face of a wall that looks to the left of its run, with the holes cut into it."""

    room: str | None
    start: Vector
    end: Vector
    z: tuple[float, float]
    holes: list[Rectangle] = field(default_factory=list)

    @property
    def length(self) -> float:
        return float(np.linalg.norm(self.end - self.start))

    @property
    def along(self) -> Vector:
        return (self.end - self.start) / self.length

    @property
    def normal(self) -> Vector:
        """Out of the wall, into the room."""
        x, y = self.along
        return np.array([-y, x])

    def at(self, u: float, out: float = 0.0) -> Vector:
        """(x, y) at ``u`` metres along the face and ``out`` metres in front of it."""
        return self.start + self.along * u + self.normal * out

    def line(self) -> shapely.LineString:
        return shapely.LineString([self.start, self.end])


@dataclass(frozen=True)
class Opening:
    """A rectangle on a face, ``u`` and ``z`` intervals, and the face behind the wall, at ``thickness``."""

    face: Face
    u: tuple[float, float]
    z: tuple[float, float]
    behind: Face
    thickness: float


class Shell:
    """The structure of a planned building. Rooms are outlined by their inner faces; what lies between is wall."""

    def __init__(self, plan: Plan) -> None:
        self._plan = plan
        self.rooms = {name: _outline(room.outline) for name, room in plan.rooms.items()}
        self.heights = {name: room.height or plan.height for name, room in plan.rooms.items()}
        self._refuse_overlaps()
        self.hull = hull_of(list(self.rooms.values()), plan.outer_wall)
        self.faces = [face for name in self.rooms for face in self._room_faces(name)]
        self._outer_faces = _faces(None, shapely.orient_polygons(self.hull, exterior_cw=True), (0.0, plan.height + 0.3))
        self.leaves: list[tuple[str, Leaf]] = []
        self.doors: list[DoorTruth] = []
        self.windows: list[Opening] = []

    def build(self, mesh: MeshBuilder) -> None:
        """Add every structural surface, leaf, pane and mirror."""
        for index, door in enumerate(self._plan.doors):
            self._add_door(mesh, f"door-{index + 1}", door)
        for window in self._plan.windows:
            self._add_window(mesh, window)
        for niche in self._plan.niches:
            self._add_niche(mesh, niche)
        for mirror in self._plan.mirrors:
            self._add_mirror(mesh, mirror)
        for face in (*self.faces, *self._outer_faces):
            mesh.add_wall(face.start, face.end, face.z, face.holes, Surface.WALL)
        for name, polygon in self.rooms.items():
            mesh.add_polygon(polygon, 0.0, True, Surface.FLOOR)
            mesh.add_polygon(polygon, self.heights[name], False, Surface.CEILING)

    def truth_rooms(self) -> tuple[RoomTruth, ...]:
        """The rooms as the evaluation knows them."""
        return tuple(
            RoomTruth(name, np.array(polygon.exterior.coords[:-1]), 0.0, self.heights[name])
            for name, polygon in self.rooms.items()
        )

    def _room_faces(self, name: str) -> list[Face]:
        return _faces(name, self.rooms[name], (0.0, self.heights[name]))

    def _refuse_overlaps(self) -> None:
        names = list(self.rooms)
        for index, first in enumerate(names):
            for second in names[index + 1 :]:
                if self.rooms[first].intersection(self.rooms[second]).area > 1e-6:
                    raise FailureError("WORLD_PLAN_INVALID", f"rooms '{first}' and '{second}' overlap")

    def _locate(self, room: str, at: Point, width: float, z: tuple[float, float], what: str) -> tuple[Face, float]:
        """The face of a room nearest to a point, and where along it an opening of that width begins."""
        own = [face for face in self.faces if face.room == room]
        face = min(own, key=lambda candidate: candidate.line().distance(shapely.Point(at)))
        middle = float((np.asarray(at) - face.start) @ face.along)
        fits = width / 2 <= middle <= face.length - width / 2 and z[1] <= face.z[1]
        crossed = any(
            hole[0] < middle + width / 2 and middle - width / 2 < hole[2] and hole[1] < z[1] and z[0] < hole[3]
            for hole in face.holes
        )
        if not fits or crossed:
            reason = "meets another opening" if crossed else "does not fit into its wall"
            raise FailureError("WORLD_PLAN_INVALID", f"the {what} of '{room}' at {at} {reason}", room=room, at=at)
        return face, middle - width / 2

    def _pierce(self, room: str, at: Point, width: float, z: tuple[float, float], what: str) -> Opening:
        """Cut a hole through a wall, into both of its faces."""
        face, u = self._locate(room, at, width, z, what)
        behind = [self._behind(face, face.at(u + step)) for step in (1e-3, width / 2, width - 1e-3)]
        distances = [distance for _, distance in behind]
        other = behind[1][0]
        if any(found is not other for found, _ in behind) or np.ptp(distances) > 1e-3 or other.z[1] < z[1]:
            raise FailureError("WORLD_PLAN_INVALID", f"no even wall behind the {what} of '{room}' at {at}", at=at)
        face.holes.append((u, z[0], u + width, z[1]))
        far = float((face.at(u + width) - other.start) @ other.along)
        other.holes.append((far, z[0], far + width, z[1]))
        return Opening(face, (u, u + width), z, other, distances[1])

    def _behind(self, face: Face, point: Vector) -> tuple[Face, float]:
        """The face on the other side of the wall, and the wall's thickness there."""
        probe = shapely.LineString([point - face.normal * 1e-4, point - face.normal * MAX_WALL])
        found = [
            (other, float(probe.intersection(other.line()).distance(shapely.Point(point))))
            for other in (*self.faces, *self._outer_faces)
            if other is not face and other.normal @ face.normal < -0.999 and probe.intersects(other.line())
        ]
        if not found:
            raise FailureError("WORLD_PLAN_INVALID", f"the wall of '{face.room}' is thicker than {MAX_WALL} m")
        return min(found, key=lambda pair: pair[1])

    def _add_door(self, mesh: MeshBuilder, door_id: str, plan: DoorPlan) -> None:
        opening = self._pierce(plan.room, plan.at, plan.width, (0.0, plan.height), "door")
        _add_reveal(mesh, opening.face, opening.u, opening.z, opening.thickness, Surface.FLOOR)
        face, (u0, u1) = opening.face, opening.u
        # Looking at the wall from inside the room, the run of its face goes from right to left.
        hinge, across = (face.at(u1), -face.along) if plan.hinge == "left" else (face.at(u0), face.along)
        width = plan.width if plan.leaf is None else plan.leaf
        leaf = Leaf(hinge, across, face.normal, plan.width, opening.thickness, width, np.deg2rad(plan.angle))
        if width > 0:
            add_leaf(mesh, leaf, plan.height)
            self.leaves.append((plan.room, leaf))
        x, y = face.at((u0 + u1) / 2, -opening.thickness / 2)
        normal = (-float(face.normal[0]), -float(face.normal[1]))
        self.doors.append(
            DoorTruth(
                door_id,
                float(x),
                float(y),
                normal,
                plan.width,
                leaf.net_width,
                leaf.clearance,
                plan.height,
                opening.thickness,
                (plan.room, opening.behind.room),
                leaf.state,
                leaf.passable,
            )
        )

    def _add_window(self, mesh: MeshBuilder, plan: WindowPlan) -> None:
        z = (plan.sill, plan.sill + plan.height)
        opening = self._pierce(plan.room, plan.at, plan.width, z, "window")
        _add_reveal(mesh, opening.face, opening.u, z, opening.thickness, Surface.WALL)
        _add_panel(mesh, opening.face, opening.u, z, -opening.thickness / 2, Surface.GLASS)
        self.windows.append(opening)

    def _add_niche(self, mesh: MeshBuilder, plan: NichePlan) -> None:
        z = (plan.sill, plan.sill + plan.height)
        face, u = self._locate(plan.room, plan.at, plan.width, z, "niche")
        for step in (0.0, plan.width):
            if self._behind(face, face.at(u + step))[1] < plan.depth + 0.02:
                raise FailureError("WORLD_PLAN_INVALID", f"the wall of '{plan.room}' is too thin for its niche")
        face.holes.append((u, z[0], u + plan.width, z[1]))
        _add_reveal(mesh, face, (u, u + plan.width), z, plan.depth, Surface.WALL)
        _add_panel(mesh, face, (u, u + plan.width), z, -plan.depth, Surface.WALL)

    def _add_mirror(self, mesh: MeshBuilder, plan: MirrorPlan) -> None:
        z = (plan.sill, plan.sill + plan.height)
        face, u = self._locate(plan.room, plan.at, plan.width, z, "mirror")
        _add_panel(mesh, face, (u, u + plan.width), z, MIRROR_OFFSET, Surface.MIRROR)


def add_leaf(mesh: MeshBuilder, leaf: Leaf, height: float, floor: float = 0.0) -> None:
    """The panel of a door, from a finger above the floor to just below the lintel."""
    outline = shapely.orient_polygons(leaf.footprint)
    z = (floor + FLOOR_GAP, floor + height - FLOOR_GAP)
    corners = np.array(outline.exterior.coords)
    for a, b in pairwise(corners):
        mesh.add_wall(b, a, z, (), Surface.DOOR_LEAF)
    mesh.add_polygon(outline, z[0], False, Surface.DOOR_LEAF)
    mesh.add_polygon(outline, z[1], True, Surface.DOOR_LEAF)


def _add_panel(
    mesh: MeshBuilder, face: Face, u: tuple[float, float], z: tuple[float, float], out: float, surface: Surface
) -> None:
    mesh.add_wall(face.at(u[0], out), face.at(u[1], out), z, (), surface)


def _add_reveal(
    mesh: MeshBuilder, face: Face, u: tuple[float, float], z: tuple[float, float], depth: float, bottom: Surface
) -> None:
    """The four faces inside an opening: two jambs, the lintel, and the threshold or sill."""
    near0, near1, far0, far1 = face.at(u[0]), face.at(u[1]), face.at(u[0], -depth), face.at(u[1], -depth)
    mesh.add_wall(far0, near0, z, (), Surface.WALL)
    mesh.add_wall(near1, far1, z, (), Surface.WALL)
    mesh.add_polygon(shapely.Polygon([near0, near1, far1, far0]), z[0], True, bottom)
    mesh.add_polygon(shapely.Polygon([near0, near1, far1, far0]), z[1], False, Surface.WALL)


def _outline(corners: tuple[Point, ...]) -> shapely.Polygon:
    polygon = shapely.orient_polygons(shapely.Polygon(corners))
    if not polygon.is_valid or polygon.area < 1e-3:
        raise FailureError("WORLD_PLAN_INVALID", f"{corners} is no simple polygon")
    return polygon


def hull_of(rooms: list[shapely.Polygon], wall: float) -> shapely.Polygon:
    """The outside of the building: the rooms, the walls around them, and any void in between."""
    grown = shapely.union_all([room.buffer(wall, join_style="mitre") for room in rooms])
    parts = grown.geoms if isinstance(grown, shapely.MultiPolygon) else [grown]
    if len(parts) > 1:
        raise FailureError("WORLD_PLAN_INVALID", f"the rooms make {len(parts)} separate buildings; one is wanted")
    return shapely.Polygon(parts[0].exterior).simplify(1e-4)


def _faces(room: str | None, polygon: shapely.Polygon, z: tuple[float, float]) -> list[Face]:
    corners = np.array(polygon.exterior.coords)
    return [Face(room, a, b, z) for a, b in pairwise(corners)]
