"""A world from one storey of an IFC model; IfcSpace and IfcDoor give the truth. Needs the extra ``[ifc]``."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from drivers.simulated.world import RoomTruth, Surface, Truth, World
from drivers.simulated.worlds.builder import MeshBuilder, merged
from drivers.simulated.worlds.ifc_doors import DoorHole, hang_door
from drivers.simulated.worlds.siting import open_floor, start_on
from perception.failure import FailureError

LEVEL = 0.7
_KINDS = {
    "IfcWall": Surface.WALL,
    "IfcColumn": Surface.WALL,
    "IfcCurtainWall": Surface.GLASS,
    "IfcBeam": Surface.CEILING,
    "IfcSlab": Surface.FLOOR,
    "IfcCovering": Surface.FLOOR,
    "IfcRoof": Surface.FLOOR,
    "IfcWindow": Surface.GLASS,
    "IfcFurnishingElement": Surface.FURNITURE,
    "IfcStair": Surface.OTHER,
    "IfcStairFlight": Surface.OTHER,
    "IfcRailing": Surface.OTHER,
}
# What closes a storey from above often belongs to the next one.
_FLAT = ("IfcSlab", "IfcCovering", "IfcRoof", "IfcBeam")
_GLASS_WORDS = ("glas", "glaz", "verre")


@dataclass(frozen=True)
class _Element:
    """The shape of one element: triangles ``(K, 3, 3)`` in metres, and which of them light passes."""

    corners: NDArray[np.float64]
    clear: NDArray[np.bool_]
    matrix: NDArray[np.float64]


class _Model:
    """An IFC file, asked for shapes in world coordinates."""

    def __init__(self, path: Path) -> None:
        try:
            import ifcopenshell
            import ifcopenshell.geom
            import ifcopenshell.util.element
        except ImportError as error:
            raise FailureError(
                "WORLD_NEEDS_EXTRA",
                f"reading {path.name} needs the extra [ifc]: pip install 'building-scan-mission[ifc]'",
                extra="ifc",
            ) from error
        self._geometry, self._elements = ifcopenshell.geom, ifcopenshell.util.element
        self._settings = ifcopenshell.geom.settings()
        try:
            self.file = ifcopenshell.open(str(path))
        except (OSError, RuntimeError) as error:
            raise FailureError("WORLD_UNREADABLE", f"cannot read {path}: {error}", path=str(path)) from error

    def shape(self, element: Any) -> _Element | None:
        """The triangles of an element, or None if it has none."""
        try:
            shape: Any = self._geometry.create_shape(self._settings, element)
        except RuntimeError:
            return None
        matrix = np.array(shape.transformation.matrix, np.float64).reshape(4, 4, order="F")
        vertices = np.array(shape.geometry.verts, float).reshape(-1, 3) @ matrix[:3, :3].T + matrix[:3, 3]
        faces = np.array(shape.geometry.faces, int).reshape(-1, 3)
        see_through = [
            (material.transparency == material.transparency and material.transparency > 0.1)
            or any(word in material.name.lower() for word in _GLASS_WORDS)
            for material in shape.geometry.materials
        ]
        index = np.array(shape.geometry.material_ids, int)
        clear = np.array([*see_through, False])[index] if len(index) == len(faces) else np.zeros(len(faces), bool)
        return _Element(vertices[faces], clear, matrix)

    def storey_of(self, element: Any) -> Any:
        """The storey that an element belongs to, through its parts and spaces."""
        while element is not None and not element.is_a("IfcBuildingStorey"):
            element = self._elements.get_container(element) or self._elements.get_aggregate(element)
        return element


def load_ifc(path: Path, seed: int = 0, storey: str | None = None, start: tuple[float, ...] | None = None) -> World:
    """A world from one storey of an IFC file.

    Walls, columns, slabs, coverings, windows, furnishing and stairs become surfaces; spaces, sites and proxies do
    not. The door's own solid is replaced by a leaf at its jamb: open, half open or shut by the seed; doors that
    lead outside are shut.

    Args:
        path: the model.
        seed: of the doors' states.
        storey: its name; by default the storey with the most spaces.
        start: (x, y) or (x, y, yaw) of the base; by default the clearest place.

    Raises:
        FailureError: ``WORLD_NEEDS_EXTRA``, ``WORLD_UNREADABLE``, ``WORLD_NO_STOREY``, ``WORLD_NO_FLOOR``.
    """
    model = _Model(path)
    chosen = _storey(model, storey)
    rooms = _rooms(model, chosen)
    level = min(room.floor_z for room in rooms)
    top = max(room.ceiling_z for room in rooms)
    mesh = MeshBuilder()
    for kind, surface in _KINDS.items():
        for element in model.file.by_type(kind):
            _add_element(mesh, model, element, surface, chosen, (level, top))
    rooms = [_closed(mesh, room) for room in rooms]
    rng = np.random.default_rng([seed, 16739])
    doors = [
        hang_door(mesh, hole, rooms, level, rng)
        for door in model.file.by_type("IfcDoor")
        if model.storey_of(door) == chosen and (hole := _hole(model, door)) is not None
    ]
    vertices, triangles, surfaces = mesh.build()
    corners = vertices[triangles] - np.array([0.0, 0.0, level], np.float32)
    truth = Truth(tuple(_grounded(room, level) for room in rooms), tuple(doors))
    region = open_floor(corners, surfaces, [shapely.Polygon(room.polygon) for room in rooms])
    name = f"{path.name} {chosen.Name} #{seed}"
    return World(name, *merged(corners, surfaces), start=start_on(region, start), truth=truth)


def _storey(model: _Model, name: str | None) -> Any:
    storeys = model.file.by_type("IfcBuildingStorey")
    spaces = [model.storey_of(space) for space in model.file.by_type("IfcSpace")]
    known = [storey.Name for storey in storeys]
    named = [storey for storey in storeys if name is None or storey.Name == name]
    best = max(named, key=spaces.count, default=None)
    if best is None or not spaces.count(best):
        wanted = "no storey has spaces" if name is None else f"there is no storey '{name}' with spaces"
        raise FailureError("WORLD_NO_STOREY", f"{wanted}; the model has {', '.join(known)}", storeys=known)
    return best


def _rooms(model: _Model, storey: Any) -> list[RoomTruth]:
    """The spaces of a storey; heights are those of the model."""
    rooms: list[RoomTruth] = []
    for space in model.file.by_type("IfcSpace"):
        shape = model.shape(space) if model.storey_of(space) == storey else None
        if shape is None:
            continue
        z = shape.corners[:, :, 2]
        bottom = shape.corners[np.ptp(z, axis=1) + z.min(axis=1) - z.min() < 0.01]
        outline = shapely.union_all([shapely.Polygon(corner[:, :2]) for corner in bottom]).buffer(1e-4).simplify(1e-3)
        parts = outline.geoms if isinstance(outline, shapely.MultiPolygon) else [outline]
        largest = shapely.orient_polygons(shapely.Polygon(max(parts, key=lambda part: part.area).exterior))
        name = space.LongName or space.Name or space.GlobalId
        room_id = name if all(room.room_id != name for room in rooms) else f"{name} {space.Name}"
        rooms.append(RoomTruth(room_id, np.array(largest.exterior.coords[:-1]), float(z.min()), float(z.max())))
    return rooms


def _add_element(
    mesh: MeshBuilder, model: _Model, element: Any, surface: Surface, storey: Any, z: tuple[float, float]
) -> None:
    """Add the triangles of an element of this storey, or of what lies flat above and below it."""
    own = model.storey_of(element) == storey
    flat = any(element.is_a(kind) for kind in _FLAT)
    if not own and not flat:
        return
    shape = model.shape(element)
    if shape is None or shape.corners[..., 2].min() > z[1] + 0.5 or shape.corners[..., 2].max() < z[0] - 0.5:
        return
    if surface is Surface.GLASS:
        panes = shape.clear if shape.clear.any() else np.ones(len(shape.corners), bool)
        mesh.add(shape.corners[panes], Surface.GLASS)
        mesh.add(shape.corners[~panes], Surface.OTHER)
    elif surface is Surface.FLOOR:
        normal = np.cross(shape.corners[:, 1] - shape.corners[:, 0], shape.corners[:, 2] - shape.corners[:, 0])
        slope = normal[:, 2] / np.maximum(np.linalg.norm(normal, axis=1), 1e-12)
        mesh.add(shape.corners[slope > LEVEL], Surface.FLOOR)
        mesh.add(shape.corners[slope < -LEVEL], Surface.CEILING)
        mesh.add(shape.corners[np.abs(slope) <= LEVEL], Surface.WALL)
    else:
        mesh.add(shape.corners, surface)


def _closed(mesh: MeshBuilder, room: RoomTruth) -> RoomTruth:
    """The room with the height of its hung ceiling, if it has one; where nothing is overhead a ceiling is added.

    A storey is scanned by itself: through a stair well or a gallery the beams would leave it.
    """
    outline = shapely.Polygon(room.polygon)
    over: dict[float, shapely.Geometry] = {}
    for corner in _overhead(mesh, room):
        z = round(float(corner[:, 2].mean()), 2)
        over[z] = over.get(z, shapely.Polygon()).union(shapely.Polygon(corner[:, :2]).intersection(outline))
    height = min((z for z, part in over.items() if part.area > 0.5 * outline.area), default=room.ceiling_z)
    missing = outline.difference(shapely.union_all(list(over.values())))
    for part in missing.geoms if isinstance(missing, shapely.MultiPolygon) else [missing]:
        if part.area > 0.01:
            mesh.add_polygon(part, height, False, Surface.CEILING)
    return RoomTruth(room.room_id, room.polygon, room.floor_z, height)


def _overhead(mesh: MeshBuilder, room: RoomTruth) -> NDArray[np.float64]:
    """Level triangles ``(K, 3, 3)`` of ceiling above head height and not far above the room."""
    vertices, triangles, surface = mesh.build()
    corners = vertices[triangles[surface == Surface.CEILING]].astype(float)
    low, high = corners[:, :, 2].min(axis=1), corners[:, :, 2].max(axis=1)
    return corners[(low > room.floor_z + 1.8) & (high < room.ceiling_z + 0.5) & (high - low < 0.01)]


def _grounded(room: RoomTruth, level: float) -> RoomTruth:
    return RoomTruth(room.room_id, room.polygon, room.floor_z - level, room.ceiling_z - level)


def _hole(model: _Model, door: Any) -> DoorHole | None:
    """The opening that a door fills, from its shape and that of the wall it voids."""
    fills = getattr(door, "FillsVoids", ())
    own = model.shape(door)
    if not fills or own is None:
        return None
    opening = fills[0].RelatingOpeningElement
    hole, wall = model.shape(opening), model.shape(opening.VoidsElements[0].RelatingBuildingElement)
    if hole is None or wall is None:
        return None
    along, across, origin = own.matrix[:2, 0], own.matrix[:2, 1], own.matrix[:2, 3]
    u = (hole.corners.reshape(-1, 3)[:, :2] - origin) @ along
    v = (wall.corners.reshape(-1, 3)[:, :2] - origin) @ across
    z = hole.corners[..., 2]
    return DoorHole(door.Name or door.GlobalId, origin, along, across, _span(u), _span(v), _span(z.ravel()))


def _span(values: NDArray[np.float64]) -> tuple[float, float]:
    return float(values.min()), float(values.max())
