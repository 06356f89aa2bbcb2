"""Who was not there before: points of a scan where an earlier scan of the room had seen that there was nothing.

A scanner cannot tell a person from a pillar. But a person walks, and a beam of an earlier scan then went through where
the person stands now. Only what stands in the room is looked at, and only from stations in it: panes and mirrors are in
walls, and what is seen through them, or in them, stands where nobody can say what was seen before.
"""

from collections.abc import Sequence

import numpy as np
import shapely
from numpy.typing import NDArray

from perception import transforms
from perception.findings import Movement, RoomShape
from perception.matching import thinning
from perception.matching.surfels import Surface
from perception.transforms import Matrix

_OFF_THE_WALLS = 0.20
_HEIGHTS = 0.10, 2.20
"""Over the floor, metres: above it people end, below it beams graze."""
_DEPTH, _DEPTH_SHARE = 0.15, 0.02
"""How far behind a point an earlier beam must have ended: a pose may be wrong, and so may a range."""
_BODY = 0.6
"""How far before a point it may have ended on the same body, metres: people are seen from all sides."""


def find_movement(
    points: NDArray[np.floating],
    map_from_scanner: Matrix,
    earlier: Sequence[tuple[Surface, Matrix]],
    shape: RoomShape,
) -> Movement:
    """How much of a scan stands where an earlier scan of the same room saw that nothing was, and where that is.

    Args:
        points: ``(N, 3)`` of the scan, scanner frame, metres; every few of its beams are enough.
        map_from_scanner: 4x4, where it was taken.
        earlier: surface and ``map_from_scanner`` of scans taken before it, the oldest first.
        shape: of the room that it was taken in.
    """
    room = shapely.Polygon(shape.contour)
    views = [(surface, pose) for surface, pose in earlier if shapely.contains_xy(room, pose[0, 3], pose[1, 3])]
    placed = transforms.apply(map_from_scanner, points)
    inside = placed[_stands_in(room, shape.floor_z, placed)]
    moved = inside[_was_empty(inside, views)]
    if not len(moved):
        return Movement(0.0, None)
    x, y = np.median(moved[:, :2], axis=0)
    return Movement(len(moved) / len(points), (float(x), float(y)))


def _stands_in(room: shapely.Polygon, floor_z: float, placed: NDArray[np.floating]) -> NDArray[np.bool_]:
    low, high = _HEIGHTS
    height = placed[:, 2] - floor_z
    inner = room.buffer(-_OFF_THE_WALLS)
    shapely.prepare(inner)
    return (height > low) & (height < high) & shapely.contains_xy(inner, placed[:, 0], placed[:, 1])


def _was_empty(placed: NDArray[np.floating], views: Sequence[tuple[Surface, Matrix]]) -> NDArray[np.bool_]:
    """Where a beam of an earlier scan had gone on, and none has ended since."""
    empty = np.zeros(len(placed), bool)
    for surface, pose in views:
        seen = transforms.apply(transforms.inverse(pose), placed).astype(np.float32)
        cells, distance = thinning.view_cells(np.ascontiguousarray(seen))
        free = surface.sight.ravel()[cells]
        margin = _DEPTH_SHARE * distance + _DEPTH
        through = free > distance + margin
        met = (free > 0) & ~through & (free > distance - margin - _BODY)
        empty = (empty | through) & ~met
    return empty
