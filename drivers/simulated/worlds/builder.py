"""Collects the triangles of a world: quads, boxes, flat polygons and walls with holes."""

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from drivers.simulated.world import Surface

Rectangle = tuple[float, float, float, float]
"""(u0, z0, u1, z1) in the plane of a wall: u along it from its first corner, metres."""


class MeshBuilder:
    """Triangles with a class each; corners that coincide within 0.1 mm become one vertex at the end."""

    def __init__(self) -> None:
        self._corners: list[NDArray[np.float64]] = []
        self._surface: list[NDArray[np.uint8]] = []

    def copy(self) -> "MeshBuilder":
        """Another builder that starts with the same triangles."""
        other = MeshBuilder()
        other._corners, other._surface = list(self._corners), list(self._surface)
        return other

    def add(self, corners: ArrayLike, surface: Surface) -> None:
        """Triangles ``(K, 3, 3)`` of one class."""
        triangles = np.asarray(corners, float).reshape(-1, 3, 3)
        self._corners.append(triangles)
        self._surface.append(np.full(len(triangles), surface, np.uint8))

    def add_quad(self, a: ArrayLike, b: ArrayLike, c: ArrayLike, d: ArrayLike, surface: Surface) -> None:
        """A planar quadrilateral; it faces the side from which its corners run counter-clockwise."""
        self.add(np.array([a, b, c, a, c, d], float), surface)

    def add_box(
        self, lower: Sequence[float], upper: Sequence[float], surface: Surface, pose: tuple[float, float, float]
    ) -> None:
        """A closed box between two corners of a frame that stands at ``pose`` (x, y, yaw) on the floor."""
        x, y, yaw = pose
        unit = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)], float)
        local = np.asarray(lower, float) + unit * (np.asarray(upper, float) - np.asarray(lower, float))
        cos, sin = np.cos(yaw), np.sin(yaw)
        corners = local @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]) + (x, y, 0.0)
        self.add(corners[_BOX_FACES], surface)

    def add_polygon(self, polygon: shapely.Polygon, z: float, upwards: bool, surface: Surface) -> None:
        """A horizontal face that looks up or down."""
        self.add(lift(triangulated(polygon), z, upwards), surface)

    def add_wall(
        self, start: ArrayLike, end: ArrayLike, z: tuple[float, float], holes: Sequence[Rectangle], surface: Surface
    ) -> None:
        """A vertical face from ``start`` to ``end`` (x, y) with rectangular holes; it faces to the left of its run."""
        origin, target = np.asarray(start, float), np.asarray(end, float)
        length = float(np.linalg.norm(target - origin))
        along = (target - origin) / length
        for u0, z0, u1, z1 in _panels(length, z, holes):
            a, b = origin + along * u0, origin + along * u1
            self.add_quad((*b, z0), (*a, z0), (*a, z1), (*b, z1), surface)

    def build(self) -> tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.uint8]]:
        """Vertices ``(V, 3)``, triangles ``(T, 3)`` and their classes ``(T,)``."""
        return merged(np.concatenate(self._corners), np.concatenate(self._surface))


def merged(
    corners: NDArray[np.floating], surface: NDArray[np.uint8]
) -> tuple[NDArray[np.float32], NDArray[np.int32], NDArray[np.uint8]]:
    """Triangles ``(K, 3, 3)`` as shared vertices and indices; those without an area are dropped."""
    keys = np.round(corners.reshape(-1, 3), 4)
    vertices, index = np.unique(keys, axis=0, return_inverse=True)
    triangles = index.reshape(-1, 3).astype(np.int32)
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    solid = np.linalg.norm(np.cross(b - a, c - a), axis=1) > 1e-9
    return vertices.astype(np.float32), triangles[solid], surface[solid]


def triangulated(polygon: shapely.Polygon) -> NDArray[np.float64]:
    """Triangles ``(K, 3, 2)``, counter-clockwise, that fill a polygon exactly."""
    parts = shapely.constrained_delaunay_triangles(polygon).geoms
    return np.array([shapely.orient_polygons(part).exterior.coords[:3] for part in parts]).reshape(-1, 3, 2)


def lift(triangles: NDArray[np.float64], z: float, upwards: bool) -> NDArray[np.float64]:
    """Plane triangles ``(K, 3, 2)`` at a height, facing up or down."""
    lifted = np.concatenate([triangles, np.full((len(triangles), 3, 1), z)], axis=2)
    return lifted if upwards else lifted[:, ::-1]


def _panels(length: float, z: tuple[float, float], holes: Sequence[Rectangle]) -> list[Rectangle]:
    """The rectangles of a wall's face that are left when its holes are cut out."""
    u_cuts = np.unique([0.0, length, *(u for hole in holes for u in (hole[0], hole[2]))]).clip(0.0, length)
    z_cuts = np.unique([*z, *(v for hole in holes for v in (hole[1], hole[3]))]).clip(*z)
    panels = []
    for u0, u1 in pairwise(u_cuts):
        for z0, z1 in pairwise(z_cuts):
            u, v = (u0 + u1) / 2, (z0 + z1) / 2
            if not any(hole[0] < u < hole[2] and hole[1] < v < hole[3] for hole in holes):
                panels.append((u0, z0, u1, z1))
    return panels


_BOX_FACES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ]
)  # fmt: skip
