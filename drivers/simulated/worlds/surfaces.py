"""The structural surface of a room that faces into it: what Table 2 measures."""

from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray

from drivers.simulated.world import STRUCTURAL, RoomTruth, Surface, World

ON_PLANE = 0.03
NEAR_PLANE = 0.08
PIECE = 0.25
LEVEL = 0.9
LOWEST_CEILING = 1.5


def structural_surfaces(world: World, room_id: str) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Floor, ceiling and wall of a room, net of openings; reveals, sills and thresholds do not count.

    Exact for planned buildings, whose faces end where a room ends. Elsewhere the triangles are cut into pieces of
    0.25 m and those on the room's floor, at its ceiling and upright within its outline (8 cm wider) are taken.

    Returns:
        Corner positions ``(K, 3, 3)`` in metres and the class ``(K,)`` of :class:`Surface` of each triangle.

    Raises:
        FailureError: ``WORLD_NO_ROOM``.
    """
    room = world.truth.room(room_id)
    chosen = np.isin(world.surface, STRUCTURAL)
    corners, surface = world.vertices[world.triangles[chosen]], world.surface[chosen]
    corners, surface = _nearby(corners, surface, room)
    outline = shapely.Polygon(room.polygon)
    shapely.prepare(outline)
    floor = _on_floor(corners, surface, room, outline)
    exact = abs(_area(corners[floor]) - outline.area) < 1e-2
    if not exact:
        corners, surface = _cut(corners, surface)
        floor = _on_floor(corners, surface, room, outline)
    centre, normal = corners.mean(axis=1), _unit_normals(corners)
    above = (centre[:, 2] > room.floor_z) & (centre[:, 2] < room.ceiling_z + ON_PLANE)
    level = np.abs(normal[:, 2]) > LEVEL
    inside = shapely.contains_xy(outline, centre[:, 0], centre[:, 1])
    between = (centre[:, 2] > room.floor_z + LOWEST_CEILING) & (centre[:, 2] < room.ceiling_z + NEAR_PLANE)
    ceiling = (surface == Surface.CEILING) & level & inside & between
    # The upper side of a beam or of a hung ceiling is nobody's; a mesh may have all its normals the wrong way.
    downwards = ceiling & (normal[:, 2] < 0)
    if _area(corners[downwards]) > 0.5 * _area(corners[ceiling]):
        ceiling = downwards
    wall = (surface == Surface.WALL) & above & (np.abs(normal[:, 2]) < 1 - LEVEL)
    wall[wall] = (
        _along_outline(centre[wall], normal[wall], outline)
        if exact
        else shapely.contains_xy(outline.buffer(NEAR_PLANE), centre[wall, 0], centre[wall, 1])
    )
    chosen = floor | ceiling | wall
    return corners[chosen], surface[chosen]


def areas(corners: NDArray[np.float32], surface: NDArray[np.uint8]) -> dict[Surface, float]:
    """Square metres of each structural class."""
    return {kind: _area(corners[surface == kind]) for kind in STRUCTURAL}


def _nearby(
    corners: NDArray[np.float32], surface: NDArray[np.uint8], room: RoomTruth
) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Triangles whose bounds touch those of the room."""
    lower, upper = room.polygon.min(axis=0) - NEAR_PLANE, room.polygon.max(axis=0) + NEAR_PLANE
    inside = np.all((corners[:, :, :2].max(axis=1) >= lower) & (corners[:, :, :2].min(axis=1) <= upper), axis=1)
    return corners[inside], surface[inside]


def _on_floor(
    corners: NDArray[np.float32], surface: NDArray[np.uint8], room: RoomTruth, outline: shapely.Polygon
) -> NDArray[np.bool_]:
    """Which triangles are floor of the room."""
    centre = corners.mean(axis=1)
    at_floor = (surface == Surface.FLOOR) & (np.abs(centre[:, 2] - room.floor_z) < ON_PLANE)
    at_floor &= np.abs(_unit_normals(corners)[:, 2]) > LEVEL
    return at_floor & shapely.contains_xy(outline, centre[:, 0], centre[:, 1])


def _unit_normals(corners: NDArray[np.float32]) -> NDArray[np.float32]:
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return normal / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)


def _along_outline(
    centre: NDArray[np.float32], normal: NDArray[np.float32], outline: shapely.Polygon
) -> NDArray[np.bool_]:
    """Which faces lie on an edge of the outline and look to its inside."""
    ring = np.array(shapely.orient_polygons(outline).exterior.coords)
    along = np.zeros(len(centre), bool)
    for a, b in pairwise(ring):
        length = np.linalg.norm(b - a)
        run = (b - a) / length
        inwards = np.array([-run[1], run[0]])
        u, d = (centre[:, :2] - a) @ run, (centre[:, :2] - a) @ inwards
        on_edge = (u > -1e-3) & (u < length + 1e-3) & (np.abs(d) < ON_PLANE)
        along |= on_edge & (normal[:, :2] @ inwards > LEVEL)
    return along


def _cut(corners: NDArray[np.float32], surface: NDArray[np.uint8]) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """The same surface in triangles whose edges are at most 0.25 m long."""
    from trimesh.remesh import subdivide_to_size

    vertices, faces, origin = subdivide_to_size(
        corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3), PIECE, max_iter=20, return_index=True
    )
    return vertices[faces].astype(np.float32), surface[origin]


def _area(corners: NDArray[np.float32]) -> float:
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    return 0.5 * float(np.linalg.norm(cross, axis=1).sum())
