"""The flatness map F(t): irregular zones of the floor from its normals (paper section 3.2, Eq. 1 and 2)."""

from dataclasses import dataclass

import numpy as np
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
    origin = np.floor(floor_points[:, :2].min(axis=0, initial=0.0) / cell) * cell if len(floor_points) else np.zeros(2)
    columns, rows = (
        (np.floor((floor_points[:, :2].max(axis=0) - origin) / cell + 1e-6).astype(int) + 1)
        if len(floor_points)
        else (1, 1)
    )
    frame = Grid(np.full((int(rows), int(columns)), np.nan), (float(origin[0]), float(origin[1])), cell)
    planes = _planes(floor_points.astype(float), frame, noise, station)
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


def _planes(points: NDArray[np.float64], frame: Grid, noise: float, station: tuple[float, ...] | None) -> _Planes:
    """Scatter matrices of all cells at once: points sorted by cell, sums by ``add.reduceat``."""
    row, column = frame.cells_of(points).T
    key = row * frame.shape[1] + column
    off_centre = np.hypot(*(points[:, :2] - frame.centres_of(np.stack([row, column], axis=1))).T)
    order = np.lexsort((off_centre, key))
    key, points = key[order], points[order]
    starts = np.flatnonzero(np.diff(key, prepend=-1))
    counts = np.diff(np.append(starts, len(key)))
    enough = np.repeat(counts >= MIN_POINTS, counts)
    key, points = key[enough], points[enough]
    counts = counts[counts >= MIN_POINTS]
    if len(counts) == 0:
        empty = np.empty(0)
        return _Planes(np.empty(0, np.int64), empty, empty, empty, empty)
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    # The order within a cell puts the point nearest to its centre first: the reference point p_r.
    offset = points - np.repeat(points[starts], counts, axis=0)
    weight = _weights(offset, starts, counts)
    weighted = offset * weight[:, None]
    scatter = np.add.reduceat(weighted[:, :, None] * weighted[:, None, :], starts)
    eigenvalues, eigenvectors = np.linalg.eigh(scatter)
    angle = np.arccos(np.clip(np.abs(eigenvectors[:, 2, 0]), 0.0, 1.0))
    sigma = noise * _slope_factor(points[starts], station)
    return _Planes(
        key[starts],
        angle,
        np.add.reduceat(points[:, 2], starts) / counts,
        sigma * _leverage(weighted, weight, starts, eigenvalues[:, 1]),
        sigma / np.sqrt(counts),
    )


def _weights(offset: NDArray[np.float64], starts: NDArray[np.intp], counts: NDArray[np.intp]) -> NDArray[np.float64]:
    """Eq. (2): 1 at the reference point, 0 at the furthest point of the cell."""
    distance = np.linalg.norm(offset, axis=1)
    largest = np.repeat(np.maximum.reduceat(distance, starts), counts)
    # d_min is zero, for the reference point is one of the cell's points.
    return np.divide(largest - distance, largest, out=np.ones_like(distance), where=largest > 0)


def _leverage(
    weighted: NDArray[np.float64], weight: NDArray[np.float64], starts: NDArray[np.intp], spread: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Standard deviation of the normal's angle per standard deviation of a height.

    The points' own errors divide by the root of the spread; the error of the reference point shifts them all and
    counts with their first moment.
    """
    moment = np.linalg.norm(np.add.reduceat(weighted[:, :2] * weight[:, None], starts), axis=1)
    spread = np.maximum(spread, 1e-12)
    return np.sqrt(1.0 / spread + np.square(moment / spread))


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
