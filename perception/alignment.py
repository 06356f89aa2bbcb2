"""How the scanner stood: tilt, height, ceiling and wall direction from one cloud (paper section 3.1)."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from perception import transforms
from perception.failure import FailureError
from perception.findings import Alignment
from perception.segmentation import Interval, histogram, one_per_voxel, significant_levels

TILT_LIMIT = np.deg2rad(6.0)
"""Largest roll and pitch looked for, radians."""
HEIGHTS = (1.1, 1.5)
"""Where the optical centre may be above the floor, metres: it is mounted at 1.3 m. Desks and ground lie elsewhere."""
_STAGES = ((1.0, 0.08, 4), (0.25, 0.03, 2), (0.05, 0.015, 1))
"""(step in degrees, bin in metres, hills kept), coarse to fine; each searches 1.5 steps of the one before."""
RANGE_ERROR = 0.01
"""Largest constant error of the ranges that is believed, metres."""
_SECTORS = 36
_NEAR = 5.0


def align(
    points: NDArray[np.floating],
    tilt_limit: float = TILT_LIMIT,
    scanner_heights: tuple[float, float] = HEIGHTS,
) -> Alignment:
    """Level one scan: brute force over roll and pitch by the highest maximum of the Z-histogram (section 3.1).

    The cloud is first thinned to one point per 5 cm cube, so that a peak's height is the area of a level and not its
    nearness to the scanner. The angles found by brute force are finished by a robust fit of parallel planes, one to
    each of the floor and the ceiling, with a constant error of the ranges as a further unknown.

    Args:
        points: ``(N, 3)``, metres, scanner frame, finite.
        tilt_limit: largest roll and pitch, radians.
        scanner_heights: smallest and largest height of the scanner above the floor, metres.

    Returns:
        The alignment; ``ceiling_z`` is nan under the open sky.

    Raises:
        FailureError: ``ALIGN_NO_FLOOR`` if no level below the scanner can be a floor; ``SCAN_TILT`` if the best tilt
            lies beyond ``tilt_limit``.
    """
    sample = points[one_per_voxel(points, 0.05)].astype(float) if len(points) else np.empty((0, 3))
    if len(sample) < 100:
        raise FailureError("ALIGN_NO_FLOOR", f"{len(sample)} points are too few to find a floor", points=len(sample))
    roll, pitch = _brute_force(sample, tilt_limit)
    normal = _vertical(roll, pitch)
    floor, ceiling = _floor(sample, normal, scanner_heights), _ceiling(sample @ normal)
    normal, range_error = _fit_normal(sample, normal, [level for level in (floor, ceiling) if level])
    sample *= 1.0 - range_error / np.linalg.norm(sample, axis=1, keepdims=True)
    roll, pitch = float(np.arctan2(normal[1], normal[2])), float(np.arcsin(-normal[0]))
    if max(abs(roll), abs(pitch)) > tilt_limit:
        tilt = float(np.rad2deg(np.arccos(normal[2])))
        raise FailureError("SCAN_TILT", f"the scanner is tilted by {tilt:.1f} degrees", tilt_deg=tilt)
    heights = sample @ normal
    floor_z = _centre(heights, floor)
    level = transforms.from_euler(roll, pitch, 0.0, (0.0, 0.0, -floor_z))
    levelled = sample @ level[:3, :3].T + level[:3, 3]
    ceiling_z = _centre(heights, ceiling) - floor_z if ceiling else float("nan")
    peak_share = float(histogram(heights).counts.max() / len(heights))
    return Alignment(level, roll, pitch, -floor_z, ceiling_z, wall_direction(levelled), peak_share)


def wall_direction(levelled: NDArray[np.floating]) -> float:
    """Direction of the dominant walls in [-pi/4, pi/4): the yaw that makes the X- and Y-histograms sharpest.

    The extension of section 3.1 to rectangular rooms. ``levelled`` is ``(N, 3)``, floor at z = 0, about evenly dense.
    Sums of squares replace the highest maximum because several walls of a room should have their say; a fit of
    parallel lines to the walls found finishes it.
    """
    xy = levelled[(levelled[:, 2] > 0.2) & (np.abs(levelled[:, :2]).max(axis=1) < 20.0), :2]
    if len(xy) < 100:
        return 0.0
    xy, few = _some(xy, 60_000), _some(xy, 15_000)
    best, reach = 0.0, np.pi / 4
    for step, width in ((1.0, 0.10), (0.25, 0.05), (0.05, 0.02)):
        angles = best + np.arange(-reach, reach + 1e-9, np.deg2rad(step))
        best = float(angles[np.argmax([_sharpness(few, angle, width) for angle in angles])])
        reach = np.deg2rad(step)
    best = _fit_direction(xy, best)
    return float((best + np.pi / 4) % (np.pi / 2) - np.pi / 4)


def _turned(xy: NDArray[np.floating], yaw: float) -> NDArray[np.floating]:
    cos, sin = np.cos(yaw), np.sin(yaw)
    return xy @ np.array([[cos, -sin], [sin, cos]])


def _sharpness(xy: NDArray[np.floating], yaw: float, width: float) -> float:
    return float(sum(np.square(histogram(axis, width).counts).sum() for axis in _turned(xy, yaw).T))


def _fit_direction(xy: NDArray[np.floating], yaw: float) -> float:
    """Slope common to the lines of all walls near ``yaw``, by least squares with a shrinking tolerance."""
    walls = [_strongest_lines(axis) for axis in _turned(xy, yaw).T]
    for tolerance in (0.04, 0.02, 0.01, 0.01):
        turned = _turned(xy, yaw)
        top = bottom = 0.0
        for across, sign in ((0, -1.0), (1, 1.0)):
            for i, line in enumerate(walls[across]):
                near = turned[np.abs(turned[:, across] - line) < tolerance]
                if len(near) < 20:
                    continue
                walls[across][i] = float(np.median(near[:, across]))
                along, offset = near[:, 1 - across] - near[:, 1 - across].mean(), near[:, across]
                top += sign * float(along @ (offset - offset.mean()))
                bottom += float(along @ along)
        yaw += top / bottom if bottom else 0.0
    return yaw


def _strongest_lines(offsets: NDArray[np.floating], most: int = 4) -> list[float]:
    levels = significant_levels(histogram(offsets), share=0.3)
    return [level.peak for level in sorted(levels, key=lambda level: -level.count)[:most]]


def _vertical(roll: float, pitch: float) -> NDArray[np.float64]:
    """Up, in the scanner's frame."""
    return transforms.from_euler(roll, pitch, 0.0)[2, :3]


def _brute_force(sample: NDArray[np.floating], tilt_limit: float) -> tuple[float, float]:
    """Roll and pitch of the highest maximum; several hills are climbed, for a coarse bin blurs steps into slopes."""
    near = sample[np.hypot(sample[:, 0], sample[:, 1]) < 15.0]
    near = _some(near if len(near) else sample, 10_000)
    hills, reach = np.zeros((1, 2)), tilt_limit
    for step_degrees, width, keep in _STAGES:
        step = np.deg2rad(step_degrees)
        offsets = np.arange(-np.ceil(reach / step), np.ceil(reach / step) + 1) * step
        found = [_climb(near, hill, offsets, width, keep) for hill in hills]
        angles, scores = (np.concatenate(parts) for parts in zip(*found, strict=True))
        hills, reach = angles[np.argsort(-scores, kind="stable")[:keep]], 1.5 * step
    return float(hills[0, 0]), float(hills[0, 1])


def _climb(
    points: NDArray[np.floating], centre: NDArray[np.floating], offsets: NDArray[np.floating], width: float, keep: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The ``keep`` best local maxima ``(K, 2)`` of the score on a square of angles, and their scores."""
    rolls, pitches = np.meshgrid(centre[0] + offsets, centre[1] + offsets)
    angles = np.stack([rolls.ravel(), pitches.ravel()], axis=1)
    heights = np.stack([_vertical(*pair) for pair in angles]) @ points.T
    scores = np.array([_highest_maximum(row, width) for row in heights]).reshape(rolls.shape)
    summits = np.flatnonzero(scores == maximum_filter(scores, 3))
    best = summits[np.argsort(-scores.ravel()[summits], kind="stable")[:keep]]
    return angles[best], scores.ravel()[best]


def _some(points: NDArray[np.floating], limit: int) -> NDArray[np.floating]:
    """At most ``limit`` points, evenly taken from the whole; voxel order makes neighbours neighbours in space."""
    return points[:: max(1, len(points) // limit)]


def _highest_maximum(heights: NDArray[np.floating], width: float) -> float:
    counts = histogram(heights, width).counts
    # Two bins together: a plane that lies on their border must not lose to one that does not.
    return float((counts[1:] + counts[:-1]).max())


def _floor(sample: NDArray[np.floating], normal: NDArray[np.floating], heights: tuple[float, float]) -> Interval:
    """The level the robot stands on: of those below the scanner, the lowest one that is seen all around it.

    A table top can be larger than the floor left between the tables, and the ground outside a window can be lower;
    but neither is seen in most directions nearby.
    """
    z, distance = sample @ normal, np.hypot(sample[:, 0], sample[:, 1])
    below = (z < -heights[0]) & (z > -heights[1]) & (distance < _NEAR)
    levels = significant_levels(histogram(z[below]), share=0.08, prominence=1.5)
    sector = np.floor((np.arctan2(sample[:, 1], sample[:, 0]) / (2 * np.pi) % 1.0) * _SECTORS).astype(int)
    around = [len(np.unique(sector[below & level.contains(z)])) for level in levels]
    if not around or max(around) < 3:
        raise FailureError(
            "ALIGN_NO_FLOOR",
            f"no level between {heights[0]} and {heights[1]} m below the scanner is seen in three directions",
            levels=[-level.peak for level in levels],
            sectors=around,
        )
    return next(level for level, seen in zip(levels, around, strict=True) if seen >= 0.5 * max(around))


def _ceiling(z: NDArray[np.floating]) -> Interval | None:
    """The highest wide level above the scanner, if any stands out of the walls; a lowered part may be the wider."""
    above = z[(z > 0.5) & (z < 15.0)]
    levels = significant_levels(histogram(above), share=0.3, prominence=4.0)
    return levels[-1] if levels and levels[-1].count > 0.01 * len(z) else None


def _fit_normal(
    sample: NDArray[np.floating], normal: NDArray[np.floating], levels: list[Interval]
) -> tuple[NDArray[np.float64], float]:
    """Common normal of parallel planes, one per level, and the constant error of the ranges that bends them.

    Least squares with a shrinking tolerance. A range that is long by c lowers the floor and lifts the ceiling by
    c sin(elevation), so the two tell c from a tilt.
    """
    sine = sample[:, 2] / np.linalg.norm(sample, axis=1)
    z, error = sample @ normal, 0.0
    member = [np.abs(z - level.peak) < 0.10 for level in levels]
    for tolerance in (0.05, 0.02, 0.01, 0.01):
        blocks = [np.column_stack([sample[m, :2], sine[m], sample[m, 2]]) for m in member if m.sum() >= 10]
        if not blocks:
            break
        centred = np.concatenate([block - block.mean(axis=0) for block in blocks])
        slope_x, slope_y, error = np.linalg.lstsq(centred[:, :3], centred[:, 3], rcond=None)[0]
        error = float(np.clip(error, -RANGE_ERROR, RANGE_ERROR))
        normal = np.array([-slope_x, -slope_y, 1.0]) / np.sqrt(1.0 + slope_x**2 + slope_y**2)
        z = sample @ normal - error * sine
        member = [np.abs(z - np.median(z[m])) < tolerance for m in member if m.any()]
    return np.asarray(normal, float), error


def _centre(heights: NDArray[np.floating], level: Interval) -> float:
    near = heights[np.abs(heights - level.peak) < 0.06]
    middle = np.median(near) if len(near) else level.peak
    return float(np.mean(near[np.abs(near - middle) < 0.015])) if len(near) else float(middle)
