"""The robot map M(t): what the robot may drive over, fused from the scans so far (paper sections 2 and 3.2)."""

from dataclasses import dataclass

import cv2
import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from perception.findings import Polygon
from perception.flatness import Flatness, flatness_map
from perception.grids import Cell, Grid
from perception.rasters import counted, picked
from perception.rays.polar import crossed_between
from perception.transforms import Matrix

RESOLUTION = 0.05
"""Side of a cell of the robot map, metres."""
STEP_HEIGHT = 0.06
"""Points this far above the floor are obstacles; the flatness map judges what is lower, metres."""
ROBOT_HEIGHT = 1.45
"""Points above it do not hinder the robot, metres over the floor."""
REACH = 30.0
"""Points further from the scanner stay out of the map, metres."""
CLEAR_REACH = 4.0
"""Floor seen from within this distance can clear an obstacle that has gone, metres."""
CLEARINGS = 2
"""Scans in a row that must see the floor where an obstacle was before it is forgotten."""
LOW_BEAM = 0.10
"""A beam crosses a cell near the floor if it is lower than this over it, metres."""
_FENCE_CELLS = 2


@dataclass(frozen=True)
class MapEvidence:
    """What scans say about the cells, in one frame: ``(rows, columns)`` int16 each.

    Args:
        hits: scans that saw an obstacle, or an irregular floor.
        floor_seen: scans that saw flat floor, or beams crossing near it.
        cleared: scans in a row, since the last hit, that saw the floor from near by.
        origin, resolution: as of :class:`~perception.grids.Grid`, metres; origins are whole multiples of 10 cm.
    """

    hits: NDArray[np.int16]
    floor_seen: NDArray[np.int16]
    cleared: NDArray[np.int16]
    origin: tuple[float, float]
    resolution: float

    def to_grid(self) -> Grid:
        """``M(t)`` of :class:`Cell`: an obstacle wins over free floor until scans in a row have cleared it."""
        data = np.full(self.hits.shape, Cell.UNKNOWN, np.uint8)
        data[self.floor_seen > 0] = Cell.FREE
        data[(self.hits > 0) & (self.cleared < CLEARINGS)] = Cell.OBSTACLE
        return Grid(data, self.origin, self.resolution)


@dataclass(frozen=True)
class PartialMap:
    """``M_p(t)`` of one scan, and the flatness map in it."""

    evidence: MapEvidence
    flatness: Flatness


@njit(cache=True)
def below(points: NDArray[np.float32], map_from_scanner: Matrix, height: float) -> NDArray[np.float32]:
    """Those of the points ``(N, 3)`` of the scanner frame that lie below ``height`` of the map frame, in that frame.

    Half of a scan is ceiling and upper walls, which no robot map needs: one pass over a scan instead of two.
    """
    m = map_from_scanner.astype(np.float32)
    kept = np.empty((len(points), 3), np.float32)
    count = 0
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        up = m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3]
        if up < height:
            kept[count, 0] = m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3]
            kept[count, 1] = m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3]
            kept[count, 2] = up
            count += 1
    return kept[:count]


def partial_map(
    points: NDArray[np.floating],
    station: ArrayLike,
    floor_z: float = 0.0,
    azimuth_step: float = np.deg2rad(0.4),
    robot_height: float = ROBOT_HEIGHT,
) -> PartialMap:
    """The robot map of one scan (section 3.2): obstacles ``M'`` fused with the flatness map ``F``.

    Ceiling, floor and what is above the robot are left out and the rest is projected; single points with none beside
    them are noise. A cell is free where flat floor was seen, and between two floor points of one direction where the
    beam to the further one passed lower than ``LOW_BEAM``.

    Args:
        points: ``(N, 3)`` of one scan, map frame, metres; the whole building, not only the room.
        station: (x, y, z) of the scanner, map frame.
        floor_z: height of the floor, map frame.
        azimuth_step: of the scan or coarser, radians.
        robot_height: of the robot with its scanner, metres.
    """
    where = np.asarray(station, float)
    floor, upright = _layers(points, where[0], where[1], floor_z, REACH, STEP_HEIGHT, robot_height)
    frame = _frame(floor, upright, where)
    obstacle = _obstacles(upright, frame)
    # The foot of a wall is no bump in the floor; its cell is an obstacle already.
    floor = floor[~picked(obstacle, floor, frame)]
    flatness = flatness_map(floor, station=tuple(where))
    irregular, flat = (_refined(flatness.cells, frame, state) for state in (Cell.OBSTACLE, Cell.FREE))
    hits = obstacle | irregular
    crossed = crossed_between(floor, where, frame, where[2] - floor_z, LOW_BEAM, azimuth_step, REACH)
    seen = _without_pinholes(flat | crossed) & ~hits
    counts = [layer.astype(np.int16) for layer in (hits, seen, seen & _close_to(where, frame))]
    return PartialMap(MapEvidence(counts[0], counts[1], counts[2], frame.origin, frame.resolution), flatness)


def couple(previous: MapEvidence | None, partial: MapEvidence) -> MapEvidence:
    """``M(t)`` from ``M(t-1)`` and ``M_p(t)`` (section 2), over the extent of both."""
    if previous is None:
        return partial
    origin = np.minimum(previous.origin, partial.origin)
    ends = [_offset(e, origin) + np.array(e.hits.shape) for e in (previous, partial)]
    old, new = (_placed(e, origin, np.maximum(*ends)) for e in (previous, partial))
    cleared = np.where(new.hits > 0, 0, old.cleared + new.cleared).astype(np.int16)
    return MapEvidence(old.hits + new.hits, old.floor_seen + new.floor_seen, cleared, new.origin, new.resolution)


def fenced(grid: Grid, fence: Polygon) -> Grid:
    """The grid of :class:`Cell` with a line of obstacles along a polygon: no way that is planned in it leads across."""
    lines = grid.data.copy()
    corners = np.rint((fence - grid.origin) / grid.resolution - 0.5).astype(np.int32)
    cv2.polylines(lines, [corners], isClosed=True, color=int(Cell.OBSTACLE), thickness=_FENCE_CELLS)
    return grid.with_data(lines)


def mark_free(grid: Grid, poses: ArrayLike, radius: float, over_obstacles: bool = False) -> Grid:
    """The grid with discs around ``poses`` free: the robot stood or drove there, though its scanner cannot see it.

    Args:
        grid: of :class:`Cell`; grown as needed.
        poses: ``(N, >= 2)``, x and y in the map frame first, metres.
        radius: at most half of the robot's width, metres.
        over_obstacles: also free obstacle cells (right where the robot stands now; a driven path may be blocked since).
    """
    xy = np.asarray(poses, float).reshape(len(np.asarray(poses)), -1)[:, :2]
    if len(xy) == 0:
        return grid
    grown = _grown(grid, xy.min(axis=0) - radius, xy.max(axis=0) + radius)
    disc = np.zeros(grown.shape, np.uint8)
    for row, column in grown.cells_of(xy):
        cv2.circle(disc, (int(column), int(row)), round(radius / grid.resolution), 1, cv2.FILLED)
    freed = (disc > 0) & ((grown.data == Cell.UNKNOWN) | over_obstacles)
    return grown.with_data(np.where(freed, Cell.FREE, grown.data).astype(grid.data.dtype))


@njit(cache=True)
def _layers(
    points: NDArray[np.floating], x: float, y: float, floor_z: float, reach: float, step: float, top: float
) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
    """Points within ``reach`` of (x, y): those of the floor, and those over it that stand in the robot's way."""
    floor, upright = np.empty_like(points), np.empty_like(points)
    floors, uprights = 0, 0
    for n in range(len(points)):
        height = points[n, 2] - floor_z
        if height < -step or height >= top:
            continue
        if (points[n, 0] - x) ** 2 + (points[n, 1] - y) ** 2 >= reach * reach:
            continue
        if height <= step:
            floor[floors] = points[n]
            floors += 1
        else:
            upright[uprights] = points[n]
            uprights += 1
    return floor[:floors].copy(), upright[:uprights].copy()


def _frame(floor: NDArray[np.floating], upright: NDArray[np.floating], station: NDArray[np.floating]) -> Grid:
    """A frame around points and station on whole multiples of two cells, so that frames of all scans match."""
    corners = np.concatenate([_corners(floor), _corners(upright), station[None, :2]])
    block = 2 * RESOLUTION
    low = np.floor(corners.min(axis=0) / block).astype(int) - 1
    high = np.floor(corners.max(axis=0) / block).astype(int) + 2
    columns, rows = 2 * (high - low)
    return Grid(np.zeros((rows, columns), bool), (float(low[0] * block), float(low[1] * block)), RESOLUTION)


def _corners(points: NDArray[np.floating]) -> NDArray[np.float64]:
    """Lowest and highest x and y, ``(2, 2)``; none for no points."""
    if len(points) == 0:
        return np.empty((0, 2))
    x, y = points[:, 0], points[:, 1]
    return np.array([[x.min(), y.min()], [x.max(), y.max()]], float)


def _without_pinholes(seen: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Gaps of up to two cells between seen floor are the beams' spacing: a thing that wide would have been hit."""
    return cv2.morphologyEx(seen.astype(np.uint8), cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8)) > 0


def _close_to(station: NDArray[np.floating], frame: Grid) -> NDArray[np.bool_]:
    rows, columns = (np.arange(n) for n in frame.shape)
    x = frame.origin[0] + (columns + 0.5) * frame.resolution - station[0]
    y = frame.origin[1] + (rows + 0.5) * frame.resolution - station[1]
    return np.asarray(np.hypot(x[None, :], y[:, None]) < CLEAR_REACH)


def _obstacles(points: NDArray[np.floating], frame: Grid) -> NDArray[np.bool_]:
    """Cells with two points, or with one that has two more beside it: a ghost is single, a thin leg is not."""
    counts = counted(points, frame)
    around = cv2.boxFilter(counts, -1, (3, 3), normalize=False)
    return np.asarray((counts >= 2) | ((counts == 1) & (around >= 2.5)))


def _refined(coarse: Grid, frame: Grid, state: Cell) -> NDArray[np.bool_]:
    """Cells of ``frame`` that lie in cells of ``coarse``, twice as large and on the same lattice, with a state."""
    fine = np.repeat(np.repeat(coarse.data == state, 2, axis=0), 2, axis=1)
    row, column = np.rint((np.asarray(coarse.origin) - frame.origin) / frame.resolution).astype(int)[::-1]
    result = np.zeros(frame.shape, bool)
    if fine.any():
        result[row : row + fine.shape[0], column : column + fine.shape[1]] = fine
    return result


def _offset(evidence: MapEvidence, origin: NDArray[np.floating]) -> NDArray[np.int64]:
    """(row, column) of the evidence's first cell in a frame with this origin."""
    return np.rint((np.asarray(evidence.origin) - origin) / evidence.resolution).astype(np.int64)[::-1]


def _placed(evidence: MapEvidence, origin: NDArray[np.floating], shape: NDArray[np.int64]) -> MapEvidence:
    row, column = _offset(evidence, origin)
    rows, columns = evidence.hits.shape
    below, right = int(shape[0] - row - rows), int(shape[1] - column - columns)
    margins = ((row, below), (column, right))
    hits, seen, cleared = (np.pad(n, margins) for n in (evidence.hits, evidence.floor_seen, evidence.cleared))
    return MapEvidence(hits, seen, cleared, (float(origin[0]), float(origin[1])), evidence.resolution)


def _grown(grid: Grid, low: NDArray[np.floating], high: NDArray[np.floating]) -> Grid:
    """The grid padded with unknown cells until it holds both corners."""
    first, last = grid.cells_of(low), grid.cells_of(high)
    before = np.maximum(0, -first)
    after = np.maximum(0, last - np.array(grid.shape) + 1)
    data = np.pad(grid.data, tuple(zip(before, after, strict=True)), constant_values=Cell.UNKNOWN)
    origin = np.asarray(grid.origin) - before[::-1] * grid.resolution
    return Grid(data, (float(origin[0]), float(origin[1])), grid.resolution)
