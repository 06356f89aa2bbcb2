"""Straight segments of a room's outline, moved to the true walls by their d-histograms (paper section 3.1)."""

from dataclasses import dataclass, replace

import cv2
import numpy as np
import shapely
from numba import njit
from numpy.typing import NDArray

from perception.findings import Polygon
from perception.grids import Grid
from perception.rasters import picked
from perception.segmentation import Histogram, Interval, local_maxima, peak_interval
from perception.views import Views

Vector = NDArray[np.float64]

STRAIGHTNESS = 0.12
"""Largest distance of the outline from its straight segments, metres."""
INNER, OUTER = 0.25, 0.45
"""How far inside and outside of an outline's segment its wall is looked for, metres."""
SHORT = 1.2
"""Sides below this length take the direction of the longest wall, or a right angle to it, if they nearly have it."""
OUTER_SHARE = 0.25
"""An outer peak is the wall if it holds this share of the highest peak of the d-histogram."""
NOTCH_DEPTH, NOTCH_WIDTH, NOTCH_SIDES = 0.45, 0.8, 4
"""A dent in a wall up to this deep and wide (metres, number of sides) is filled."""
HEIGHT_SHARE = 0.75
"""... and shows in this share of the heights that the fullest peak shows in: full height, not a frame or a sill."""
CEILING_SHARE = 0.6
"""... or if it meets the ceiling along this share of the side where nothing before it does: above a curtain."""
_CEILING_ROWS = 3
_BIN = 0.02
_PATCH = 0.10


@dataclass(frozen=True)
class Line:
    """A directed side of the contour from ``start`` to ``end`` (interior on its left); ``wall`` if points hold it."""

    start: Vector
    end: Vector
    wall: bool = False

    @property
    def length(self) -> float:
        return float(np.linalg.norm(self.end - self.start))

    @property
    def direction(self) -> Vector:
        return (self.end - self.start) / max(self.length, 1e-9)

    @property
    def outward(self) -> Vector:
        tx, ty = self.direction
        return np.array([ty, -tx])

    def distance(self, xy: NDArray[np.floating]) -> NDArray[np.float64]:
        """Signed distance of positions ``(..., 2)``, positive outside."""
        return (xy - self.start) @ self.outward

    def along(self, xy: NDArray[np.floating]) -> NDArray[np.float64]:
        return (xy - self.start) @ self.direction

    def foot(self, xy: Vector) -> Vector:
        return self.start + self.direction * self.along(xy)

    def angle_to(self, other: "Line") -> float:
        cross = self.direction[0] * other.direction[1] - self.direction[1] * other.direction[0]
        return float(np.arctan2(cross, self.direction @ other.direction))

    def meets(self, other: "Line") -> Vector:
        """Where the two infinite lines meet; they must not be parallel."""
        step = np.linalg.solve(np.stack([self.direction, -other.direction], axis=1), other.start - self.start)
        return self.start + self.direction * step[0]


def fit_walls(outline: Polygon, views: Views, floor_z: float, ceiling_z: float) -> tuple[Polygon, NDArray[np.float64]]:
    """Contour ``H`` and walls from the outline of the ceiling segment.

    Args:
        outline: ``(N, 2)`` counter-clockwise, map frame, accurate to some cells of an image.
        views: the points around.
        floor_z, ceiling_z: of the room, map frame.

    Returns:
        The contour (counter-clockwise) and one row (x0, y0, x1, y1) for each side that is a wall, interior on its left.
    """
    corners = cv2.approxPolyDP(outline.astype(np.float32)[:, None], STRAIGHTNESS, True)[:, 0].astype(float)
    sides = [Line(a, b) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    height = views.points[:, 2]
    upright = (height > floor_z + 0.15) & (height < ceiling_z - 0.08)
    near_views = views.subset(upright & _near_outline(views.points, corners))
    squared = _squared([_moved_to_wall(side, near_views, ceiling_z) for side in sides], sides)
    sides = [_moved_to_wall(side, near_views, ceiling_z) for side in squared]
    return _assemble(_simplified(sides), corners)


def _squared(fitted: list[Line], sides: list[Line]) -> list[Line]:
    """Short sides turned to the directions of the longest wall: the image tells a short side's direction badly."""
    walls = [side for side in fitted if side.wall]
    if not walls:
        return sides
    ruler = max(walls, key=lambda side: side.length)
    return [
        _turned(before, ruler) if before.length < SHORT else after for before, after in zip(sides, fitted, strict=True)
    ]


def _turned(side: Line, ruler: Line) -> Line:
    off = (ruler.angle_to(side) + np.pi / 4) % (np.pi / 2) - np.pi / 4
    if abs(off) > np.deg2rad(25):
        return side
    cos, sin = np.cos(-off), np.sin(-off)
    half = np.array([[cos, -sin], [sin, cos]]) @ (side.end - side.start) / 2
    middle = (side.start + side.end) / 2
    return Line(middle - half, middle + half)


def _near_outline(points: NDArray[np.floating], corners: Vector) -> NDArray[np.bool_]:
    """Positions in a band around the outline, by a coarse image: a room is full of points far from its walls."""
    reach = INNER + OUTER
    low = corners.min(axis=0) - reach
    columns, rows = np.ceil((corners.max(axis=0) + reach - low) / _PATCH).astype(int)
    band = np.zeros((rows, columns), np.uint8)
    outline = ((corners - low) / _PATCH).astype(np.int32)
    cv2.polylines(band, [outline], True, 1, thickness=2 * round(reach / _PATCH) + 1)
    return picked(band > 0, points, Grid(band, (float(low[0]), float(low[1])), _PATCH))


def _moved_to_wall(side: Line, views: Views, ceiling_z: float) -> Line:
    if side.length < 0.3:
        return side
    trim = min(0.1, side.length / 4)
    for _ in range(2):
        along, distance, height = _facing(side, views, trim)
        wall = wall_peak(along, distance, ceiling_z - height, side.length)
        if wall is None:
            return replace(side, wall=False)
        chosen = wall.contains(distance)
        side = _fitted(side, along[chosen], distance[chosen])
    return side


def _facing(side: Line, views: Views, trim: float) -> tuple[Vector, Vector, Vector]:
    """Place along, distance outwards and height of the points around a side that were seen from within.

    The other face of the wall was not.
    """
    limits = (trim, side.length - trim, -INNER, 0.15 if views.stations is None else OUTER)
    index, along, distance = _strip(views.points, side.start, side.direction, limits)
    if views.stations is not None and views.station_of is not None:
        seen = side.distance(views.stations[:, :2])[views.station_of[index]] < distance - 0.02
        index, along, distance = index[seen], along[seen], distance[seen]
    return along, distance, views.points[index, 2]


@njit(cache=True)
def _strip(
    points: NDArray[np.floating], start: Vector, direction: Vector, limits: tuple[float, float, float, float]
) -> tuple[NDArray[np.intp], Vector, Vector]:
    """Points within (low, high) along a line and (low, high) to its right: indices, and the places both ways."""
    chosen = np.empty(len(points), np.intp)
    alongs, rights = np.empty(len(points)), np.empty(len(points))
    count = 0
    for n in range(len(points)):
        x, y = points[n, 0] - start[0], points[n, 1] - start[1]
        right = x * direction[1] - y * direction[0]
        along = x * direction[0] + y * direction[1]
        if limits[2] < right < limits[3] and limits[0] < along < limits[1]:
            chosen[count], alongs[count], rights[count] = n, along, right
            count += 1
    return chosen[:count], alongs[:count], rights[:count]


def wall_peak(
    along: NDArray[np.floating], distance: NDArray[np.floating], below: NDArray[np.floating], length: float
) -> Interval | None:
    """Interval of the d-histogram around the wall: its outer significant peak, or None if there is no wall.

    The histogram counts patches of 10 x 10 cm instead of points, so that its height is an area whatever the density.
    Curtains and cabinets stand before the wall, which shows over the full height beside them or, where they do not
    reach the ceiling, above them. What lies behind a wall (panes, frames, reveals) shows over a part of the height.

    Args:
        along, distance: ``(N,)`` position along the side and outwards of it, metres.
        below: ``(N,)`` depth under the ceiling, metres.
        length: of the side, metres.
    """
    if len(distance) < 20:
        return None
    bins = np.floor((distance + INNER) / _BIN).astype(int) + 1
    row, column = np.floor(below / _PATCH).astype(int), np.floor(along / _PATCH).astype(int)
    size = int(np.ceil((INNER + OUTER) / _BIN)) + 3
    counts = _distinct(bins, size, row, column)
    height = _distinct(bins, size, row)
    under_ceiling = row < _CEILING_ROWS
    met = _distinct(bins[under_ceiling], size, column[under_ceiling])
    peaks = local_maxima(_with_neighbours(counts), reach=2)
    area, height, met = (_with_neighbours(values)[peaks] for values in (counts, height, met))
    columns = length / _PATCH
    visible = area > 0.03 * columns * height.max()
    full_height = visible & (area >= OUTER_SHARE * area.max()) & (height >= HEIGHT_SHARE * height.max())
    under = visible & (met >= CEILING_SHARE * columns)
    if full_height.any() and met[full_height][-1] >= 0.5 * CEILING_SHARE * columns:
        under[:] = False
    significant = full_height | under
    if not significant.any():
        return None
    outer = int(peaks[significant][-1])
    summit = max(outer - 1, 0) + int(np.argmax(counts[max(outer - 1, 0) : outer + 2]))
    return peak_interval(Histogram(counts, -INNER - _BIN, _BIN), summit, slope=0.1)


def _distinct(bins: NDArray[np.intp], size: int, *keys: NDArray[np.intp]) -> NDArray[np.float64]:
    """How many distinct values of ``keys`` each bin holds."""
    extents = [size, *(int(key.max(initial=0)) + 1 for key in keys)]
    seen = np.zeros(extents, bool)
    seen[(bins, *keys)] = True
    return seen.reshape(size, -1).sum(axis=1).astype(float)


def _with_neighbours(values: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.convolve(values, np.ones(3), "same")


def _fitted(side: Line, u: Vector, d: Vector) -> Line:
    """The side on the line through wall points along (u) and outwards (d), by least squares as tolerance shrinks."""
    slope, offset = 0.0, float(np.median(d))
    for tolerance in (0.03, 0.015, 0.01):
        count, span, closer = _closer_line(u, d, slope, offset, tolerance)
        if count < 10 or span < 0.3 * side.length:
            break
        slope, offset = closer
    if abs(slope) * side.length > INNER + OUTER:
        slope, offset = 0.0, float(np.median(d))
    ends = (side.start + side.outward * offset, side.end + side.outward * (offset + slope * side.length))
    return Line(*ends, wall=True)


@njit(cache=True)
def _closer_line(
    u: Vector, d: Vector, slope: float, offset: float, tolerance: float
) -> tuple[int, float, tuple[float, float]]:
    """Points within ``tolerance`` of a line: number, extent along u, and the line through them by least squares."""
    count, low, high = 0, np.inf, -np.inf
    sum_u, sum_d, sum_uu, sum_ud = 0.0, 0.0, 0.0, 0.0
    for n in range(len(u)):
        off = d[n] - offset - slope * u[n]
        if abs(off) < tolerance:
            count += 1
            low, high = min(low, u[n]), max(high, u[n])
            sum_u += u[n]
            sum_d += off
            sum_uu += u[n] * u[n]
            sum_ud += u[n] * off
    spread = count * sum_uu - sum_u * sum_u
    turn = (count * sum_ud - sum_u * sum_d) / spread if spread > 0 else 0.0
    shift = (sum_d - turn * sum_u) / max(count, 1)
    return count, high - low, (slope + turn, offset + shift)


def _simplified(sides: list[Line]) -> list[Line]:
    """Fewer sides: pieces of one wall joined, notches in it and corners that the image cut off undone."""
    changed = True
    while changed and len(sides) > 3:
        changed = False
        for i in range(len(sides)):
            merged = _merged_ahead(sides[i:] + sides[:i])
            if merged is not None and len(merged) >= 3:
                sides, changed = merged, True
                break
    return sides


def _merged_ahead(sides: list[Line]) -> list[Line] | None:
    """The sides with the first one joined to one of the next, or with a cut-off corner after it restored."""
    first, second, third = sides[:3]
    if _same_line(first, second):
        return [_joined(first, second), *sides[2:]]
    if not second.wall and second.length < 0.7 and _is_cut_corner(first, second, third):
        return [first, *sides[2:]]
    for skip in range(1, min(NOTCH_SIDES + 1, len(sides) - 2)):
        beyond = sides[1 + skip]
        if first.wall and _same_line(first, beyond) and _is_notch(first, sides[1 : 1 + skip], beyond):
            return [_joined(first, beyond), *sides[2 + skip :]]
    return None


def _is_notch(before: Line, between: list[Line], after: Line) -> bool:
    """Whether the sides between two pieces of one wall are a small dent: a pipe, the edge of a curtain, noise."""
    depth = max((abs(float(before.distance(side.end))) for side in between[:-1]), default=0.0)
    return depth < NOTCH_DEPTH and float(np.linalg.norm(after.start - before.end)) < NOTCH_WIDTH


def _same_line(a: Line, b: Line) -> bool:
    offset = max(abs(a.distance((b.start + b.end) / 2)), abs(b.distance((a.start + a.end) / 2)))
    return a.wall == b.wall and abs(a.angle_to(b)) < np.deg2rad(10) and bool(offset < 0.05)


def _joined(a: Line, b: Line) -> Line:
    ruler = a if a.length >= b.length else b
    return Line(ruler.foot(a.start), ruler.foot(b.end), a.wall)


def _is_cut_corner(before: Line, side: Line, after: Line) -> bool:
    """Whether two walls meet near a short side between them, so that it is only the corner cut off."""
    if not (before.wall and after.wall):
        return False
    if abs(np.sin(before.angle_to(after))) < np.sin(np.deg2rad(15)):
        return before.angle_to(after) < 0.5 and bool(abs(before.distance(after.start)) < 0.05)
    corner = before.meets(after)
    return float(np.linalg.norm(corner - (side.start + side.end) / 2)) < 0.6


def _assemble(sides: list[Line], fallback: Vector) -> tuple[Polygon, NDArray[np.float64]]:
    """Polygon through the meeting points of neighbouring sides; the unrefined corners if that is no polygon."""
    corners: list[Vector] = []
    spans: list[list[int]] = [[0, 0] for _ in sides]
    for i, (side, after) in enumerate(zip(sides, sides[1:] + sides[:1], strict=True)):
        spans[i][1] = len(corners)
        corners += _joint(side, after)
        spans[(i + 1) % len(sides)][0] = len(corners) - 1
    ring = np.array(corners)
    walls = [[*ring[first], *ring[last]] for side, (first, last) in zip(sides, spans, strict=True) if side.wall]
    return _untangled(ring, fallback), np.array(walls, float).reshape(-1, 4)


def _untangled(ring: Vector, fallback: Vector) -> Polygon:
    """The ring, or the largest loop of one that crosses itself; ``fallback`` if too little of the area is left."""
    if len(ring) < 3:
        return fallback
    polygon = shapely.Polygon(ring)
    if not polygon.is_valid:
        polygon = max(shapely.get_parts(polygon.buffer(0)), key=lambda part: part.area, default=shapely.Polygon())
    if abs(polygon.area - shapely.Polygon(fallback).area) > 0.3 * polygon.area + 1.0:
        return fallback
    return np.asarray(shapely.geometry.polygon.orient(polygon).exterior.coords)[:-1]


def _joint(side: Line, after: Line) -> list[Vector]:
    """The corner where two sides meet, or a short step between nearly parallel ones."""
    if abs(np.sin(side.angle_to(after))) > np.sin(np.deg2rad(15)):
        corner = side.meets(after)
        if np.linalg.norm(corner - (side.end + after.start) / 2) < 0.8:
            return [corner]
    middle = (side.end + after.start) / 2
    return [side.foot(middle), after.foot(middle)]
