"""Where the scanner stood, for a cloud that does not say: merged, or moved to the frame of a building.

A scanner sees one surface in each direction, so a cloud whose points lie behind one another was not taken from its
origin. What it was taken from shows in the floor: a scanner on legs does not see the ground around its foot, and leaves
a round hole in it with the floor all around.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt, maximum_filter, uniform_filter

from perception.failure import FailureError
from perception.segmentation import histogram, one_per_voxel, significant_levels

MOST_HIDDEN = 0.3
"""Share of points behind others from which on the origin is no station; scans of real rooms have up to 0.16."""
BLIND_ANGLES = (np.deg2rad(60.0), np.deg2rad(40.0))
"""How far down scanners look, the commonest first."""
HEIGHTS = (0.8, 2.2)
"""Where an optical centre may be above the floor, metres."""
_COARSE = (np.deg2rad(1.0), 1.25)
_FINE = (np.deg2rad(0.5), 1.1)
"""Side of a cell of directions, radians, and how many times further than the nearest point in it is behind it.
Cells are wider than the steps of nearly every scanner, so that none lets through what it hides."""
_SAMPLE = 300_000
_CELL = 0.025
_RADII = (0.3, 3.0)
_SECTORS = 72
_SURROUNDED = 0.85
_PILLAR = 0.6
_WIDEST = 200.0
_DENSITIES = (0.0, 0.3, 0.5, 0.7, 0.85)


def taken_from_origin(points: NDArray[np.floating]) -> bool:
    """Whether the origin can be where points ``(N, 3)`` were taken from: in their midst, and few behind others."""
    margin = 1.0
    inside = np.all((points.min(axis=0) < margin) & (points.max(axis=0) > -margin))
    if not inside:
        return False
    chosen = np.random.default_rng(0).permutation(len(points))[:_SAMPLE]
    return bool(np.mean(_hidden(points[chosen], *_COARSE)) < MOST_HIDDEN)


def find_stations(points: NDArray[np.floating]) -> NDArray[np.float64]:
    """Optical centres ``(S, 3)`` of the scanners that a levelled cloud ``(N, 3)`` was taken by, its own frame, metres.

    Each is over the middle of a round hole in the lowest wide level. The height is the hole's radius times the tangent
    of the commonest blind angle that puts it at a plausible height: good to a decimetre, for nothing tells it better.

    Raises:
        FailureError: ``ORIGIN_UNKNOWN`` if there is no such hole.
    """
    floor_z = _lowest_level(points)
    floor = points[np.abs(points[:, 2] - floor_z) < 0.05, :2]
    low = points[(points[:, 2] > floor_z + 0.3) & (points[:, 2] < floor_z + 1.0), :2]
    found = [(*centre, floor_z + _height(radius)) for centre, radius in _round_holes(floor, low)]
    if not found:
        raise FailureError(
            "ORIGIN_UNKNOWN",
            "the cloud was not taken from its origin, and no blind disc in its floor shows where the scanner stood",
            floor_z=floor_z,
        )
    return np.array(found, np.float64)


def seen_from(points: NDArray[np.floating], station: NDArray[np.floating]) -> NDArray[np.float64]:
    """Of a cloud, the points ``(M, 3)`` that nothing hides from a station, with the station as their origin."""
    moved = points.astype(np.float64) - station
    moved = moved[moved.any(axis=1)]
    return np.asarray(moved[~_hidden(moved, *_FINE)], np.float64)


def _hidden(points: NDArray[np.floating], step: float, times: float) -> NDArray[np.bool_]:
    """Points at least so many times further from the origin than the nearest one in their direction."""
    ranges = np.linalg.norm(points, axis=1)
    azimuth = np.floor((np.arctan2(points[:, 1], points[:, 0]) + np.pi) / step).astype(np.int64)
    elevation = np.floor((np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1])) + np.pi) / step)
    _, cell = np.unique(azimuth * 100_000 + elevation.astype(np.int64), return_inverse=True)
    nearest = np.full(int(cell.max(initial=0)) + 1, np.inf)
    np.minimum.at(nearest, cell, ranges)
    return np.asarray(ranges > times * nearest[cell] + 0.1)


def _lowest_level(points: NDArray[np.floating]) -> float:
    z = points[one_per_voxel(points, 0.05), 2].astype(float)
    levels = significant_levels(histogram(z))
    return levels[0].peak if levels else float(z.min())


def _height(radius: float) -> float:
    heights = [radius * float(np.tan(angle)) for angle in BLIND_ANGLES]
    plausible = [height for height in heights if HEIGHTS[0] <= height <= HEIGHTS[1]]
    return plausible[0] if plausible else float(np.clip(heights[0], *HEIGHTS))


def _round_holes(floor: NDArray[np.floating], low: NDArray[np.floating]) -> Iterator[tuple[tuple[float, float], float]]:
    """Centres and radii of the discs that dense floor surrounds, but for pillars, the best surrounded first.

    Another scanner may have filled a disc, but thinly: points are densest right at the rim of a scanner's own. So the
    discs are looked for in what is denser than several levels.
    """
    if len(floor) < _SECTORS or np.ptp(floor, axis=0).max() > _WIDEST:
        return
    start = floor.min(axis=0)
    cells = np.floor((floor - start) / _CELL).astype(np.int64)
    density = np.zeros(cells.max(axis=0) + 1)
    np.add.at(density, tuple(cells.T), 1.0)
    density = uniform_filter(density, 3)
    levels = np.quantile(density[density > 0], _DENSITIES)
    judged = [disc for level in levels for disc in _discs(density > level, start)]
    taken: list[NDArray[np.float64]] = []
    for share, centre, radius in sorted(judged, key=lambda disc: -disc[0]):
        alone = all(np.hypot(*(centre - other)) > radius for other in taken)
        if share >= _SURROUNDED and alone and _around(low, centre, radius) < _PILLAR:
            taken.append(centre)
            yield (float(centre[0]), float(centre[1])), radius


def _discs(dense: NDArray[np.bool_], start: NDArray[np.floating]) -> list[tuple[float, NDArray[np.float64], float]]:
    """Largest discs between the dense cells: share of the directions with a dense cell at the rim, centre, radius."""
    # The border counts as dense, so that a disc does not reach beyond what was looked at.
    clear = distance_transform_edt(~np.pad(dense, 1, constant_values=True))[1:-1, 1:-1] * _CELL
    peaks = np.argwhere((clear == maximum_filter(clear, 21)) & (clear > _RADII[0]) & (clear < _RADII[1]))
    floor = start + (np.argwhere(dense) + 0.5) * _CELL
    discs = [(start + (peak + 0.5) * _CELL, float(clear[tuple(peak)])) for peak in peaks]
    return [(_around(floor, centre, radius), centre, radius) for centre, radius in discs]


def _around(xy: NDArray[np.floating], centre: NDArray[np.floating], radius: float) -> float:
    """Share of the directions from a centre in which some position lies right at a radius."""
    offset = xy - centre
    distance = np.hypot(*offset.T)
    ring = offset[(distance > radius - 2 * _CELL) & (distance < radius + 3 * _CELL)]
    sector = np.floor((np.arctan2(ring[:, 1], ring[:, 0]) + np.pi) / (2 * np.pi) * _SECTORS)
    return len(np.unique(sector)) / _SECTORS
