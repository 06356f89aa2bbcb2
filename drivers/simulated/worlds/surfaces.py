"""The structural surface of a room that faces into it: what Table 2 measures."""

import numpy as np
import shapely
from numpy.typing import NDArray

from drivers.simulated.world import STRUCTURAL, RoomTruth, Surface, World

ON_PLANE = 0.03
NEAR_PLANE = 0.12
PIECE = 0.25


def structural_surfaces(world: World, room_id: str) -> tuple[NDArray[np.float32], NDArray[np.uint8]]:
    """Floor, ceiling and wall of a room, net of openings; reveals, sills and thresholds do not count.

    Exact for planned buildings, whose faces end where a room ends. Elsewhere the triangles are cut into pieces of
    0.25 m and those near the room's floor, ceiling or outline are taken.

    Returns:
        Corner positions ``(K, 3, 3)`` in metres and the class ``(K,)`` of :class:`Surface` of each triangle.

    Raises:
        FailureError: ``WORLD_NO_ROOM``.
    """
    room = world.truth.room(room_id)
    chosen = np.isin(world.surface, STRUCTURAL)
    corners, surface = world.vertices[world.triangles[chosen]], world.surface[chosen]
    corners, surface = _nearby(corners, surface, room)
    exact = _facing(corners, surface, room, ON_PLANE)
    outline = shapely.Polygon(room.polygon)
    if abs(_area(corners[exact & (surface == Surface.FLOOR)]) - outline.area) < 1e-2:
        return corners[exact], surface[exact]
    corners, surface = _cut(corners, surface)
    near = _facing(corners, surface, room, NEAR_PLANE)
    return corners[near], surface[near]


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


def _facing(
    corners: NDArray[np.float32], surface: NDArray[np.uint8], room: RoomTruth, tolerance: float
) -> NDArray[np.bool_]:
    """Which triangles lie on the floor, the ceiling or a wall of the room."""
    centre = corners.mean(axis=1)
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    outline = shapely.Polygon(room.polygon)
    inside = shapely.contains_xy(outline, centre[:, 0], centre[:, 1])
    level = np.abs(normal[:, 2]) > 0.9
    floor = (surface == Surface.FLOOR) & inside & level & (np.abs(centre[:, 2] - room.floor_z) < tolerance)
    # A ceiling may have several heights; only its underside is seen.
    ceiling = (surface == Surface.CEILING) & inside & (centre[:, 2] > room.floor_z + 1.5) & (normal[:, 2] < -0.5)
    between = (centre[:, 2] > room.floor_z - tolerance) & (centre[:, 2] < room.ceiling_z + tolerance)
    wall = (surface == Surface.WALL) & between & _along_outline(centre, normal, outline, tolerance)
    return floor | ceiling | wall


def _along_outline(
    centre: NDArray[np.float32], normal: NDArray[np.float32], outline: shapely.Polygon, tolerance: float
) -> NDArray[np.bool_]:
    """Which faces lie along an edge of the outline and look to its inside."""
    ring = np.array(shapely.orient_polygons(outline).exterior.coords)
    along = np.zeros(len(centre), bool)
    for a, b in zip(ring[:-1], ring[1:], strict=True):
        run = (b - a) / np.linalg.norm(b - a)
        inwards = np.array([-run[1], run[0]])
        u, d = (centre[:, :2] - a) @ run, (centre[:, :2] - a) @ inwards
        beside = (u > -1e-3) & (u < np.linalg.norm(b - a) + 1e-3) & (np.abs(d) < tolerance)
        along |= beside & (normal[:, :2] @ inwards > 0.9)
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
