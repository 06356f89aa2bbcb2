"""What every beam did at a wall: hit it, passed it, was stopped before it, or came back with nothing (section 2)."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from perception import transforms
from perception.findings import RoomShape
from perception.scan import Scan
from perception.transforms import Matrix

CELL = 0.05
"""Side of a cell of the evidence, metres."""

_NEAR_PLANE = 0.05
_BEYOND = 0.15
_JUST_BEHIND, _FAR_ASIDE = 0.02, 0.10
"""A beam along the wall that ends this far behind it, and aside of where it crossed, went through: to a leaf, say."""
_MIN_INCIDENCE = 0.10


class Beam(IntEnum):
    """Fate of a beam at the plane of a wall."""

    SOLID = 0
    OPEN = 1
    OCCLUDED = 2
    NO_RETURN = 3


@dataclass(frozen=True)
class Wall:
    """A vertical rectangle with coordinates u along it, d through it (outwards) and z.

    Args:
        start: (x, y) in the map frame where u = 0.
        along: unit vector (x, y) of u; the room lies on its left.
        length: metres.
        floor_z, ceiling_z: metres, map frame.
    """

    start: NDArray[np.float64]
    along: NDArray[np.float64]
    length: float
    floor_z: float
    ceiling_z: float

    @property
    def outward(self) -> NDArray[np.float64]:
        return np.array([self.along[1], -self.along[0]])

    def moved(self, d: float) -> "Wall":
        """The parallel rectangle ``d`` metres further out."""
        return replace(self, start=self.at(0.0, d))

    @property
    def wall_from_map(self) -> Matrix:
        """4x4 from map coordinates to (u, d, z above the floor)."""
        matrix = np.eye(4)
        matrix[0, :2], matrix[1, :2] = self.along, self.outward
        matrix[:3, 3] = -matrix[:3, :3] @ [self.start[0], self.start[1], self.floor_z]
        return matrix

    def at(self, u: float, d: float = 0.0) -> NDArray[np.float64]:
        """Map position (x, y) of wall coordinates."""
        return self.start + u * self.along + d * self.outward


@dataclass(frozen=True)
class Evidence:
    """Beams counted per cell of a wall: ``(4, nu, nz)`` by :class:`Beam`, cells of ``CELL`` from u = 0, z = floor."""

    counts: NDArray[np.int32]

    @cached_property
    def decided(self) -> NDArray[np.int8]:
        """``(nu, nz)``: SOLID or OPEN as most beams that reached a cell had it, -1 where none did.

        Neither an occluded beam nor a missing return is a test: something nearer than the scanner's minimum range
        also leaves no return.
        """
        solid, passed = self.counts[Beam.SOLID], self.counts[Beam.OPEN]
        return np.where(solid + passed == 0, -1, np.where(passed > solid, Beam.OPEN, Beam.SOLID)).astype(np.int8)

    def share(self, part: tuple[slice, slice], beam: Beam) -> float:
        """Of the cells in a part (u, z slices) that beams tested, the share where most did ``beam``; NaN if none."""
        decided = self.decided[part]
        tested = np.count_nonzero(decided >= 0)
        return float(np.count_nonzero(decided == beam) / tested) if tested else float("nan")

    def echoes(self, part: tuple[slice, slice]) -> float:
        """Share of a part's 4 x 4 blocks that threw back some beam at the plane: a pane does so all over."""
        solid = self.counts[Beam.SOLID][part] > 0
        blocks = [block.any() for row in np.array_split(solid, 4, axis=0) for block in np.array_split(row, 4, axis=1)]
        return float(np.mean(blocks))


def gather(wall: Wall, scans: Sequence[tuple[Scan, Matrix]], ranges: Sequence[NDArray[np.float32]]) -> Evidence:
    """Count what the beams of every scan did at a wall.

    Args:
        scans: each scan with its ``map_from_scanner``.
        ranges: the range image of each (``Scan.range_image``), passed in because many walls share them.
    """
    nu, nz = int(np.ceil(wall.length / CELL)), int(np.ceil((wall.ceiling_z - wall.floor_z) / CELL))
    counts = np.zeros((4, nu, nz), np.int32)
    for (scan, map_from_scanner), image in zip(scans, ranges, strict=True):
        pattern = scan.pattern
        elevation = pattern.elevation_min + np.arange(pattern.rows) * pattern.elevation_step
        azimuth = np.arange(pattern.columns) * pattern.azimuth_step
        _count(
            counts,
            image,
            np.stack([np.cos(elevation), np.sin(elevation)], axis=1),
            np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1),
            wall.wall_from_map @ map_from_scanner,
            pattern.range_min,
        )
    return Evidence(counts)


@njit(cache=True)
def _count(
    counts: NDArray[np.int32],
    image: NDArray[np.float32],
    elevation: NDArray[np.float64],
    azimuth: NDArray[np.float64],
    pose: NDArray[np.float64],
    range_min: float,
) -> None:
    nu, nz = counts.shape[1], counts.shape[2]
    ou, od, oz = pose[0, 3], pose[1, 3], pose[2, 3]
    for column in range(len(azimuth)):
        ca, sa = azimuth[column]
        # Horizontal parts of the beam's direction per unit of cos(elevation): most columns are dismissed here.
        du = pose[0, 0] * ca + pose[0, 1] * sa
        dd = pose[1, 0] * ca + pose[1, 1] * sa
        dz = pose[2, 0] * ca + pose[2, 1] * sa
        if od * dd > 2 * abs(od * pose[1, 2]):
            continue
        for row in range(len(elevation)):
            ce, se = elevation[row]
            through = dd * ce + pose[1, 2] * se
            if abs(through) < _MIN_INCIDENCE or od * through >= 0:
                continue
            distance = -od / through
            u = ou + distance * (du * ce + pose[0, 2] * se)
            z = oz + distance * (dz * ce + pose[2, 2] * se)
            i, k = int(np.floor(u / CELL)), int(np.floor(z / CELL))
            if i < 0 or i >= nu or k < 0 or k >= nz:
                continue
            measured = image[row, column]
            if measured == 0:
                if distance > range_min:
                    counts[3, i, k] += 1
                continue
            beyond = measured - distance
            depth = beyond * abs(through)
            aside = beyond * abs(du * ce + pose[0, 2] * se)
            if depth > _BEYOND or (depth > _JUST_BEHIND and aside > _FAR_ASIDE):
                counts[1, i, k] += 1
            elif depth < -_NEAR_PLANE:
                counts[2, i, k] += 1
            elif depth <= _NEAR_PLANE:
                counts[0, i, k] += 1


def walls_of(shape: RoomShape, points: NDArray[np.float32]) -> list[Wall]:
    """The planes of a room's walls: contour segments on one line joined, then moved onto the points.

    Args:
        points: ``(N, 3)`` of the room and its surroundings, map frame; some 10 cm apart is dense enough.
    """
    # Above the doors a wall is neither hidden by furniture nor outnumbered by shut leaves set back in it.
    bottom = 2.15 if shape.ceiling_z - shape.floor_z > 2.4 else 0.3
    heights = (points[:, 2] > shape.floor_z + bottom) & (points[:, 2] < shape.ceiling_z - 0.05)
    xy = points[heights, :2].astype(np.float64)
    return [_fitted(wall, xy) for wall in _joined(shape) if wall.length > 0.7]


def _joined(shape: RoomShape) -> list[Wall]:
    walls: list[Wall] = []
    for x0, y0, x1, y1 in shape.walls:
        start, end = np.array([x0, y0]), np.array([x1, y1])
        length = float(np.linalg.norm(end - start))
        if length < 0.05:
            continue
        along = (end - start) / length
        for n, other in enumerate(walls):
            offsets = np.stack([start, end]) - other.start
            u, d = offsets @ other.along, offsets @ other.outward
            gap = max(u.min() - other.length, -u.max())
            if other.along @ along > 0.996 and np.abs(d).max() < 0.15 and gap < 1.0:
                low, high = min(0.0, float(u.min())), max(other.length, float(u.max()))
                walls[n] = Wall(other.at(low), other.along, high - low, shape.floor_z, shape.ceiling_z)
                break
        else:
            walls.append(Wall(start, along, length, shape.floor_z, shape.ceiling_z))
    return walls


def _fitted(wall: Wall, xy: NDArray[np.float64]) -> Wall:
    """The wall moved and turned onto its points: the outer significant peak of the d-histogram (section 3.1)."""
    u, d = (xy - wall.start) @ wall.along, (xy - wall.start) @ wall.outward
    near = (np.abs(d) < 0.25) & (u > -0.05) & (u < wall.length + 0.05)
    u, d = u[near], d[near]
    if len(d) < 30:
        return wall
    thin = max(1, len(d) // 5000)
    # A tilted contour smears the peak: the direction is right when the histogram is sharpest.
    bins = np.arange(-0.30, 0.31, 0.02)
    slopes = np.linspace(-0.04, 0.04, 33)
    turned = [np.histogram(d[::thin] - slope * (u[::thin] - wall.length / 2), bins)[0] for slope in slopes]
    sharpest = int(np.argmax([histogram.max() for histogram in turned]))
    slope, histogram = float(slopes[sharpest]), turned[sharpest]
    peaks = np.flatnonzero(histogram >= max(5, 0.5 * histogram.max()))
    middle = float(bins[peaks[-1]]) + 0.01
    for tolerance in (0.05, 0.03, 0.02):
        close = np.abs(d - middle - slope * (u - wall.length / 2)) < tolerance
        if np.count_nonzero(close) < 20 or np.ptp(u[close]) < 0.5:
            break
        slope, middle = np.polyfit(u[close] - wall.length / 2, d[close], 1)
    along = wall.along + slope * wall.outward
    along /= np.linalg.norm(along)
    return Wall(
        wall.at(wall.length / 2, float(middle)) - along * wall.length / 2,
        along,
        wall.length,
        wall.floor_z,
        wall.ceiling_z,
    )


def local_points(wall: Wall, points: NDArray[np.floating]) -> NDArray[np.floating]:
    """Points of the map frame as (u, d, z above the floor)."""
    return transforms.apply(wall.wall_from_map, points)
