"""Which points outside the room can be believed: those seen through a passage, not through a window or in a mirror.

The paper keeps the points inside the room (section 3.1). The robot map spans the building, so what is seen through an
open door is worth keeping; what seems to lie behind a mirror stands where something else is, and must not block it.
"""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from perception.findings import Door, Polygon

_SLOT = 0.10
_LOW = 0.15
_LOW_BEAMS = 3
_MARGIN = 0.12
_DOORWAY = 0.6
_JAMB = 0.15


def believable(
    points: NDArray[np.floating],
    station: ArrayLike,
    contour: Polygon,
    doors: Sequence[Door] = (),
    floor_z: float = 0.0,
) -> NDArray[np.bool_]:
    """Whether each point lies in the room or was seen through an opening that reaches the floor.

    The contour is cut into slots of 10 cm. A slot that some beams left the room through lower than 15 cm over the
    floor is a passage; a window and a mirror end higher. Points whose line of sight does not leave the room at all
    (a station in a doorway looks both ways) are kept.

    Args:
        points: ``(N, 3)`` of one scan, map frame, metres.
        station: (x, y, z) of the scanner, map frame.
        contour: of the room the scan was taken in.
        doors: that are known, or suspected.
        floor_z: of the floor in the map frame, metres.

    Returns:
        ``(N,)`` mask.
    """
    where = np.asarray(station, float)
    slot, share = _exits(points, where, contour)
    exits = where + share[:, None] * (points - where)
    reach = np.hypot(points[:, 0] - where[0], points[:, 1] - where[1])
    outside = (slot >= 0) & ((1 - share) * reach > _MARGIN)
    low = outside & (exits[:, 2] - floor_z < _LOW)
    passages = np.bincount(slot[low], minlength=int(slot.max(initial=0)) + 1) >= _LOW_BEAMS
    # A door's jamb shares its slot with the wall: the neighbours of a passage belong to it.
    passages = passages | np.roll(passages, 1) | np.roll(passages, -1)
    kept = ~outside | passages[np.maximum(slot, 0)] | (share * reach < _DOORWAY)
    for door in doors:
        kept |= np.hypot(exits[:, 0] - door.x, exits[:, 1] - door.y) < door.width / 2 + _JAMB
    return kept


def _exits(
    points: NDArray[np.floating], station: NDArray[np.float64], contour: Polygon
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Where each line of sight last leaves the contour: slot (-1 if nowhere), and share of the way to the point."""
    sight = points[:, :2].astype(np.float64) - station[:2]
    share = np.full(len(points), -1.0)
    slot = np.full(len(points), -1, np.int64)
    first = 0
    for start, end in zip(contour, np.roll(contour, -1, axis=0), strict=True):
        side = end - start
        reach = float(np.hypot(*side))
        across = sight[:, 0] * side[1] - sight[:, 1] * side[0]
        offset = start - station[:2]
        with np.errstate(divide="ignore", invalid="ignore"):
            along_sight = (offset[0] * side[1] - offset[1] * side[0]) / across
            along_side = (offset[0] * sight[:, 1] - offset[1] * sight[:, 0]) / across
        # The interior is on the left of a side, so a line that goes out crosses it from left to right.
        leaves = (across > 0) & (along_sight > share) & (along_sight > 0) & (along_sight < 1)
        leaves &= (along_side >= 0) & (along_side <= 1)
        share[leaves] = along_sight[leaves]
        slot[leaves] = first + (along_side[leaves] * reach / _SLOT).astype(np.int64)
        first += int(reach / _SLOT) + 1
    return slot, share
