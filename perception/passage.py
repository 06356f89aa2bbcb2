"""How wide a gap is to somebody who may go through it obliquely: what an opened leaf leaves of a door (section 2)."""

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

_CELL = 0.02
_ASIDE = 0.9
_FRONT, _BACK = -0.6, 1.0
_TOLERANCE = 0.01


@dataclass(frozen=True)
class Passage:
    """The way through an opening.

    Args:
        clearance: diameter of the largest disc that gets through, metres; 0 where none does.
        centre: u of that disc's widest place in the plane of the wall, metres.
    """

    clearance: float
    centre: float


def passage(obstacles: NDArray[np.floating], left: float, right: float, thickness: float) -> Passage:
    """Widest way through an opening in a wall.

    Args:
        obstacles: ``(N, 2)`` points (u, d) at the heights of the robot, u along the wall, d through it, metres.
        left, right: u of the jambs.
        thickness: of the wall, which fills 0 <= d <= thickness beside the opening.

    A straight corridor would refuse a door whose leaf stands half open, although a robot that turns a little passes:
    the width is the bottleneck of the clearance from all obstacles on the best way from one side to the other.
    """
    columns, rows = round((right - left + 2 * _ASIDE) / _CELL), round((_BACK - _FRONT) / _CELL)
    free = np.full((rows, columns), 255, np.uint8)
    cell = np.floor((obstacles - (left - _ASIDE, _FRONT)) / _CELL).astype(int)
    cell = cell[np.all((cell >= 0) & (cell < (columns, rows)), axis=1)]
    # A stray or mixed point is not an obstacle.
    hits = np.zeros(free.shape, np.float32)
    np.add.at(hits, (cell[:, 1], cell[:, 0]), 1)
    free[cv2.boxFilter(hits, -1, (3, 3), normalize=False) * (hits > 0) >= 3] = 0
    wall = slice(round(-_FRONT / _CELL), max(round((thickness - _FRONT) / _CELL), round(-_FRONT / _CELL) + 1))
    jambs = round(_ASIDE / _CELL), columns - round(_ASIDE / _CELL)
    free[wall, : jambs[0]] = free[wall, jambs[1] :] = 0
    room = cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * _CELL
    low, high = 0.0, (right - left) / 2 + _CELL
    while high - low > _TOLERANCE / 2:
        middle = (low + high) / 2
        low, high = (middle, high) if _crosses(room >= middle) else (low, middle)
    plane = room[(wall.start + wall.stop) // 2, jambs[0] : jambs[1]]
    widest = np.flatnonzero(plane >= plane.max() - _CELL / 2)
    centre = left + (float(np.mean(widest)) + 0.5) * _CELL
    # Half a cell on either side belongs to the obstacle's cell, not to the obstacle.
    return Passage(min(2 * low + _CELL / 2, right - left) if low > _TOLERANCE else 0.0, centre)


def _crosses(passable: NDArray[np.bool_]) -> bool:
    """Whether a connected part of the mask touches the first and the last row."""
    _, labels = cv2.connectedComponents(passable.astype(np.uint8), connectivity=8)
    return bool(np.intersect1d(labels[0][passable[0]], labels[-1][passable[-1]]).size)
