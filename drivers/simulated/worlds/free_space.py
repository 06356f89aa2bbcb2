"""Where a robot fits: occupancy of a mesh between two heights, the flood from the start, the clearest places."""

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from drivers.simulated.world import World
from perception.grids import Grid

RESOLUTION = 0.05
ROBOT_BAND = (0.03, 1.4)
ROBOT_RADIUS = 0.36


def occupancy(
    world: World, band: tuple[float, float] = ROBOT_BAND, resolution: float = RESOLUTION, margin: float = 0.5
) -> Grid:
    """Grid of bool, True where any triangle passes between the two heights (metres), over the whole mesh."""
    return occupancy_of(world.corners(), band, resolution, margin)


def occupancy_of(corners: NDArray[np.floating], band: tuple[float, float], resolution: float, margin: float) -> Grid:
    """As :func:`occupancy`, of the triangles ``(K, 3, 3)``."""
    z = corners[:, :, 2]
    inside = corners[(z.max(axis=1) >= band[0]) & (z.min(axis=1) <= band[1])].astype(np.float64)
    flat = (inside if len(inside) else corners)[:, :, :2].reshape(-1, 2)
    origin = np.floor((flat.min(axis=0) - margin) / resolution) * resolution
    columns, rows = np.ceil((flat.max(axis=0) + margin - origin) / resolution).astype(int)
    data = np.zeros((rows, columns), np.bool_)
    _mark(inside, band[0], band[1], origin, resolution, data)
    return Grid(data, (float(origin[0]), float(origin[1])), resolution)


def clearance(occupied: Grid) -> Grid:
    """Distance from the centre of each cell to the nearest occupied cell's centre, metres."""
    free = np.logical_not(occupied.data).astype(np.uint8)
    return occupied.with_data(cv2.distanceTransform(free, cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * occupied.resolution)


def flood(world: World, radius: float = ROBOT_RADIUS, band: tuple[float, float] = ROBOT_BAND) -> Grid:
    """Grid of bool: the positions that a disc of this radius (metres) can roll to from the start."""
    distance = clearance(occupancy(world, band))
    parts, labels = cv2.connectedComponents((distance.data >= radius).astype(np.uint8), connectivity=4)
    row, column = distance.cells_of(world.start[:2])
    label = labels[row, column] if distance.contains((row, column)) else 0
    return distance.with_data((labels == label) & (label > 0) & (parts > 1))


def reachable(world: World, radius: float = ROBOT_RADIUS, band: tuple[float, float] = ROBOT_BAND) -> list[str]:
    """Ids of the rooms that a robot of this inscribed radius (metres) can enter from the start."""
    region = flood(world, radius, band)
    return [room.room_id for room in world.truth.rooms if bool((region.data & mask_of(room.polygon, region)).any())]


def mask_of(polygon: NDArray[np.floating], grid: Grid) -> NDArray[np.bool_]:
    """Cells of a grid whose centre lies in a polygon ``(N, 2)``, edges not included."""
    shift = 8
    corners = ((np.asarray(polygon, float) - grid.origin) / grid.resolution - 0.5) * (1 << shift)
    filled = np.zeros(grid.shape, np.uint8)
    cv2.fillPoly(filled, [np.round(corners).astype(np.int32)], 1, shift=shift)
    # OpenCV fills the outline too, which lies half a cell to either side of it.
    return cv2.erode(filled, np.ones((3, 3), np.uint8), borderValue=0).astype(bool)


def clearest(region: Grid, enough: float = 3.0) -> tuple[float, float]:
    """The free position (x, y) with the most room around it; beyond ``enough`` metres nearer to the middle wins."""
    distance = np.minimum(clearance(region.with_data(~region.data)).data, enough)
    rows, columns = np.nonzero(distance >= distance.max() - region.resolution)
    middle = np.array([rows.mean(), columns.mean()])
    nearest = np.argmin(np.hypot(rows - middle[0], columns - middle[1]))
    x, y = region.centres_of((rows[nearest], columns[nearest]))
    return float(x), float(y)


@njit(cache=True)
def _mark(
    corners: NDArray[np.float64], low: float, high: float, origin: NDArray[np.float64], cell: float, out: NDArray
) -> None:
    """Set the cells below each triangle's part between two heights: its edges and its inside."""
    for index in range(corners.shape[0]):
        polygon = _clip(_clip(corners[index], low, 1.0), -high, -1.0)
        count = polygon.shape[0]
        for k in range(count):
            a, b = polygon[k], polygon[(k + 1) % count]
            steps = int(np.ceil(max(abs(b[0] - a[0]), abs(b[1] - a[1])) / (0.25 * cell))) + 1
            for step in range(steps + 1):
                f = step / steps
                row = int((a[1] + f * (b[1] - a[1]) - origin[1]) / cell)
                out[row, int((a[0] + f * (b[0] - a[0]) - origin[0]) / cell)] = True
        if count >= 3:
            _fill(polygon, origin, cell, out)


@njit(cache=True)
def _clip(polygon: NDArray[np.float64], limit: float, sign: float) -> NDArray[np.float64]:
    """The part of a polygon ``(N, 3)`` where ``sign * z >= limit``."""
    count = polygon.shape[0]
    kept = np.empty((count + 2, 3))
    size = 0
    for k in range(count):
        a, b = polygon[k], polygon[(k + 1) % count]
        da, db = sign * a[2] - limit, sign * b[2] - limit
        if da >= 0:
            kept[size] = a
            size += 1
        if (da > 0 and db < 0) or (da < 0 and db > 0):
            kept[size] = a + (b - a) * (da / (da - db))
            size += 1
    return kept[:size]


@njit(cache=True)
def _fill(polygon: NDArray[np.float64], origin: NDArray[np.float64], cell: float, out: NDArray) -> None:
    """Set the cells whose centre lies in a convex polygon, row by row."""
    first = int((polygon[:, 1].min() - origin[1]) / cell)
    last = int((polygon[:, 1].max() - origin[1]) / cell)
    count = polygon.shape[0]
    for row in range(first, last + 1):
        y = origin[1] + (row + 0.5) * cell
        left, right = np.inf, -np.inf
        for k in range(count):
            a, b = polygon[k], polygon[(k + 1) % count]
            if (a[1] <= y) != (b[1] <= y):
                x = a[0] + (b[0] - a[0]) * (y - a[1]) / (b[1] - a[1])
                left, right = min(left, x), max(right, x)
        if left < right:
            start = int(np.ceil((left - origin[0]) / cell - 0.5))
            stop = int(np.floor((right - origin[0]) / cell - 0.5))
            out[row, start : stop + 1] = True
