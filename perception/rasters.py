"""Points on images in one pass: how many lie on each cell, and what a cell says of the points on it."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from perception.grids import Grid


def counted(points: NDArray[np.floating], frame: Grid) -> NDArray[np.float32]:
    """How many of the points ``(N, >= 2)`` lie on each cell of the frame; all of them must lie on it."""
    return _counted(points, frame.shape, *frame.origin, frame.resolution)


def picked(image: NDArray[np.bool_], points: NDArray[np.floating], frame: Grid) -> NDArray[np.bool_]:
    """``(N,)``: the cell of a mask of the frame's shape under each point ``(N, >= 2)``; False off the frame."""
    return _picked(image, points, *frame.origin, frame.resolution)


@njit(cache=True)
def _counted(
    points: NDArray[np.floating], shape: tuple[int, int], x: float, y: float, cell: float
) -> NDArray[np.float32]:
    counts = np.zeros(shape, np.float32)
    for n in range(len(points)):
        counts[int(np.floor((points[n, 1] - y) / cell)), int(np.floor((points[n, 0] - x) / cell))] += 1
    return counts


@njit(cache=True)
def _picked(
    image: NDArray[np.bool_], points: NDArray[np.floating], x: float, y: float, cell: float
) -> NDArray[np.bool_]:
    values = np.zeros(len(points), np.bool_)
    for n in range(len(points)):
        row, column = int(np.floor((points[n, 1] - y) / cell)), int(np.floor((points[n, 0] - x) / cell))
        if 0 <= row < image.shape[0] and 0 <= column < image.shape[1]:
            values[n] = image[row, column]
    return values
