"""The one definition of a free line of sight between a place and a voxel, exact in integers.

A voxel is seen from a place when the open segment from the place to the voxel's centre crosses the inside of no
blocking voxel, but for the two at its ends. Through an edge or corner the segment goes straight to the voxel beyond:
it only touches those beside it. So visibility depends neither on the direction of the walk nor on the axes.

Places are given in units of 1 / SUBDIVISION of a voxel's side from the lower corner of voxel [0, 0, 0], and do not lie
on a voxel's side face. Products of three differences must fit in 64 bits, which holds up to 2,000 voxels a side.

:func:`is_clear` walks one ray. :func:`look` walks all rays to a column of voxels at once, in plan: they cross the same
columns, and where none of the heights that they span is blocked, one look settles all of them. Columns are words of
bits then, one for each layer.
"""

import numpy as np
from numba import njit, prange
from numpy.typing import NDArray

import perception.threads  # noqa: F401

SUBDIVISION = 64
_HALF = SUBDIVISION // 2
_NEVER = 2**62
MAX_LAYERS = 62
"""Layers that fit into the bits of a signed word."""


@njit(cache=True)
def is_clear(blocking: NDArray[np.bool_], i: int, j: int, k: int, x: int, y: int, z: int) -> bool:
    """Whether the centre of voxel (i, j, k) is in free sight of the place (x, y, z), through ``(nx, ny, nz)``.

    The walk starts at the voxel, because a hidden voxel mostly lies close behind what hides it.
    """
    dx, dy, dz = x - (SUBDIVISION * i + _HALF), y - (SUBDIVISION * j + _HALF), z - (SUBDIVISION * k + _HALF)
    step_i, step_j, step_k = (1 if dx > 0 else -1), (1 if dy > 0 else -1), (1 if dz > 0 else -1)
    ax, ay, az = max(abs(dx), 1), max(abs(dy), 1), max(abs(dz), 1)
    # Times at which the walk crosses the next face along each axis, all multiplied by ax ay az to stay whole.
    next_x = _HALF * ay * az if dx != 0 else _NEVER
    next_y = _HALF * ax * az if dy != 0 else _NEVER
    next_z = _HALF * ax * ay if dz != 0 else _NEVER
    end_i, end_j, end_k = x // SUBDIVISION, y // SUBDIVISION, z // SUBDIVISION
    while i != end_i or j != end_j or k != end_k:
        soonest = min(next_x, next_y, next_z)
        if next_x == soonest:
            i += step_i
            next_x += SUBDIVISION * ay * az
        if next_y == soonest:
            j += step_j
            next_y += SUBDIVISION * ax * az
        if next_z == soonest:
            k += step_k
            next_z += SUBDIVISION * ax * ay
        if blocking[i, j, k] and (i != end_i or j != end_j or k != end_k):
            return False
    return True


@njit(cache=True)
def count_visible(
    blocking: NDArray[np.bool_],
    targets: NDArray[np.int64],
    places: NDArray[np.int64],
    slopes: tuple[float, float],
    ranges: tuple[float, float],
) -> NDArray[np.int64]:
    """``(K,)``: how many target voxels ``(U, 3)`` each place ``(K, 3)`` sees in field of view and range, ray by ray.

    Args:
        blocking: ``(nx, ny, nz)``, any number of layers.
        slopes: tangents of the least and greatest elevation, infinite for a view without that edge.
        ranges: least and greatest range, in the units of the places.
    """
    seen = np.zeros(len(places), np.int64)
    for n in range(len(places)):
        x, y, z = places[n]
        for i, j, k in targets:
            if _in_view(i, j, k, x, y, z, slopes, ranges):
                seen[n] += is_clear(blocking, i, j, k, x, y, z)
    return seen


@njit(cache=True, parallel=True)
def look(
    walls: NDArray[np.int64],
    outside: NDArray[np.int64],
    columns: NDArray[np.int64],
    sight: NDArray[np.int64],
    places: NDArray[np.int64],
    slopes: tuple[float, float],
    ranges: tuple[float, float],
) -> NDArray[np.int64]:
    """``(K,)``: how many voxels each place ``(K, 3)`` sees within field of view and range.

    Args:
        walls, outside: ``(nx, ny)`` words of the voxels that block: what stands there, and what is not of the room.
        columns: ``(C, 2)``.
        sight: ``(K, C)`` words of the voxels to look for; those out of view or behind a wall are taken out, those
            behind the outside are not counted but stay in, for a room may grow.
        slopes, ranges: as for :func:`count_visible`.
    """
    ny = walls.shape[1]
    flat_walls, flat_outside = walls.ravel(), outside.ravel()
    none_outside = _summed(outside)
    seen = np.zeros(len(places), np.int64)
    for n in prange(len(places)):
        x, y, z = places[n]
        for c in range(len(columns)):
            i, j = columns[c]
            wanted = _viewed(sight[n, c], i, j, x, y, z, slopes, ranges)
            if wanted:
                wanted = _clear_layers(flat_walls, ny, i, j, wanted, x, y, z)
            sight[n, c] = wanted
            if wanted and _any_within(none_outside, i, j, x // SUBDIVISION, y // SUBDIVISION):
                wanted = _clear_layers(flat_outside, ny, i, j, wanted, x, y, z)
            seen[n] += _bit_count(wanted)
    return seen


@njit(cache=True)
def _viewed(
    wanted: int, i: int, j: int, x: int, y: int, z: int, slopes: tuple[float, float], ranges: tuple[float, float]
) -> int:
    """Those of the ``wanted`` layers of a column that are within field of view and range."""
    viewed, rest = 0, wanted
    k = 0
    while rest:
        if rest & 1 and _in_view(i, j, k, x, y, z, slopes, ranges):
            viewed |= 1 << k
        rest >>= 1
        k += 1
    return viewed


@njit(cache=True)
def _summed(words: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number of columns that are not empty below and left of each corner, ``(nx + 1, ny + 1)``."""
    sums = np.zeros((words.shape[0] + 1, words.shape[1] + 1), np.int64)
    for i in range(words.shape[0]):
        for j in range(words.shape[1]):
            sums[i + 1, j + 1] = sums[i, j + 1] + sums[i + 1, j] - sums[i, j] + (words[i, j] != 0)
    return sums


@njit(cache=True)
def _any_within(sums: NDArray[np.int64], i: int, j: int, a: int, b: int) -> bool:
    """Whether a column in the rectangle with the corners (i, j) and (a, b) is not empty."""
    low_i, high_i, low_j, high_j = min(i, a), max(i, a) + 1, min(j, b), max(j, b) + 1
    return sums[high_i, high_j] - sums[low_i, high_j] - sums[high_i, low_j] + sums[low_i, low_j] > 0


@njit(cache=True)
def _in_view(
    i: int, j: int, k: int, x: int, y: int, z: int, slopes: tuple[float, float], ranges: tuple[float, float]
) -> bool:
    dx, dy, dz = SUBDIVISION * i + _HALF - x, SUBDIVISION * j + _HALF - y, SUBDIVISION * k + _HALF - z
    across = dx * dx + dy * dy
    level = np.sqrt(across)
    # An infinite slope times a level of zero is not a number, compares false, and so is in view: as it should be.
    if dz < slopes[0] * level or dz > slopes[1] * level:
        return False
    return ranges[0] * ranges[0] <= across + dz * dz <= ranges[1] * ranges[1]


@njit(cache=True)
def words(mask: NDArray[np.bool_]) -> NDArray[np.int64]:
    """``(nx, ny)``: bit k says whether layer k of the column is in the mask ``(nx, ny, nz)``."""
    nx, ny, nz = mask.shape
    bits = np.zeros((nx, ny), np.int64)
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                if mask[i, j, k]:
                    bits[i, j] |= 1 << k
    return bits


@njit(cache=True)
def _bit_count(bits: int) -> int:
    count = 0
    while bits:
        bits &= bits - 1
        count += 1
    return count


@njit(cache=True)
def _shrunk(bits: int, lowest: int, highest: int) -> tuple[int, int]:
    """The interval of layers without its ends that are not set; some bit within it is."""
    while not (bits >> lowest) & 1:
        lowest += 1
    while not (bits >> highest) & 1:
        highest -= 1
    return lowest, highest


@njit(cache=True)
def _clear_layers(walls: NDArray[np.int64], ny: int, i: int, j: int, wanted: int, x: int, y: int, z: int) -> int:
    """Those of the ``wanted`` layers (bits) of column (i, j) that are in free sight of the place."""
    dx, dy = x - (SUBDIVISION * i + _HALF), y - (SUBDIVISION * j + _HALF)
    step_x, step_y = (ny if dx > 0 else -ny), (1 if dy > 0 else -1)
    ax, ay = max(abs(dx), 1), max(abs(dy), 1)
    # Times are multiplied by ax ay to stay whole; the rays start at 0 in their voxel and arrive at `whole`.
    whole = ax * ay
    next_x = _HALF * ay if dx != 0 else _NEVER
    next_y = _HALF * ax if dy != 0 else _NEVER
    grow_x, grow_y = SUBDIVISION * ay, SUBDIVISION * ax
    start, end = i * ny + j, x // SUBDIVISION * ny + y // SUBDIVISION
    lowest, highest = _shrunk(wanted, 0, MAX_LAYERS)
    here, entered = start, 0
    between = _layers(min(lowest, z // SUBDIVISION), max(highest, z // SUBDIVISION))
    low, low_climb, high, high_climb = _fan(lowest, highest, z, whole)
    while True:
        left = whole if here == end else min(next_x, next_y)
        if walls[here] & between:
            bottom = low + low_climb * (entered if low_climb > 0 else left)
            top = high + high_climb * (left if high_climb > 0 else entered)
            fan = _layers(int(bottom), int(top))
            if walls[here] & fan:
                if walls[here] & fan == fan and here != start and here != end:
                    return 0  # every ray is in one of these layers, and all of them are blocked
                wanted = _unblocked(
                    walls[here], wanted, lowest, highest, z, entered, left, whole, here == start, here == end
                )
                if not wanted:
                    return 0
                lowest, highest = _shrunk(wanted, lowest, highest)
                low, low_climb, high, high_climb = _fan(lowest, highest, z, whole)
        if here == end:
            return wanted
        entered = left
        if next_x == left:
            here += step_x
            next_x += grow_x
        if next_y == left:
            here += step_y
            next_y += grow_y


@njit(cache=True)
def _fan(lowest: int, highest: int, z: int, whole: int) -> tuple[float, float, float, float]:
    """Where the lowest and the highest ray start, in layers, and how much they climb in a unit of time.

    A margin makes up for the rounding, so that all rays are between them at any time.
    """
    level, pace = z / SUBDIVISION, 1.0 / whole
    low, high = lowest + 0.5, highest + 0.5
    return low - 1e-6, (level - low) * pace, high + 1e-6, (level - high) * pace


@njit(cache=True)
def _layers(first: int, last: int) -> int:
    """Bits of the layers from first to last, both included."""
    return ((1 << (last - first + 1)) - 1) << first


@njit(cache=True)
def _unblocked(
    wall: int,
    wanted: int,
    lowest: int,
    highest: int,
    z: int,
    entered: int,
    left: int,
    whole: int,
    at_start: bool,
    at_end: bool,
) -> int:
    """Those of the wanted rays that cross no blocked layer of a column between two times.

    A ray's height at either time, in layers and a rest, is had from that of the ray below it without a division.
    """
    layer = SUBDIVISION * whole
    centre = SUBDIVISION * lowest + _HALF
    comes_at, goes_at = centre * whole + (z - centre) * entered, centre * whole + (z - centre) * left
    comes_in, goes_in = comes_at // layer, goes_at // layer
    comes_over, goes_over = comes_at - comes_in * layer, goes_at - goes_in * layer
    blocking = wall & ~(1 << (z // SUBDIVISION)) if at_end else wall
    for k in range(lowest, highest + 1):
        bit = 1 << k
        if wanted & bit:
            if SUBDIVISION * k + _HALF < z:
                first, last = comes_in, goes_in - (goes_over == 0)
            else:
                first, last = goes_in, comes_in - (comes_over == 0)
            crossed = _layers(first, max(first, last))
            if blocking & (crossed & ~bit if at_start else crossed):
                wanted &= ~bit
        comes_over += SUBDIVISION * (whole - entered)
        if comes_over >= layer:
            comes_over -= layer
            comes_in += 1
        goes_over += SUBDIVISION * (whole - left)
        if goes_over >= layer:
            goes_over -= layer
            goes_in += 1
    return wanted
