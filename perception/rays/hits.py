"""Where the points of a scan lie among voxels, in one compiled pass: hits, and which of them make a voxel solid.

Half of voxel labelling (paper section 4.1); the rules for empty voxels are in :mod:`perception.rays.labelling`.
"""

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

from perception.threads import SHARES
from perception.transforms import Matrix

_BLOCK = 1024
"""Points that are entered at a time, coordinate by coordinate."""

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
