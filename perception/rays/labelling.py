"""The compiled inner loops of voxel labelling (paper section 4.1): the two rules for empty voxels.

Both take the labels ``(nx, ny, nz)`` with OCCUPIED already set and return the flat indices of OCCLUDED voxels that the
scan shows to be empty.
"""

from typing import NamedTuple

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from perception.grids import Label
from perception.transforms import Matrix

_OCCLUDED = np.uint8(Label.OCCLUDED)
_OCCUPIED = np.uint8(Label.OCCUPIED)
_SAMPLE = 1.0 / 3.0
"""Beams sampled across a voxel: its centre and this share of its side to either hand (3 x 3)."""
_BUCKET = np.deg2rad(1.0)
"""Side of the direction buckets in which the sphere rule looks for hidden voxels, radians."""


class Seen(NamedTuple):
    """What a scan saw, and from where.

    Args:
        ranges: ``(rows, columns)`` metres, 0 where a beam did not return; rows upwards, columns round by azimuth.
        elevation_min, elevation_step, azimuth_step: radians.
    """

    scanner_from_map: Matrix
    ranges: NDArray[np.float32]
    elevation_min: float
    elevation_step: float
    azimuth_step: float


@njit(cache=True)
def _voxel_from_scanner(
    index: int, ny: int, nz: int, origin: NDArray[np.float64], size: float, scanner_from_map: Matrix
) -> tuple[float, float, float]:
    """Centre of a voxel (flat index) in the scanner's frame."""
    x = origin[0] + (index // (ny * nz) + 0.5) * size
    y = origin[1] + (index // nz % ny + 0.5) * size
    z = origin[2] + (index % nz + 0.5) * size
    m = scanner_from_map
    return (
        m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3],
        m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3],
        m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3],
    )


@njit(cache=True, parallel=True)
def empty_by_range(
    labels: NDArray[np.uint8],
    origin: NDArray[np.float64],
    size: float,
    seen: Seen,
) -> NDArray[np.int64]:
    """Voxels that most of their returned beams went past; beams are sampled 3 x 3 across the voxel.

    Where two or more of the samples end inside, a surface runs through that left no point: a far floor, say, which
    is not empty and still has to be scanned. A single one is noise.
    """
    _, ny, nz = labels.shape
    flat = labels.ravel()
    empty = np.zeros(flat.size, np.bool_)
    for index in prange(flat.size):
        if flat[index] == _OCCLUDED:
            x, y, z = _voxel_from_scanner(index, ny, nz, origin, size, seen.scanner_from_map)
            empty[index] = _seen_through(x, y, z, size, seen)
    return np.flatnonzero(empty)


@njit(cache=True)
def _seen_through(
    x: float,
    y: float,
    z: float,
    size: float,
    seen: Seen,
) -> bool:
    ranges = seen.ranges
    rows, columns = ranges.shape
    across = np.sqrt(x * x + y * y)
    distance = np.sqrt(across * across + z * z)
    row = (np.arctan2(z, across) - seen.elevation_min) / seen.elevation_step
    column = np.arctan2(y, x) / seen.azimuth_step
    row_spread = _SAMPLE * size / (max(distance, size) * seen.elevation_step)
    column_spread = _SAMPLE * size / (max(across, size) * seen.azimuth_step)
    # The scanner's axes need not be the voxel's: the half side is the least it takes to reach the far side.
    far_side = distance + 0.5 * size
    votes, ended = 0, 0
    for u in range(-1, 2):
        r = int(np.rint(row + u * row_spread))
        if r < 0 or r >= rows:
            continue
        for v in range(-1, 2):
            c = int(np.rint(column + v * column_spread))
            measured = ranges[r, c + columns if c < 0 else (c - columns if c >= columns else c)]
            if measured > 0:
                votes += 1 if measured > far_side else -1
                ended += abs(measured - distance) <= 0.5 * size
    return votes > 0 and ended < 2


@njit(cache=True)
def empty_by_spheres(
    labels: NDArray[np.uint8],
    origin: NDArray[np.float64],
    size: float,
    seen: Seen,
) -> NDArray[np.int64]:
    """Voxels towards which the beam returned and that no nearer occupied voxel's sphere hides: exact alpha > beta.

    Occluded voxels are sorted into buckets of direction; each occupied voxel then tests only the buckets that its
    cap of radius alpha touches and that hold a voxel behind it.
    """
    _, ny, nz = labels.shape
    flat = labels.ravel()
    tested, places, bucket = _tested_voxels(labels, origin, size, seen)
    height, width = int(np.ceil(np.pi / _BUCKET)), int(np.ceil(2 * np.pi / _BUCKET))
    tested, places, start, farthest = _sorted_by_bucket(tested, places, bucket, height * width)
    hidden = np.zeros(len(tested), np.bool_)
    for index in range(flat.size):
        if flat[index] != _OCCUPIED:
            continue
        x, y, z = _voxel_from_scanner(index, ny, nz, origin, size, seen.scanner_from_map)
        squared = x * x + y * y + z * z
        if squared <= 0.5 * size * size:
            continue  # the scanner is inside this sphere: the robot's own body
        alpha = np.arcsin(np.sqrt(0.5 * size * size / squared))
        elevation = np.arctan2(z, np.hypot(x, y))
        azimuth = np.arctan2(y, x)
        low, high = elevation - alpha, elevation + alpha
        # A cap that covers a pole spans every azimuth.
        polar = low <= -0.5 * np.pi or high >= 0.5 * np.pi
        reach = np.pi if polar else np.arcsin(min(1.0, np.sin(alpha) / np.cos(elevation)))
        first = max(0, int((low + 0.5 * np.pi) / _BUCKET))
        last = min(height - 1, int((high + 0.5 * np.pi) / _BUCKET))
        left = int(np.floor((azimuth - reach + np.pi) / _BUCKET))
        span = min(width, int(np.floor((azimuth + reach + np.pi) / _BUCKET)) - left + 2)
        for row in range(first, last + 1):
            for step in range(span):
                cell = row * width + (left + step) % width
                if farthest[cell] <= squared:
                    continue
                for b in range(start[cell], start[cell + 1]):
                    if not hidden[b]:
                        hidden[b] = _sphere_hides(x, y, z, squared, places[b], size)
    return tested[~hidden]


@njit(cache=True)
def _sorted_by_bucket(
    tested: NDArray[np.int64], places: NDArray[np.float64], bucket: NDArray[np.int64], buckets: int
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64], NDArray[np.float64]]:
    """Counting sort; also where each bucket starts, and the squared distance of the farthest voxel in each."""
    start = np.zeros(buckets + 1, np.int64)
    for n in range(len(bucket)):
        start[bucket[n] + 1] += 1
    start = np.cumsum(start)
    farthest = np.zeros(buckets)
    fill = start.copy()
    order = np.empty(len(bucket), np.int64)
    for n in range(len(bucket)):
        b = bucket[n]
        order[fill[b]] = n
        fill[b] += 1
        farthest[b] = max(farthest[b], places[n, 0] ** 2 + places[n, 1] ** 2 + places[n, 2] ** 2)
    return tested[order], places[order], start, farthest


@njit(cache=True)
def _sphere_hides(x: float, y: float, z: float, squared: float, b: NDArray[np.float64], size: float) -> bool:
    """Whether the occupied voxel at (x, y, z) hides the one at ``b``: nearer, and alpha > beta."""
    b_squared = b[0] * b[0] + b[1] * b[1] + b[2] * b[2]
    if squared >= b_squared:
        return False
    along = x * b[0] + y * b[1] + z * b[2]
    # alpha > beta, with cos(beta) = along / |A||B| and cos(alpha)^2 = 1 - r^2 / |A|^2, free of roots.
    return along > 0 and along * along > (squared - 0.5 * size * size) * b_squared


@njit(cache=True)
def _tested_voxels(
    labels: NDArray[np.uint8],
    origin: NDArray[np.float64],
    size: float,
    seen: Seen,
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]:
    """Flat index, place (scanner frame) and direction bucket of OCCLUDED voxels towards which the beam returned."""
    _, ny, nz = labels.shape
    ranges = seen.ranges
    rows, columns = ranges.shape
    flat = labels.ravel()
    index_of = np.empty(flat.size, np.int64)
    places = np.empty((flat.size, 3), np.float64)
    bucket = np.empty(flat.size, np.int64)
    width = int(np.ceil(2 * np.pi / _BUCKET))
    count = 0
    for index in range(flat.size):
        if flat[index] != _OCCLUDED:
            continue
        x, y, z = _voxel_from_scanner(index, ny, nz, origin, size, seen.scanner_from_map)
        elevation, azimuth = np.arctan2(z, np.hypot(x, y)), np.arctan2(y, x)
        row = int(np.rint((elevation - seen.elevation_min) / seen.elevation_step))
        if row < 0 or row >= rows or ranges[row, int(np.rint(azimuth / seen.azimuth_step)) % columns] <= 0:
            continue
        index_of[count] = index
        places[count, 0], places[count, 1], places[count, 2] = x, y, z
        bucket[count] = int((elevation + 0.5 * np.pi) / _BUCKET) * width + int((azimuth + np.pi) / _BUCKET) % width
        count += 1
    return index_of[:count], places[:count], bucket[:count]
