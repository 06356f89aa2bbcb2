"""Why points do not fit their scanner: the wrong unit, a mirror image, axes by another name, or another pattern."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perception import transforms
from perception.failure import FailureError
from perception.scan import BeamPattern
from perception.transforms import Matrix

_METRES = {"millimetres": 0.001, "centimetres": 0.01, "feet": 0.3048, "kilometres": 1000.0}
"""Of each unit that a cloud may be in by mistake; metres taken for millimetres look like the last."""
_ROOM = (0.5, 30.0)
"""Median range, metres, that makes a unit believable."""
_EXPLAINED = 0.98
"""Share of the points that a cause must put right to be named."""
_AGREEMENT = 0.97
"""Mean cosine between points and beams once turned, from which the turn is the cause."""
_MOUNTED = 0.3
"""Height of the scanner above the base's floor, metres, from which it is believed to be mounted at all."""
_FLOOR_TOLERANCE = 0.05
_FLOOR_SHARE = 0.05
_STEEP = -0.35
"""Sine of the elevation below which a beam in a room mostly meets the floor."""
_BIN = 0.02


@dataclass(frozen=True)
class Misfit:
    """A sample of a scan that does not fit.

    Args:
        points: ``(N, 3)`` finite, scanner frame, in the unit that they came in.
        beams: ``(N,)``.
        outside, off: share of the whole scan's points that are out of range, and off their beams.
    """

    points: NDArray[np.float64]
    beams: NDArray[np.int32]
    outside: float
    off: float


def range_error(found: Misfit, pattern: BeamPattern) -> FailureError:
    """``SCAN_UNITS`` if another unit explains ranges that cannot be, ``SCAN_RANGE`` if none does."""
    ranges = np.linalg.norm(found.points, axis=1)
    return units_error(ranges, (0.9 * pattern.range_min, 1.1 * pattern.range_max)) or FailureError(
        "SCAN_RANGE",
        f"{found.outside:.2%} of the points are nearer than {pattern.range_min:g} m or further than "
        f"{pattern.range_max:g} m, the median range is {np.median(ranges):.4g} m: set the scanner's profile right, or "
        "look for fog, dust and mirrors",
        share=found.outside,
        median_range_m=float(np.median(ranges)),
        ranges_m=[float(pattern.range_min), float(pattern.range_max)],
    )


def units_error(ranges: NDArray[np.float64], possible: tuple[float, float]) -> FailureError | None:
    """``SCAN_UNITS`` if ``(N,)`` ranges, taken for another unit, lie within what is possible (metres) and are those of
    a room."""
    median = float(np.median(ranges))
    if possible[0] < median < possible[1]:
        return None
    for unit, metres in _METRES.items():
        true = metres * ranges
        fits = np.mean((true > possible[0]) & (true < possible[1]))
        if fits > _EXPLAINED and _ROOM[0] < metres * median < _ROOM[1]:
            expected = f"{_ROOM[0]:g} to {_ROOM[1]:g} m"
            return _named(unit, metres, f"the median range is {median:.4g}", expected)
    return None


def beam_error(found: Misfit, pattern: BeamPattern) -> FailureError:
    """``SCAN_MIRRORED`` or ``SCAN_TURNED`` if a mirror or a turn brings points onto beams, else ``SCAN_BEAMS``.

    The orthogonal matrix that brings the beams nearest to the points (Kabsch) has determinant -1 for a mirror image.
    """
    distance = np.linalg.norm(found.points, axis=1)
    seen = found.points[distance > 0] / distance[distance > 0, None]
    fired = pattern.directions(found.beams[distance > 0]).astype(np.float64)
    left, strength, right = np.linalg.svd(seen.T @ fired)
    agreement = float(strength.sum() / max(len(seen), 1))
    points_from_beams = left @ right
    matrix = points_from_beams.round(3).tolist()
    if agreement < _AGREEMENT:
        return FailureError(
            "SCAN_BEAMS",
            f"{found.off:.2%} of the points do not lie where their beams looked, and neither a turn nor a mirror puts "
            f"them there: the scanner was set to another pattern than the {pattern.columns} x {pattern.rows} beams of "
            "its driver",
            share=found.off,
            agreement=agreement,
        )
    if np.linalg.det(points_from_beams) < 0:
        return FailureError(
            "SCAN_MIRRORED",
            f"{found.off:.2%} of the points lie in the mirror image of where their beams looked: x forward, y left, "
            "z up is expected; change the sign of one axis in the driver",
            share=found.off,
            points_from_beams=matrix,
        )
    pose = np.eye(4)
    pose[:3, :3] = points_from_beams
    degrees = float(np.rad2deg(transforms.rotation_angle(pose)))
    return FailureError(
        "SCAN_TURNED",
        f"the cloud is turned by {degrees:.0f} degrees against its beams, expected 0: x forward, y left, z up; check "
        "the order of the axes in the driver",
        share=found.off,
        degrees=degrees,
        points_from_beams=matrix,
    )


def check_floor(points: NDArray[np.float64], base_from_scanner: Matrix) -> None:
    """Refuse a scan whose floor is as many feet (or the like) below the scanner as it is mounted metres above it.

    Feet are still ranges that a scanner can measure; only the one length that is known tells them. Nothing is said
    where anything lies at the mounted height, or where no unit explains what does: alignment will look.

    Args:
        points: ``(N, 3)`` valid points, scanner frame.
        base_from_scanner: the mounting.

    Raises:
        FailureError: ``SCAN_UNITS``.
    """
    mounted = float(base_from_scanner[2, 3])
    down = points[points[:, 2] < _STEEP * np.linalg.norm(points, axis=1)]
    if mounted < _MOUNTED or len(down) == 0:
        return
    depth = -(down @ base_from_scanner[2, :3])
    if np.mean(np.abs(depth - mounted) < 0.25 * mounted) > _FLOOR_SHARE:
        return
    bins = np.floor(depth[depth > 0] / (_BIN * mounted)).astype(np.int64)
    if len(bins) == 0:
        return
    found, count = np.unique(bins, return_counts=True)
    floor = float((found[count.argmax()] + 0.5) * _BIN * mounted)
    for unit, metres in _METRES.items():
        if abs(floor * metres - mounted) < _FLOOR_TOLERANCE * mounted:
            raise _named(unit, metres, f"the floor lies {floor:.4g} below the scanner", f"{mounted:g} m")


def _named(unit: str, metres: float, found: str, expected: str) -> FailureError:
    return FailureError(
        "SCAN_UNITS",
        f"{found}, expected {expected}: these are {unit}; set the scanner's unit to metres",
        unit=unit,
        metres_per_unit=metres,
    )
