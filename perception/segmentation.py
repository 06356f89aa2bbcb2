"""Floor, ceiling and wall layers as peaks of a one-dimensional histogram (paper section 3.1, Fig. 2a)."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from perception.failure import FailureError

BIN = 0.02
"""Width of a histogram bin, metres."""
SLOPE = 0.05
"""m_min: a flank of a peak ends where the histogram falls by less than this share of the peak per bin."""
LEVEL_SHARE = 0.15
"""A level counts when its peak holds this share of the highest peak on its side."""
PROMINENCE = 2.5
"""A level must stand this many times over the median bin, which walls fill evenly at every height."""


@dataclass(frozen=True)
class Interval:
    """``[low, high]`` around a maximum of a histogram, metres.

    ``peak`` is the mean and ``count`` the content of the maximum's bin and its two neighbours: a plane on the border
    of two bins fills both.
    """

    low: float
    high: float
    peak: float
    count: float = 0.0

    def contains(self, values: NDArray[np.floating], margin: float = 0.0) -> NDArray[np.bool_]:
        return (values >= self.low - margin) & (values <= self.high + margin)


@dataclass(frozen=True)
class Histogram:
    """``h = f(z)``: the counts of bins of equal width, the first one starting at ``start``."""

    counts: NDArray[np.float64]
    start: float
    width: float

    def centre(self, index: float) -> float:
        return self.start + (index + 0.5) * self.width


@dataclass(frozen=True)
class Levels:
    """The horizontal layers of a cloud: the floor, and the ceiling heights from the lowest to the highest."""

    floor: Interval
    ceilings: tuple[Interval, ...]

    @property
    def ceiling(self) -> Interval | None:
        """The widest seen ceiling, or None under the open sky."""
        return max(self.ceilings, key=lambda level: level.count, default=None)


def one_per_voxel(points: NDArray[np.floating], size: float, limit: int = 400_000) -> NDArray[np.intp]:
    """Indices, ascending, of at most one point per cube of ``size`` metres, out of a seeded sample of ``limit`` points.

    A scanner's points crowd around it; after this their number goes with area, so a peak's height is a surface.
    """
    if len(points) > limit:
        # One from each of equal runs of the scan, at a random place: evenly spread, and in order without sorting.
        place = np.arange(limit) + np.random.default_rng(0).random(limit)
        chosen = (place * (len(points) / limit)).astype(np.int64)
    else:
        chosen = np.arange(len(points))
    return chosen[_first_in_cube(points, chosen, size)]


@njit(cache=True)
def _first_in_cube(points: NDArray[np.floating], chosen: NDArray[np.int64], size: float) -> NDArray[np.bool_]:
    """Whether each chosen point is the first in its cube: a table of cubes by hash, probed in line."""
    slots = 16
    while slots < 2 * len(chosen):
        slots *= 2
    taken = np.full(slots, -1, np.int64)
    first = np.zeros(len(chosen), np.bool_)
    for n in range(len(chosen)):
        p = points[chosen[n]]
        key = np.int64(0)
        for axis in range(3):
            key = (key << 21) | (np.int64(np.floor(p[axis] / size)) & 0x1FFFFF)
        slot = (key ^ (key >> 21) * 73856093 ^ (key >> 42) * 19349663) & (slots - 1)
        while taken[slot] != -1 and taken[slot] != key:
            slot = (slot + 1) & (slots - 1)
        first[n] = taken[slot] == -1
        taken[slot] = key
    return first


def histogram(values: NDArray[np.floating], width: float = BIN) -> Histogram:
    """Histogram of ``(N,)`` values; an empty bin is kept on either side so that every peak has two flanks."""
    if len(values) == 0:
        return Histogram(np.zeros(3), 0.0, width)
    counts, first = _binned(np.ascontiguousarray(values, np.float64), width)
    return Histogram(counts, first * width, width)


@njit(cache=True)
def _binned(values: NDArray[np.float64], width: float) -> tuple[NDArray[np.float64], float]:
    """Counts, and the number of the first bin: alignment asks for a thousand histograms a scan."""
    low, high = values[0], values[0]
    for value in values:
        low, high = min(low, value), max(high, value)
    first = np.floor(low / width) - 1
    counts = np.zeros(int(np.floor(high / width) - first) + 2)
    for value in values:
        counts[int(np.floor(value / width) - first)] += 1
    return counts, first


def local_maxima(counts: NDArray[np.floating], reach: int = 3) -> NDArray[np.intp]:
    """Indices of the bins that no other within ``reach`` bins exceeds (the first of equals)."""
    padded = np.pad(counts, reach, constant_values=-1.0)
    windows = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1)
    return np.flatnonzero((windows.argmax(axis=1) == reach) & (counts > 0))


def peak_interval(h: Histogram, index: int, slope: float = SLOPE) -> Interval:
    """Interval ``[z1, z2]`` around the maximum at bin ``index`` (Fig. 2a), the same for floor, ceiling and walls.

    From the maximum outwards, bins belong to the peak while the histogram falls by more than ``slope`` (m_min) as a
    share of the maximum per bin. The top itself may be flat over bins that hold at least half of the maximum, because
    a plane may lie on the border between two bins.
    """
    maximum = h.counts[index]

    def flank(step: int) -> int:
        i = index
        while 0 < i < len(h.counts) - 1:
            following = h.counts[i + step]
            if following < 0.5 * maximum and h.counts[i] - following < slope * maximum:
                break
            i += step
        return i

    low, high = flank(-1), flank(1)
    top = np.arange(max(index - 1, 0), min(index + 2, len(h.counts)))
    count = float(h.counts[top].sum())
    peak = h.centre(float(top @ h.counts[top]) / count) if count else h.centre(index)
    return Interval(h.centre(low) - h.width / 2, h.centre(high) + h.width / 2, peak, count)


def significant_levels(h: Histogram, share: float = LEVEL_SHARE, prominence: float = PROMINENCE) -> list[Interval]:
    """Intervals of the maxima that hold ``share`` of the highest and stand out of the walls, lowest first.

    Neighbouring bins are added for the comparison, for the border between two bins must not decide.
    """
    counts = np.convolve(h.counts, np.ones(3), "same")
    if not counts.any():
        return []
    filled = counts[counts > 0]
    threshold = max(share * counts.max(), prominence * float(np.median(filled)) if len(filled) > 10 else 0.0)
    return [peak_interval(h, _summit(h, i)) for i in local_maxima(counts, reach=4) if counts[i] >= threshold]


def floor_and_ceiling(
    points: NDArray[np.floating], floor_near: float = 0.0, tolerance: float = 0.15, lowest_ceiling: float = 1.9
) -> Levels:
    """Floor and ceiling layers of points ``(N, 3)`` in a levelled frame (map or level), metres.

    Args:
        floor_near: where alignment and registration put the floor; the nearest strong peak within ``tolerance`` is it.
        lowest_ceiling: a level this far over the floor can be a ceiling; below, it is furniture.

    Raises:
        FailureError: ``SEGMENT_NO_FLOOR`` if nothing lies within ``tolerance`` of ``floor_near``.
    """
    z = points[one_per_voxel(points, 0.05), 2].astype(float)
    low = z[np.abs(z - floor_near) <= tolerance]
    if len(low) == 0:
        raise FailureError("SEGMENT_NO_FLOOR", f"no point within {tolerance} m of the floor height {floor_near:.2f} m")
    h = histogram(low)
    floor = peak_interval(h, int(np.argmax(h.counts)))
    high = z[(z > floor.peak + lowest_ceiling) & (z < floor.peak + 15.0)]
    return Levels(floor, tuple(significant_levels(histogram(high))) if _is_covered(len(high), len(low)) else ())


def _is_covered(high: int, low: int) -> bool:
    # Without a ceiling only the tops of walls are left above a man's height.
    return high > 0.02 * low


def _summit(h: Histogram, index: int) -> int:
    first = max(index - 1, 0)
    return first + int(np.argmax(h.counts[first : index + 2]))
