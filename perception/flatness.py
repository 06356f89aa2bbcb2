"""The flatness map F(t): irregular zones of the floor from its normals (paper section 3.2, Eq. 1 and 2)."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, median_filter

from perception.grids import Cell, Grid

CELL = 0.10
"""Side of a cell, metres: twice the robot map's."""
GRADIENT_LIMIT = np.deg2rad(8.0)
"""A cell is irregular where the normal's angle changes by more than this to a neighbour, radians."""
STEP_LIMIT = 0.008
"""... or where it lies this far from the floor around it, metres: a bar that fills its cell has an upright normal."""
SIGMAS = 4.0
"""Both must also exceed this many standard deviations of what the noise of the ranges explains."""
MIN_POINTS = 3
_NEIGHBOURHOOD = 9


@dataclass(frozen=True)
class Flatness:
    """The flatness map and the images it comes from, all with the same frame.

    Args:
        cells: of :class:`Cell`: FREE is flat, OBSTACLE irregular, UNKNOWN has too few points to tell.
        angle: between normal and vertical, radians; nan where the points do not tell.
        gradient: largest change of ``angle`` to one of the four neighbours, radians; nan where unknown.
        height: of the weighted mean of the cell over the floor around it, metres; nan where unknown.
    """

    cells: Grid
    angle: Grid
    gradient: Grid
    height: Grid


@dataclass(frozen=True)
class _Planes:
    """One fitted plane for each of the occupied cells, flat arrays."""

    cell: NDArray[np.int64]
    angle: NDArray[np.float64]
    height: NDArray[np.float64]
    angle_sigma: NDArray[np.float64]
    height_sigma: NDArray[np.float64]


def flatness_map(
    floor_points: NDArray[np.floating],
    cell: float = CELL,
    noise: float = 0.003,
    station: tuple[float, ...] | None = None,
) -> Flatness:
    """Flat and irregular cells of the floor.

    The normal of a cell is the eigenvector of the smallest eigenvalue of its weighted scatter matrix (Eq. 1, weights
    Eq. 2 about the point nearest to the centre). Far from the scanner the few points of a cell lie nearly on a line,
    and any normal fits them: there the cell counts as irregular only beyond what ``noise`` explains, and as unknown
    where the noise alone could pass the limit. In addition to the paper's gradient a step test compares the height of
    the cell with the median of its surroundings.

    Args:
        floor_points: ``(N, 3)``, map frame, metres, within some centimetres of the floor.
        cell: side of a cell, metres.
        noise: standard deviation of a range, metres.
        station: (x, y, z) of the scanner; the noise of a height is ``noise`` times the sine of the beam's slope, which
            is small far away. Without it the full noise is assumed everywhere.
    """
    frame = _frame(floor_points, cell)
    planes = _planes(floor_points, frame, noise, station)
    told = SIGMAS * planes.angle_sigma < 2 * GRADIENT_LIMIT
    angle = _image(frame, planes.cell, np.where(told, planes.angle, np.nan))
    height = _image(frame, planes.cell, planes.height)
    height = height - _surroundings(height)
    gradient = _gradient(angle)
    angle_noise = SIGMAS * _image(frame, planes.cell, planes.angle_sigma)
    height_noise = SIGMAS * _image(frame, planes.cell, planes.height_sigma)
    bent = (gradient > GRADIENT_LIMIT) & (angle > np.maximum(GRADIENT_LIMIT / 2, angle_noise))
    stepped = np.abs(height) > np.maximum(STEP_LIMIT, height_noise)
    cells = np.where(np.isnan(angle), Cell.UNKNOWN, Cell.FREE).astype(np.uint8)
    cells[bent | stepped] = Cell.OBSTACLE
    return Flatness(*(frame.with_data(data) for data in (cells, angle, gradient, height)))


def _frame(points: NDArray[np.floating], cell: float) -> Grid:
    """The cells, at whole multiples of their side, that hold all points; a single one for no points."""
    x, y = (points[:, 0], points[:, 1]) if len(points) else (np.zeros(1), np.zeros(1))
    left, low = (int(np.floor(axis.min() / cell)) for axis in (x, y))
    columns, rows = (int(np.floor(axis.max() / cell)) + 1 - first for axis, first in ((x, left), (y, low)))
    return Grid(np.full((rows, columns), np.nan), (left * cell, low * cell), cell)


def _planes(points: NDArray[np.floating], frame: Grid, noise: float, station: tuple[float, ...] | None) -> _Planes:
    """The plane of each cell that holds enough points, from the sums of Eq. (1) over them."""
    sums = _cell_sums(points, frame.shape, *frame.origin, frame.resolution)
    cell = np.flatnonzero(sums.number >= MIN_POINTS)
    count, scatter, moment = sums.number[cell], sums.scatter[cell], sums.moment[cell]
    eigenvalues, eigenvectors = np.linalg.eigh(scatter)
    angle = np.arccos(np.clip(np.abs(eigenvectors[:, 2, 0]), 0.0, 1.0))
    sigma = noise * _slope_factor(points[sums.reference[cell]].astype(float), station)
    return _Planes(
        cell,
        angle,
        sums.height[cell] / count,
        sigma * _leverage(moment, eigenvalues[:, 1]),
        sigma / np.sqrt(count),
    )


class _CellSums(NamedTuple):
    """Sums over the points of each cell, flat: offsets are from the reference point p_r and weighted by Eq. (2).

    Args:
        number: of points.
        height: sum of z.
        reference: index of p_r, the point nearest to the cell's centre.
        scatter: ``(cells, 3, 3)``, sum of the products of weighted offsets.
        moment: ``(cells, 2)``, sum of the weighted offsets in x and y, weighted once more.
    """

    number: NDArray[np.int64]
    height: NDArray[np.float64]
    reference: NDArray[np.int64]
    scatter: NDArray[np.float64]
    moment: NDArray[np.float64]


@njit(cache=True)
def _cell_sums(points: NDArray[np.floating], shape: tuple[int, int], x: float, y: float, side: float) -> _CellSums:
    """Three passes over the points: which is nearest to the centre, how far is the furthest from it, the sums."""
    cells = shape[0] * shape[1]
    count, height = np.zeros(cells, np.int64), np.zeros(cells)
    reference, nearest = np.zeros(cells, np.int64), np.full(cells, np.inf)
    key = np.empty(len(points), np.int32)
    for n in range(len(points)):
        across, along = (points[n, 0] - x) / side, (points[n, 1] - y) / side
        # A point on the frame's edge may be rounded off it.
        column = min(max(int(np.floor(across)), 0), shape[1] - 1)
        row = min(max(int(np.floor(along)), 0), shape[0] - 1)
        cell = row * shape[1] + column
        off_centre = (across - column - 0.5) ** 2 + (along - row - 0.5) ** 2
        key[n] = cell
        count[cell] += 1
        height[cell] += points[n, 2]
        if off_centre < nearest[cell]:
            nearest[cell], reference[cell] = off_centre, n
    furthest = np.zeros(cells)
    for n in range(len(points)):
        distance = np.sqrt(_squared(*_offset(points, n, reference[key[n]])))
        furthest[key[n]] = max(furthest[key[n]], distance)
    scatter, moment = np.zeros((cells, 3, 3)), np.zeros((cells, 2))
    for n in range(len(points)):
        cell = key[n]
        dx, dy, dz = _offset(points, n, reference[cell])
        # Eq. (2): 1 at p_r, where the distance is least, namely zero; 0 at the furthest point of the cell.
        weight = 1.0 - np.sqrt(_squared(dx, dy, dz)) / furthest[cell] if furthest[cell] > 0 else 1.0
        moment[cell, 0] += weight * weight * dx
        moment[cell, 1] += weight * weight * dy
        offset = (weight * dx, weight * dy, weight * dz)
        for i in range(3):
            for j in range(3):
                scatter[cell, i, j] += offset[i] * offset[j]
    return _CellSums(count, height, reference, scatter, moment)


@njit(cache=True)
def _offset(points: NDArray[np.floating], n: int, reference: int) -> tuple[float, float, float]:
    p, r = points[n], points[reference]
    return float(p[0]) - float(r[0]), float(p[1]) - float(r[1]), float(p[2]) - float(r[2])


@njit(cache=True)
def _squared(x: float, y: float, z: float) -> float:
    return x * x + y * y + z * z


def _leverage(moment: NDArray[np.float64], spread: NDArray[np.float64]) -> NDArray[np.float64]:
    """Standard deviation of the normal's angle per standard deviation of a height.

    The points' own errors divide by the root of the spread; the error of the reference point shifts them all and
    counts with their first moment.
    """
    spread = np.maximum(spread, 1e-12)
    return np.asarray(np.sqrt(1.0 / spread + np.square(np.linalg.norm(moment, axis=1) / spread)))


def _slope_factor(points: NDArray[np.float64], station: tuple[float, ...] | None) -> NDArray[np.float64]:
    if station is None:
        return np.ones(len(points))
    beam = points - np.asarray(station)
    # Never quite zero: the direction of a beam is not exact either.
    return np.maximum(np.abs(beam[:, 2]) / np.linalg.norm(beam, axis=1), 0.1)


def _image(frame: Grid, cell: NDArray[np.int64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    image = np.full(frame.data.size, np.nan)
    image[cell] = values
    return image.reshape(frame.shape)


def _surroundings(height: NDArray[np.float64]) -> NDArray[np.float64]:
    """Median height around each cell; unknown cells count as high as the nearest known one."""
    unknown = np.isnan(height)
    if unknown.all():
        return height
    nearest = distance_transform_edt(unknown, return_distances=False, return_indices=True)
    return median_filter(height[tuple(nearest)], _NEIGHBOURHOOD, mode="nearest")


def _gradient(angle: NDArray[np.float64]) -> NDArray[np.float64]:
    change = np.full((4, *angle.shape), -1.0)
    vertical, horizontal = np.abs(np.diff(angle, axis=0)), np.abs(np.diff(angle, axis=1))
    change[0, 1:], change[1, :-1] = vertical, vertical
    change[2, :, 1:], change[3, :, :-1] = horizontal, horizontal
    steepest = np.nan_to_num(change, nan=-1.0).max(axis=0)
    return np.where(np.isnan(angle), np.nan, np.maximum(steepest, 0.0))
