"""Which points outside the room can be believed: those seen through a passage, not through a window or in a mirror.

The paper keeps the points inside the room (section 3.1). The robot map spans the building, so what is seen through an
open door is worth keeping; what seems to lie behind a mirror stands where something else is, and must not block it.
"""

from collections.abc import Sequence

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from perception.findings import Door, Polygon

_SLOT = 0.10
_LOW = 0.15
_LOW_BEAMS = 3
_MARGIN = 0.12
_DOORWAY = 0.6
_JAMB = 0.15
_SECTORS = 1440


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
    index, slot, share = _leaving(points, where, np.asarray(contour, float), *_sides_by_sector(contour, where))
    beyond = points[index].astype(float) - where
    exits = where + share[:, None] * beyond
    reach = np.hypot(beyond[:, 0], beyond[:, 1])
    low = exits[:, 2] - floor_z < _LOW
    passages = np.bincount(slot[low], minlength=int(_first_slots(np.asarray(contour, float))[-1])) >= _LOW_BEAMS
    # A door's jamb shares its slot with the wall: the neighbours of a passage belong to it.
    passages = passages | np.roll(passages, 1) | np.roll(passages, -1)
    through = passages[slot] | (share * reach < _DOORWAY)
    for door in doors:
        through |= np.hypot(exits[:, 0] - door.x, exits[:, 1] - door.y) < door.width / 2 + _JAMB
    kept = np.ones(len(points), bool)
    kept[index] = through
    return kept


def _sides_by_sector(contour: Polygon, station: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """For each of the sectors around the station the sides that reach into it: where they start in a list, the list."""
    start = np.asarray(contour, float) - station[:2]
    end = np.roll(start, -1, axis=0)
    first, last = (np.array([_sector(x, y) for x, y in ends], np.int64) for ends in (start, end))
    # A side whose interior is on its left, seen from within, runs counter-clockwise; one seen from without hides none.
    span = np.where(start[:, 0] * end[:, 1] - start[:, 1] * end[:, 0] > 0, (last - first) % _SECTORS + 1, 0)
    side = np.repeat(np.arange(len(start)), span)
    sector = (np.arange(len(side)) - np.repeat(np.cumsum(span) - span, span) + np.repeat(first, span)) % _SECTORS
    order = np.argsort(sector, kind="stable")
    return np.searchsorted(sector[order], np.arange(_SECTORS + 1)), side[order]


@njit(cache=True)
def _sector(x: float, y: float) -> int:
    """Which of the sectors around the origin, by an angle that needs no trigonometry and grows as the true one."""
    length = abs(x) + abs(y)
    turn = y / length if length > 0 else 0.0
    if x < 0:
        turn = 2.0 - turn
    elif y < 0:
        turn += 4.0
    return min(int(turn * (_SECTORS // 4)), _SECTORS - 1)


@njit(cache=True)
def _first_slots(contour: NDArray[np.float64]) -> NDArray[np.int64]:
    """Number of the first slot of each side, and the number of all."""
    first = np.zeros(len(contour) + 1, np.int64)
    for n in range(len(contour)):
        side = contour[(n + 1) % len(contour)] - contour[n]
        first[n + 1] = first[n] + int(np.sqrt(side[0] ** 2 + side[1] ** 2) / _SLOT) + 1
    return first


@njit(cache=True)
def _leaving(
    points: NDArray[np.floating],
    station: NDArray[np.float64],
    contour: NDArray[np.float64],
    first_of: NDArray[np.int64],
    sides: NDArray[np.int64],
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Points behind the contour: index, slot in which the sight last leaves it, and share of the way at which."""
    slots = _first_slots(contour)
    index, slot, share = np.empty(len(points), np.int64), np.empty(len(points), np.int64), np.empty(len(points))
    count = 0
    for n in range(len(points)):
        x, y = points[n, 0] - station[0], points[n, 1] - station[1]
        sector = _sector(x, y)
        latest = -1.0
        for entry in range(first_of[sector], first_of[sector + 1]):
            a, b = contour[sides[entry]], contour[(sides[entry] + 1) % len(contour)]
            side_x, side_y = b[0] - a[0], b[1] - a[1]
            # The interior is on the left of a side, so a line that goes out crosses it from left to right.
            across = x * side_y - y * side_x
            if across <= 0:
                continue
            left, low = a[0] - station[0], a[1] - station[1]
            way = (left * side_y - low * side_x) / across
            along = (left * y - low * x) / across
            if latest < way < 1 and way > 0 and 0 <= along <= 1:
                latest = way
                slot[count] = slots[sides[entry]] + int(along * np.sqrt(side_x**2 + side_y**2) / _SLOT)
        if latest >= 0 and (1 - latest) * np.sqrt(x * x + y * y) > _MARGIN:
            index[count], share[count] = n, latest
            count += 1
    return index[:count], slot[:count], share[:count]
