"""What truly stands in the robot's way: the mesh seen from above, between the wheels and the top of the mast."""

from collections.abc import Iterable

import cv2
import numpy as np
import shapely
import trimesh
from numba import njit
from numpy.typing import NDArray
from shapely import affinity

from drivers.simulated.bodies import Body
from drivers.simulated.world import World

_LOW, _HIGH = 0.03, 1.45
_CELL = 0.01
_SUBPIXEL_BITS = 4


class Obstruction:
    """Tells whether the footprint at a pose touches anything.

    Everything between 3 cm (lower things are driven over) and 1.45 m above the floor is drawn into a raster of 1 cm,
    so contact is reported up to 1 cm early, never late.
    """

    def __init__(self, world: World, footprint: tuple[float, float]) -> None:
        self._half = footprint[0] / 2, footprint[1] / 2
        self._outline = shapely.box(-self._half[0], -self._half[1], self._half[0], self._half[1])
        corners = _slice(world)[:, :, :2]
        self._origin = corners.reshape(-1, 2).min(0) - 2 * _CELL if len(corners) else np.zeros(2)
        self._raster = _draw(corners, self._origin)

    def touches(self, x: float, y: float, yaw: float, bodies: Iterable[Body] = ()) -> bool:
        """Whether the footprint at a true pose overlaps the building or a body."""
        ox, oy = self._origin
        if _touches(self._raster, x - ox, y - oy, yaw, *self._half, _CELL):
            return True
        here = None
        for body in bodies:
            turned = affinity.rotate(self._outline, yaw, origin=(0, 0), use_radians=True)
            here = here or affinity.translate(turned, x, y)
            if here.intersects(body.outline()):
                return True
        return False


def _slice(world: World) -> NDArray[np.float64]:
    """Triangles ``(N, 3, 3)`` of the mesh that lie in the robot's height, cut off at both ends."""
    part = trimesh.Trimesh(np.asarray(world.vertices, float), np.asarray(world.triangles), process=False)
    for height, upward in ((_LOW, 1.0), (_HIGH, -1.0)):
        if len(part.faces):
            part = trimesh.intersections.slice_mesh_plane(part, (0.0, 0.0, upward), (0.0, 0.0, height))
    return np.asarray(part.triangles, float).reshape(-1, 3, 3)


def _draw(corners: NDArray[np.float64], origin: NDArray[np.float64]) -> NDArray[np.uint8]:
    """Raster of the projected triangles; standing ones are drawn as lines."""
    if not len(corners):
        return np.zeros((1, 1), np.uint8)
    columns, rows = np.ceil((corners.reshape(-1, 2).max(0) - origin) / _CELL).astype(int) + 2
    raster = np.zeros((rows, columns), np.uint8)
    # A pixel's integer coordinate is its centre, hence the half cell.
    pixels = np.rint(((corners - origin) / _CELL - 0.5) * (1 << _SUBPIXEL_BITS)).astype(np.int32)
    for triangle in pixels:
        cv2.fillConvexPoly(raster, triangle, 1, lineType=cv2.LINE_8, shift=_SUBPIXEL_BITS)
    return raster


@njit(cache=True)
def _touches(
    raster: NDArray[np.uint8], x: float, y: float, yaw: float, half_length: float, half_width: float, cell: float
) -> bool:
    """Whether a set cell's centre lies in the rectangle at (x, y) metres from the raster's corner."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    reach_x = half_length * abs(cos) + half_width * abs(sin)
    reach_y = half_length * abs(sin) + half_width * abs(cos)
    rows, columns = raster.shape
    for row in range(max(0, int((y - reach_y) / cell)), min(rows, int((y + reach_y) / cell) + 1)):
        dy = (row + 0.5) * cell - y
        for column in range(max(0, int((x - reach_x) / cell)), min(columns, int((x + reach_x) / cell) + 1)):
            if raster[row, column]:
                dx = (column + 0.5) * cell - x
                if abs(cos * dx + sin * dy) <= half_length and abs(cos * dy - sin * dx) <= half_width:
                    return True
    return False
