"""Seen gaps: what lies between two points of a floor or a ceiling that beams of one direction hit."""

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from perception.grids import Grid

_BIN = 0.025


def crossed_between(
    hits: NDArray[np.floating],
    station: ArrayLike,
    frame: Grid,
    height: float,
    clearance: float,
    azimuth_step: float,
    reach: float,
) -> NDArray[np.bool_]:
    """Which cells a beam crossed close to a plane, on its way to a point of that plane further out.

    The points of a floor or a ceiling become sparse with distance. A cell between two of them in one direction is
    free of walls if the beam to the further one had come within ``clearance`` of the plane at the nearer one. The
    points are entered into a polar image (direction, distance) whose gaps are filled along the distance.

    Args:
        hits: ``(N, 2)`` or wider: points of the plane, map frame, metres.
        station: (x, y) of the scanner, map frame.
        frame: whose cells are asked for, by their centres.
        height: distance of the scanner from the plane, metres.
        clearance: metres.
        azimuth_step: of the scan or coarser, radians.
        reach: largest distance, metres.

    Returns:
        Mask of the frame's shape.
    """
    x, y = (float(value) for value in np.asarray(station, float)[:2])
    directions, distances = int(np.ceil(2 * np.pi / azimuth_step)), int(reach / _BIN) + 1
    polar = _entered(hits, x, y, directions, distances, reach)
    farthest = _fill_gaps(polar, height, clearance)
    # What is crossed lies between the station and the hits.
    ends = np.array([[x, y], *_corners(hits)])
    first, last = frame.cells_of(ends.min(axis=0)), frame.cells_of(ends.max(axis=0))
    window = (*np.maximum(first, 0), *np.minimum(last + 1, frame.shape))
    left, low = frame.origin[0] - x, frame.origin[1] - y
    return _looked_up(polar, farthest, frame.shape, window, left, low, frame.resolution, reach)


def _corners(hits: NDArray[np.floating]) -> NDArray[np.float64]:
    x, y = hits[:, 0], hits[:, 1]
    return np.array([[x.min(), y.min()], [x.max(), y.max()]], float) if len(hits) else np.empty((0, 2))


@njit(cache=True)
def _place(x: float, y: float, directions: int) -> tuple[int, int]:
    """Direction and distance of an offset from the station."""
    turn = np.arctan2(y, x) / (2 * np.pi) % 1.0
    return min(int(turn * directions), directions - 1), int(np.sqrt(x * x + y * y) / _BIN)


@njit(cache=True)
def _entered(
    hits: NDArray[np.floating], x: float, y: float, directions: int, distances: int, reach: float
) -> NDArray[np.bool_]:
    polar = np.zeros((directions, distances), np.bool_)
    for n in range(len(hits)):
        dx, dy = hits[n, 0] - x, hits[n, 1] - y
        if dx * dx + dy * dy < reach * reach:
            polar[_place(dx, dy, directions)] = True
    return polar


@njit(cache=True)
def _fill_gaps(polar: NDArray[np.bool_], height: float, clearance: float) -> int:
    """Fill between two hits of a direction where a beam passed near enough; the farthest distance that holds one."""
    farthest = -1
    for direction in range(polar.shape[0]):
        before = -1
        for after in range(polar.shape[1]):
            if not polar[direction, after]:
                continue
            # Similar triangles: the beam that ends at `after` is at `before` this far from the plane.
            if before >= 0 and (after - before) * height <= clearance * after:
                polar[direction, before:after] = True
            before = after
        farthest = max(farthest, before)
    return farthest


@njit(cache=True)
def _looked_up(
    polar: NDArray[np.bool_],
    farthest: int,
    shape: tuple[int, int],
    window: tuple[int, int, int, int],
    left: float,
    low: float,
    cell: float,
    reach: float,
) -> NDArray[np.bool_]:
    image = np.zeros(shape, np.bool_)
    limit = min(reach, (farthest + 1) * _BIN)
    for row in range(window[0], window[2]):
        dy = low + (row + 0.5) * cell
        for column in range(window[1], window[3]):
            dx = left + (column + 0.5) * cell
            if dx * dx + dy * dy < limit * limit:
                image[row, column] = polar[_place(dx, dy, polar.shape[0])]
    return image
