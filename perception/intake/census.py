"""What each point of a scan is, in one pass: five million are judged in less time than one numpy temporary takes."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numba import njit, types
from numpy.typing import NDArray

from perception.scan import BeamPattern


class Kind(IntEnum):
    """What is wrong with a point; the first that holds."""

    GOOD = 0
    STRAY_BEAM = 1
    NOT_FINITE = 2
    TOO_NEAR = 3
    TOO_FAR = 4
    OFF_BEAM = 5
    REPEATED_BEAM = 6


_STRAY, _NOT_FINITE, _NEAR = int(Kind.STRAY_BEAM), int(Kind.NOT_FINITE), int(Kind.TOO_NEAR)
_FAR, _OFF, _REPEATED = int(Kind.TOO_FAR), int(Kind.OFF_BEAM), int(Kind.REPEATED_BEAM)

# Written out so that the kernel is compiled (or its cache read) on import and not while a scan waits; read-only,
# which takes writable arrays too, because a decoded message is neither copied nor writable.
_POINTS, _BEAM = (types.Array(kind, n, "C", readonly=True) for kind, n in ((types.float32, 2), (types.int32, 1)))
_COUNTS, _CORNER, _TABLE = types.int64[::1], types.float64[::1], types.float64[:, ::1]
_RESULT = types.Tuple((types.uint8[::1], _COUNTS, _COUNTS, _COUNTS, _CORNER, _CORNER))

_RANGE_SLACK = 0.1
"""Share by which noise and calibration move ranges at the scanner's limits."""
_SMALLEST_TOLERANCE = np.deg2rad(1.0)


@dataclass(frozen=True)
class Census:
    """The points of one scan by :class:`Kind`.

    Args:
        kind: ``(N,)`` uint8, of each point.
        counts: ``(7,)`` int64, points of each kind.
        rows, columns: int64, good points in each row and in each column of the beam pattern.
        low, high: ``(3,)`` corners of the good points' bounding box, metres.
    """

    kind: NDArray[np.uint8]
    counts: NDArray[np.int64]
    rows: NDArray[np.int64]
    columns: NDArray[np.int64]
    low: NDArray[np.float64]
    high: NDArray[np.float64]


def take_census(points: NDArray[np.float32], beam: NDArray[np.int32], pattern: BeamPattern) -> Census:
    """Judge every point ``(N, 3)`` (scanner frame, metres) by its own figures and by its beam ``(N,)``.

    A point is good when its beam exists and gave no good point before, and when it is finite, within the scanner's
    ranges (a tenth of slack) and within a degree (or two beams) of its beam's direction.
    """
    azimuth = np.arange(pattern.columns) * pattern.azimuth_step
    elevation = pattern.elevation_min + np.arange(pattern.rows) * pattern.elevation_step
    tolerance = max(_SMALLEST_TOLERANCE, 2 * pattern.azimuth_step, 2 * pattern.elevation_step)
    ranges = ((1 - _RANGE_SLACK) * pattern.range_min, (1 + _RANGE_SLACK) * pattern.range_max)
    return Census(
        *_judge(
            np.ascontiguousarray(points, np.float32),
            np.ascontiguousarray(beam, np.int32),
            np.stack([np.cos(azimuth), np.sin(azimuth)], axis=1),
            np.stack([np.cos(elevation), np.sin(elevation)], axis=1),
            *ranges,
            float(np.cos(min(tolerance, np.pi))),
        )
    )


@njit(_RESULT(_POINTS, _BEAM, _TABLE, _TABLE, *[types.float64] * 3), cache=True)
def _judge(points, beam, azimuth, elevation, nearest, furthest, min_cosine):  # type: ignore[no-untyped-def]
    columns = len(azimuth)
    size = columns * len(elevation)
    kind = np.zeros(len(points), np.uint8)
    counts = np.zeros(7, np.int64)
    in_row, in_column = np.zeros(len(elevation), np.int64), np.zeros(columns, np.int64)
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    taken = np.zeros(size, np.bool_)
    for n in range(len(points)):
        b = beam[n]
        x, y, z = np.float64(points[n, 0]), np.float64(points[n, 1]), np.float64(points[n, 2])
        distance = np.sqrt(x * x + y * y + z * z)
        what = 0
        if b < 0 or b >= size:
            what = _STRAY
        elif not np.isfinite(distance):
            what = _NOT_FINITE
        elif distance <= nearest:
            what = _NEAR
        elif distance >= furthest:
            what = _FAR
        else:
            row = b // columns
            column = b - row * columns
            along = elevation[row, 0] * (x * azimuth[column, 0] + y * azimuth[column, 1]) + elevation[row, 1] * z
            if along <= min_cosine * distance:
                what = _OFF
            elif taken[b]:
                what = _REPEATED
            else:
                taken[b] = True
                in_row[row] += 1
                in_column[column] += 1
                low[0], low[1], low[2] = min(low[0], x), min(low[1], y), min(low[2], z)
                high[0], high[1], high[2] = max(high[0], x), max(high[1], y), max(high[2], z)
        kind[n] = what
        counts[what] += 1
    return kind, counts, in_row, in_column, low, high
