"""A world from any triangle mesh: classes by name or by normal, floor at zero, what is missing added."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray

from drivers.simulated.world import RoomTruth, Surface, Truth, World
from drivers.simulated.worlds.builder import lift, merged, triangulated
from drivers.simulated.worlds.siting import open_floor, outline_of, start_on
from perception.failure import FailureError

SUFFIXES = (".obj", ".ply", ".glb", ".stl")
LEVEL = 0.8
BIN = 0.02
BELOW_FLOOR = -0.02
UNKNOWN = 255
# The first word found in the names of node, geometry and material decides.
_WORDS = {
    "ceiling": Surface.CEILING,
    "window": Surface.GLASS,
    "glass": Surface.GLASS,
    "glazing": Surface.GLASS,
    "mirror": Surface.MIRROR,
    "door": Surface.DOOR_LEAF,
    "floor": Surface.FLOOR,
    "slab": Surface.FLOOR,
    "wall": Surface.WALL,
    "furniture": Surface.FURNITURE,
    "stair": Surface.OTHER,
}


@dataclass(frozen=True)
class Soup:
    """Loose triangles: corners ``(K, 3, 3)`` float64 in metres and the class ``(K,)`` of each."""

    corners: NDArray[np.float64]
    surface: NDArray[np.uint8]

    @property
    def normals(self) -> NDArray[np.float64]:
        """Twice the area times the unit normal of each triangle ``(K, 3)``."""
        return np.cross(self.corners[:, 1] - self.corners[:, 0], self.corners[:, 2] - self.corners[:, 0])

    def only(self, chosen: NDArray[np.bool_]) -> "Soup":
        return Soup(self.corners[chosen], self.surface[chosen])

    def raised(self, height: float) -> "Soup":
        return Soup(self.corners + np.array([0.0, 0.0, height]), self.surface)

    def with_slab(self, z: float, surface: Surface) -> "Soup":
        """A floor that faces up, or a ceiling that faces down, over the whole extent."""
        flat = self.corners[:, :, :2].reshape(-1, 2)
        slab = lift(triangulated(shapely.box(*flat.min(axis=0), *flat.max(axis=0))), z, surface == Surface.FLOOR)
        added = np.full(len(slab), surface, np.uint8)
        return Soup(np.concatenate([self.corners, slab]), np.concatenate([self.surface, added]))


def load_mesh(
    path: Path,
    up: str = "z",
    ceiling: float | None = None,
    floor: float | None = None,
    start: tuple[float, ...] | None = None,
) -> World:
    """A world from an OBJ, PLY, GLB or STL file; coordinates are taken as stored, metres.

    The floor is moved to z = 0 and what lies below it is cut away. The truth knows one room, ``building``: the
    largest connected floor that a robot can drive on.

    Args:
        path: the mesh.
        up: the file's vertical axis, ``z`` or ``y``.
        ceiling: height in the file at which a missing ceiling is added over the whole extent.
        floor: the same for a missing floor; otherwise the largest level of floor is found.
        start: (x, y) or (x, y, yaw) of the base; by default the clearest place.

    Raises:
        FailureError: ``WORLD_UNREADABLE``, ``WORLD_NO_FLOOR``, ``WORLD_BAD_OPTION``.
    """
    if up not in ("y", "z"):
        raise FailureError("WORLD_BAD_OPTION", f"up must be z or y, not '{up}'", up=up)
    soup = _read(path, up)
    if floor is not None:
        soup = soup.with_slab(floor, Surface.FLOOR)
    if ceiling is not None:
        soup = soup.with_slab(ceiling, Surface.CEILING)
    level = _floor_level(soup) if floor is None else floor
    soup = _classified(soup.raised(-level))
    soup = soup.only(soup.corners[:, :, 2].max(axis=1) > BELOW_FLOOR)
    region = open_floor(soup.corners, soup.surface, [])
    room = RoomTruth("building", outline_of(region, soup.corners), 0.0, _ceiling_level(soup))
    return World(path.name, *merged(soup.corners, soup.surface), start=start_on(region, start), truth=Truth((room,)))


def _read(path: Path, up: str) -> Soup:
    import trimesh

    try:
        scene = trimesh.load_scene(path)
    except (OSError, ValueError, KeyError, IndexError) as error:
        raise FailureError("WORLD_UNREADABLE", f"cannot read {path}: {error}", path=str(path)) from error
    corners, surface = [], []
    for node in scene.graph.nodes_geometry:
        matrix, name = scene.graph[node]
        mesh = scene.geometry[name]
        if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
            continue
        material = getattr(getattr(mesh.visual, "material", None), "name", None) or ""
        corners.append(trimesh.transform_points(mesh.vertices, matrix)[mesh.faces])
        surface.append(np.full(len(mesh.faces), _class_of_name(f"{node} {name} {material}"), np.uint8))
    if not corners:
        raise FailureError("WORLD_UNREADABLE", f"{path} holds no triangles", path=str(path))
    positions = np.concatenate(corners).astype(np.float64)
    if up == "y":
        positions = np.stack([positions[..., 0], -positions[..., 2], positions[..., 1]], axis=-1)
    return Soup(positions, np.concatenate(surface))


def _class_of_name(names: str) -> int:
    found = [surface for word, surface in _WORDS.items() if word in names.lower()]
    return int(found[0]) if found else UNKNOWN


def _floor_level(soup: Soup) -> float:
    """The height with the largest level area of floor; of a slab's two sides the upper one."""
    normals = soup.normals
    area = np.linalg.norm(normals, axis=1) / 2
    flat = np.abs(normals[:, 2]) > 2 * LEVEL * area
    candidates = flat & np.isin(soup.surface, (Surface.FLOOR, UNKNOWN))
    if not candidates.any():
        raise FailureError("WORLD_NO_FLOOR", "the mesh has no level floor; give its height with the option 'floor'")
    z = soup.corners[candidates, :, 2].mean(axis=1)
    bins = np.round(z / BIN).astype(int)
    levels = np.bincount(bins - bins.min(), weights=area[candidates])
    widest = int(np.argmax(levels))
    upper = np.flatnonzero(levels[widest : widest + round(0.5 / BIN)] > 0.5 * levels[widest]).max() + widest
    return float(np.median(z[bins - bins.min() == upper]))


def _ceiling_level(soup: Soup) -> float:
    """The height with the largest area of ceiling, or the top of the mesh without any."""
    chosen = (soup.surface == Surface.CEILING) & (soup.corners[:, :, 2].min(axis=1) > 1.8)
    if not chosen.any():
        return float(soup.corners[:, :, 2].max())
    z = soup.corners[chosen, :, 2].mean(axis=1)
    bins = np.round(z / BIN).astype(int)
    levels = np.bincount(bins, weights=np.linalg.norm(soup.normals[chosen], axis=1))
    return float(np.median(z[bins == np.argmax(levels)]))


def _classified(soup: Soup) -> Soup:
    """Slabs become floor above and ceiling below; what has no telling name is judged by its normal and height."""
    normals = soup.normals
    slope = normals[:, 2] / np.maximum(np.linalg.norm(normals, axis=1), 1e-12)
    z = soup.corners[:, :, 2].mean(axis=1)
    surface = soup.surface.copy()
    slab = surface == Surface.FLOOR
    surface[slab & (np.abs(slope) <= LEVEL)] = Surface.WALL
    surface[slab & (slope < -LEVEL) & (z > 1.0)] = Surface.CEILING
    unknown = surface == UNKNOWN
    surface[unknown] = Surface.FURNITURE
    surface[unknown & (np.abs(slope) < 1 - LEVEL)] = Surface.WALL
    surface[unknown & (np.abs(slope) > LEVEL) & (np.abs(z) < 0.1)] = Surface.FLOOR
    surface[unknown & (np.abs(slope) > LEVEL) & (z > 2.0)] = Surface.CEILING
    return Soup(soup.corners, surface)
