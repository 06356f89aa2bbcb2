"""What truly stands in the robot's way: the mesh seen from above, between the wheels and the top of the mast."""

from collections.abc import Iterable

import cv2
import numpy as np
import shapely
import trimesh
from numpy.typing import NDArray
from shapely import affinity

from drivers.simulated.bodies import Body
from drivers.simulated.footprint import covers_any
from drivers.simulated.world import World

_LOW, _HIGH = 0.03, 1.45
_CELL = 0.01
_SUBPIXEL_BITS = 4


class Obstruction:
    """Tells whether the footprint at a pose touches anything.

    ``raster`` is ``(rows, columns)`` with 1 where something stands, its lower-left corner at ``origin``, 1 cm a cell.

    Everything between 3 cm (lower things are driven over) and 1.45 m above the floor is drawn into a raster of 1 cm,
    so contact is reported up to 1 cm early, never late.
    """

    def __init__(self, world: World, footprint: tuple[float, float]) -> None:
        self._half = footprint[0] / 2, footprint[1] / 2
        self._outline = shapely.box(-self._half[0], -self._half[1], self._half[0], self._half[1])
        corners = _slice(world)[:, :, :2]
        self.origin = corners.reshape(-1, 2).min(0) - 2 * _CELL if len(corners) else np.zeros(2)
        self.raster = _draw(corners, self.origin)

    def touches(self, x: float, y: float, yaw: float, bodies: Iterable[Body] = ()) -> bool:
        """Whether the footprint at a true pose overlaps the building or a body."""
        ox, oy = self.origin
        if covers_any(self.raster, x - ox, y - oy, yaw, *self._half, _CELL):
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
