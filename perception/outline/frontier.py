"""Where a room's contour ends because sight ended and not at a wall: the space beyond belongs to what is still unseen.

The paper's contour H is closed by walls. A corridor that turns a corner is not, as long as nobody has looked round it:
its leg has no ceiling in the image yet, so without this no voxel there would be occluded and no view worth taking.
"""

import numpy as np
import shapely
from numpy.typing import NDArray

from perception.findings import RoomShape

MIN_OPENING = 0.8
"""A shorter side without a wall is a corner that furniture hides, metres."""
DEPTH = 1.5
"""How far beyond an open side the room is taken to go on, metres: enough to be worth a look, H grows when it was."""
_ON_LINE = 0.10
_STEP = 0.05


def open_sides(shape: RoomShape) -> NDArray[np.float64]:
    """Sides of the contour, ``(N, 4)`` rows x0, y0, x1, y1 (map frame, interior on the left), that no wall closes.

    A side is open if walls leave at least ``MIN_OPENING`` metres of it bare.
    """
    starts = np.asarray(shape.contour, float)
    sides = np.hstack([starts, np.roll(starts, -1, axis=0)])
    return sides[[_bare_length(side, shape.walls) >= MIN_OPENING for side in sides]]


def seen_and_beyond(shape: RoomShape) -> shapely.Geometry:
    """The area inside the contour and, outside of each open side, a strip ``DEPTH`` metres deep."""
    strips = [
        shapely.LineString([(x0, y0), (x1, y1)]).buffer(-DEPTH, single_sided=True)
        for x0, y0, x1, y1 in open_sides(shape)
    ]
    return shapely.union_all([shapely.make_valid(shapely.Polygon(shape.contour)), *strips])


def _bare_length(side: NDArray[np.float64], walls: NDArray[np.float64]) -> float:
    start, along = side[:2], side[2:] - side[:2]
    length = float(np.hypot(*along))
    if length < MIN_OPENING:
        return length
    along /= length
    outward = np.array([along[1], -along[0]])
    places = np.arange(_STEP / 2, length, _STEP)
    bare = np.ones(len(places), bool)
    for wall in np.asarray(walls, float).reshape(-1, 2, 2):
        if np.abs((wall - start) @ outward).max() < _ON_LINE:
            low, high = np.sort((wall - start) @ along)
            bare &= (places < low) | (places > high)
    return float(np.count_nonzero(bare)) * _STEP
