"""What registration does with all points of a scan: the means of its voxels, and the ranges in each direction.

Few passes over five million points; everything after works on some ten thousand.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

REACH = 1000.0
"""Points further away than this in any axis, and non-finite ones, are left out, metres."""

VIEW_ROWS, VIEW_COLUMNS = 180, 360

_FIRST_SLOTS = 1 << 16
_HASH = np.int64(-7046029254386353131)
_CENTRE = np.int64(1 << 20)


@njit(cache=True)
def voxel_means(points: NDArray[np.float32], size: float) -> NDArray[np.float32]:
    """Mean of the points in each voxel that has any, in the order in which the voxels first appear.

    Neighbouring beams mostly share a voxel, and all voxels together fit into the cache: a hash table filled in the
    order of the scan is several times faster than sorting.

    Args:
        points: ``(N, 3)`` float32, metres.
        size: side of a voxel, at least 1 mm.

    Returns:
        ``(M, 3)`` float32.
    """
    # Untouched memory costs nothing, so the arrays may be as long as the scan.
    keys = np.empty(len(points), np.int64)
    sums = np.empty((len(points), 4))
    slots = np.full(_FIRST_SLOTS, -1, np.int32)
    count, index, last = 0, -1, np.int64(-1)
    per_metre = 1.0 / size
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        if not (abs(x) < REACH and abs(y) < REACH and abs(z) < REACH):
            continue
        i = np.int64(np.floor(x * per_metre)) + _CENTRE
        j = np.int64(np.floor(y * per_metre)) + _CENTRE
        k = np.int64(np.floor(z * per_metre)) + _CENTRE
        key = (i << 42) | (j << 21) | k
        if key != last:
            last = key
            slot = _slot_of(key, slots, keys)
            index = slots[slot]
            if index < 0:
                index = count
                slots[slot] = index
                keys[index] = key
                sums[index] = 0.0
                count += 1
                if 2 * count > len(slots):
                    slots = _grown(slots, keys, count)
        sums[index, 0] += x
        sums[index, 1] += y
        sums[index, 2] += z
        sums[index, 3] += 1.0
    means = np.empty((count, 3), np.float32)
    for n in range(count):
        for axis in range(3):
            means[n, axis] = sums[n, axis] / sums[n, 3]
    return means


@njit(cache=True)
def first_of_keys(keys: NDArray[np.int64]) -> NDArray[np.int64]:
    """Index of the first of all equal keys, ascending."""
    slots = np.full(_FIRST_SLOTS, -1, np.int32)
    kept = np.empty(len(keys), np.int64)
    firsts = np.empty(len(keys), np.int64)
    count = 0
    for n in range(len(keys)):
        slot = _slot_of(keys[n], slots, kept)
        if slots[slot] < 0:
            slots[slot] = count
            kept[count], firsts[count] = keys[n], n
            count += 1
            if 2 * count > len(slots):
                slots = _grown(slots, kept, count)
    return firsts[:count].copy()


@njit(cache=True)
def _slot_of(key: np.int64, slots: NDArray[np.int32], keys: NDArray[np.int64]) -> int:
    """The slot that holds a key, or the free one where it belongs."""
    mask = len(slots) - 1
    slot = int(((key * _HASH) >> 32) & mask)
    while slots[slot] >= 0 and keys[slots[slot]] != key:
        slot = (slot + 1) & mask
    return slot


@njit(cache=True)
def _grown(slots: NDArray[np.int32], keys: NDArray[np.int64], count: int) -> NDArray[np.int32]:
    larger = np.full(4 * len(slots), -1, np.int32)
    for index in range(count):
        larger[_slot_of(keys[index], larger, keys)] = index
    return larger


@njit(cache=True)
def view_cells(points: NDArray[np.float32]) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Cell of each point's direction, ``row * VIEW_COLUMNS + column`` by whole degrees, -1 for none; and its range.

    Rows go from straight down to straight up, columns counter-clockwise from +x.
    """
    cells = np.empty(len(points), np.int32)
    ranges = np.empty(len(points), np.float32)
    per_degree = np.float32(180.0 / np.pi)
    for n in range(len(points)):
        x, y, z = points[n, 0], points[n, 1], points[n, 2]
        if not (abs(x) < REACH and abs(y) < REACH and abs(z) < REACH):
            cells[n], ranges[n] = -1, np.inf
            continue
        flat = np.sqrt(x * x + y * y)
        ranges[n] = np.sqrt(flat * flat + z * z)
        row = min(int(np.arctan2(z, flat) * per_degree + np.float32(90.0)), VIEW_ROWS - 1)
        column = int(np.floor(np.arctan2(y, x) * per_degree)) % VIEW_COLUMNS
        cells[n] = row * VIEW_COLUMNS + column
    return cells, ranges


@njit(cache=True)
def ranges_by_cell(
    cells: NDArray[np.int32], ranges: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Ranges grouped by cell (in any order within one), and where each cell's begin: ``(cells + 1,)``."""
    bounds = np.zeros(VIEW_ROWS * VIEW_COLUMNS + 1, np.int64)
    for cell in cells:
        bounds[cell + 1] += cell >= 0
    bounds = np.cumsum(bounds)
    following = bounds[:-1].copy()
    grouped = np.empty(bounds[-1], np.float32)
    for n in range(len(cells)):
        if cells[n] >= 0:
            grouped[following[cells[n]]] = ranges[n]
            following[cells[n]] += 1
    return grouped, bounds


@njit(cache=True)
def least_by_cell(cells: NDArray[np.int32], ranges: NDArray[np.float32]) -> NDArray[np.float32]:
    """The shortest range in each cell, infinite where there is none."""
    least = np.full(VIEW_ROWS * VIEW_COLUMNS, np.inf, np.float32)
    for n in range(len(cells)):
        if cells[n] >= 0:
            least[cells[n]] = min(least[cells[n]], ranges[n])
    return least


@njit(cache=True)
def share_beyond(
    grouped: NDArray[np.float32], bounds: NDArray[np.int64], cells: NDArray[np.int32], limits: NDArray[np.float32]
) -> NDArray[np.float64]:
    """Of the ranges in each of the given cells, the share that exceeds the limit given with it; 0 where none are."""
    share = np.zeros(len(cells))
    for n in range(len(cells)):
        first, last = bounds[cells[n]], bounds[cells[n] + 1]
        beyond = 0
        for m in range(first, last):
            beyond += grouped[m] > limits[n]
        share[n] = beyond / max(last - first, 1)
    return share
