"""The compiled inner loops of voxel labelling (paper section 4.1): hits, and the two rules for empty voxels.

Both rules take the labels ``(nx, ny, nz)`` with OCCUPIED already set and return the flat indices of OCCLUDED voxels
that the scan shows to be empty. Ranges are ``(rows, columns)`` in metres, 0 where a beam did not return.
"""

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from perception.grids import Label
from perception.threads import SHARES
from perception.transforms import Matrix

_OCCLUDED = np.uint8(Label.OCCLUDED)
_OCCUPIED = np.uint8(Label.OCCUPIED)
_SAMPLE = 1.0 / 3.0
"""Beams sampled across a voxel: its centre and this share of its side to either hand (3 x 3)."""
_BLOCK = 1024
"""Points that are entered at a time, coordinate by coordinate."""
_BUCKET = np.deg2rad(1.0)
"""Side of the direction buckets in which the sphere rule looks for hidden voxels, radians."""

Shape3 = tuple[int, ...]


def enter(
    points: NDArray[np.float32],
    beam: NDArray[np.int32],
    map_from_scanner: Matrix,
    origin: NDArray[np.float64],
    size: float,
    shape: Shape3,
    beams: tuple[int, int],
) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Points ``(N, 3)`` of the scanner frame per voxel of the space, ``(nx, ny, nz)``, and the range of each beam.

    The ranges, ``beams`` being (rows, columns), are those that :meth:`perception.scan.Scan.range_image` gives; one pass
    over a scan makes both. It reckons in single precision: within some 1e-5 m of a voxel's face a point may be counted
    on its other side.
    """
    # A border of one voxel takes what lies outside.
    hits = np.zeros((SHARES, *(side + 2 for side in shape)), np.int32)
    ranges = np.zeros(beams, np.float32)
    voxels_from_scanner = map_from_scanner[:3] / size
    voxels_from_scanner[:, 3] += 1 - origin / size
    _enter_all(points, beam, voxels_from_scanner.astype(np.float32), hits, ranges.reshape(-1))
    return hits[0, 1:-1, 1:-1, 1:-1], ranges


@njit(cache=True, parallel=True)
def _enter_all(
    points: NDArray[np.float32],
    beam: NDArray[np.int32],
    voxels_from_scanner: NDArray[np.float32],
    hits: NDArray[np.int32],
    ranges: NDArray[np.float32],
) -> None:
    for part in prange(SHARES):
        first, last = len(points) * part // SHARES, len(points) * (part + 1) // SHARES
        _enter(points[first:last], beam[first:last], voxels_from_scanner, hits[part], ranges)
    for part in range(1, SHARES):
        hits[0] += hits[part]


@njit(cache=True)
def _enter(
    points: NDArray[np.float32],
    beam: NDArray[np.int32],
    voxels_from_scanner: NDArray[np.float32],
    hits: NDArray[np.int32],
    ranges: NDArray[np.float32],
) -> None:
    flat = hits.reshape(-1)
    place = np.empty((3, _BLOCK), np.float32)
    measured, voxel = np.empty(_BLOCK, np.float32), np.empty(_BLOCK, np.int32)
    current, count = 0, 0
    for start in range(0, len(points), _BLOCK):
        block = points[start : start + _BLOCK]
        for n in range(len(block)):
            place[0, n], place[1, n], place[2, n] = block[n, 0], block[n, 1], block[n, 2]
        _locate(place, voxels_from_scanner, hits.shape, measured, voxel)
        for n in range(len(block)):
            ranges[beam[start + n]] = measured[n]
            # Neighbours in a scan are neighbours in space: most of them add to a number that is at hand.
            if voxel[n] != current:
                flat[current] += count
                current, count = voxel[n], 0
            count += 1
    flat[current] += count


@njit(cache=True)
def _locate(
    place: NDArray[np.float32],
    m: NDArray[np.float32],
    shape: Shape3,
    measured: NDArray[np.float32],
    voxel: NDArray[np.int32],
) -> None:
    """Range and flat voxel index of places ``(3, n)``: a loop without branches, for wide instructions."""
    layer, row = np.int32(shape[1] * shape[2]), np.int32(shape[2])
    zero = np.float32(0)
    last_i, last_j, last_k = np.float32(shape[0] - 1), np.float32(shape[1] - 1), np.float32(shape[2] - 1)
    for n in range(len(voxel)):
        x, y, z = place[0, n], place[1, n], place[2, n]
        measured[n] = np.sqrt(x * x + y * y + z * z)
        i = min(max(m[0, 0] * x + m[0, 1] * y + m[0, 2] * z + m[0, 3], zero), last_i)
        j = min(max(m[1, 0] * x + m[1, 1] * y + m[1, 2] * z + m[1, 3], zero), last_j)
        k = min(max(m[2, 0] * x + m[2, 1] * y + m[2, 2] * z + m[2, 3], zero), last_k)
        voxel[n] = np.int32(i) * layer + np.int32(j) * row + np.int32(k)


@njit(cache=True)
def solid(hits: NDArray[np.int32], min_points: int) -> NDArray[np.bool_]:
    """Voxels with at least ``min_points``, or with any point and a point in one of the 26 neighbours."""
    nx, ny, nz = hits.shape
    result = np.zeros(hits.shape, np.bool_)
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                if hits[i, j, k] == 0:
                    continue
                result[i, j, k] = hits[i, j, k] >= min_points or _has_company(hits, i, j, k)
    return result


@njit(cache=True)
def _has_company(hits: NDArray[np.int32], i: int, j: int, k: int) -> bool:
    nx, ny, nz = hits.shape
    for a in range(max(0, i - 1), min(nx, i + 2)):
        for b in range(max(0, j - 1), min(ny, j + 2)):
            for c in range(max(0, k - 1), min(nz, k + 2)):
                if hits[a, b, c] > 0 and (a != i or b != j or c != k):
                    return True
    return False


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
    scanner_from_map: Matrix,
    ranges: NDArray[np.float32],
    elevation_min: float,
    elevation_step: float,
    azimuth_step: float,
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
            x, y, z = _voxel_from_scanner(index, ny, nz, origin, size, scanner_from_map)
            empty[index] = _seen_through(x, y, z, size, ranges, elevation_min, elevation_step, azimuth_step)
    return np.flatnonzero(empty)


@njit(cache=True)
def _seen_through(
    x: float,
    y: float,
    z: float,
    size: float,
    ranges: NDArray[np.float32],
    elevation_min: float,
    elevation_step: float,
    azimuth_step: float,
) -> bool:
    rows, columns = ranges.shape
    across = np.sqrt(x * x + y * y)
    distance = np.sqrt(across * across + z * z)
    row = (np.arctan2(z, across) - elevation_min) / elevation_step
    column = np.arctan2(y, x) / azimuth_step
    row_spread = _SAMPLE * size / (max(distance, size) * elevation_step)
    column_spread = _SAMPLE * size / (max(across, size) * azimuth_step)
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
    scanner_from_map: Matrix,
    ranges: NDArray[np.float32],
    elevation_min: float,
    elevation_step: float,
    azimuth_step: float,
) -> NDArray[np.int64]:
    """Voxels towards which the beam returned and that no nearer occupied voxel's sphere hides: exact alpha > beta.

    Occluded voxels are sorted into buckets of direction; each occupied voxel then tests only the buckets that its
    cap of radius alpha touches and that hold a voxel behind it.
    """
    _, ny, nz = labels.shape
    flat = labels.ravel()
    tested, places, bucket = _tested_voxels(
        labels, origin, size, scanner_from_map, ranges, elevation_min, elevation_step, azimuth_step
    )
    height, width = int(np.ceil(np.pi / _BUCKET)), int(np.ceil(2 * np.pi / _BUCKET))
    tested, places, start, farthest = _sorted_by_bucket(tested, places, bucket, height * width)
    hidden = np.zeros(len(tested), np.bool_)
    for index in range(flat.size):
        if flat[index] != _OCCUPIED:
            continue
        x, y, z = _voxel_from_scanner(index, ny, nz, origin, size, scanner_from_map)
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
    scanner_from_map: Matrix,
    ranges: NDArray[np.float32],
    elevation_min: float,
    elevation_step: float,
    azimuth_step: float,
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]:
    """Flat index, place (scanner frame) and direction bucket of OCCLUDED voxels towards which the beam returned."""
    _, ny, nz = labels.shape
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
        x, y, z = _voxel_from_scanner(index, ny, nz, origin, size, scanner_from_map)
        elevation, azimuth = np.arctan2(z, np.hypot(x, y)), np.arctan2(y, x)
        row = int(np.rint((elevation - elevation_min) / elevation_step))
        if row < 0 or row >= rows or ranges[row, int(np.rint(azimuth / azimuth_step)) % columns] <= 0:
            continue
        index_of[count] = index
        places[count, 0], places[count, 1], places[count, 2] = x, y, z
        bucket[count] = int((elevation + 0.5 * np.pi) / _BUCKET) * width + int((azimuth + np.pi) / _BUCKET) % width
        count += 1
    return index_of[:count], places[:count], bucket[:count]
