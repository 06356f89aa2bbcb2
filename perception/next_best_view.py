"""The next best view (paper section 4.2): from which candidate would the most occluded voxels become visible?"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from perception.failure import FailureError
from perception.findings import Candidate, ViewChoice
from perception.grids import Grid, Label, VoxelSpace
from perception.labelled_map import CandidateField
from perception.rays import ray_walk, visibility
from perception.rays.visibility import Sight, View
from perception.sensor import Sensor

Weight = Literal["all", "surface"]
NOT_EVALUATED = -1
LISTED = 20
"""Views in the choice, at most."""
REFINED = 8
"""Leaders of the coarse round whose neighbours are looked at too."""
COARSE = 1500
"""Cells that the coarse round asks, about."""
_LEVEL = ray_walk.SUBDIVISION // 8


@dataclass(frozen=True)
class Travel:
    """What a view costs: seconds for the scan, metres per second on the way."""

    scan_seconds: float = 45.0
    speed: float = 0.4


@dataclass(frozen=True)
class Ranking:
    """The views of one cycle.

    Args:
        choice: the best views, with the number of candidates.
        gains: the voxels that each candidate would show, NOT_EVALUATED in all pixels that were not counted.
        estimates: the same of every candidate; of those not counted, what a part of the voxels lets expect near them.
        sight: what helps the next cycle, if all candidates were counted.
    """

    choice: ViewChoice
    gains: Grid
    estimates: Grid
    sight: Sight | None


def next_best_view(
    space: VoxelSpace,
    field: CandidateField,
    sensor: Sensor,
    floor_z: float,
    *,
    weight: Weight = "all",
    avoid: Sequence[tuple[float, float, float]] = (),
    travel: Travel | None = None,
    max_rays: int = 30_000_000,
    separation: float = 0.5,
) -> tuple[ViewChoice, Grid]:
    """The choice and the gains of :func:`rank_views` for a cycle that knows of none before it."""
    ranking = rank_views(
        space,
        field,
        sensor,
        floor_z,
        weight=weight,
        avoid=avoid,
        travel=travel,
        max_rays=max_rays,
        separation=separation,
    )
    return ranking.choice, ranking.gains


def rank_views(
    space: VoxelSpace,
    field: CandidateField,
    sensor: Sensor,
    floor_z: float,
    *,
    weight: Weight = "all",
    avoid: Sequence[tuple[float, float, float]] = (),
    travel: Travel | None = None,
    max_rays: int = 30_000_000,
    separation: float = 0.5,
    earlier: Sight | None = None,
) -> Ranking:
    """Rank the candidates by the occluded voxels that a scan there would show.

    A voxel counts when its centre is within the sensor's field of view and range of the optical centre over the
    pixel's centre, and in free sight (:mod:`perception.rays.ray_walk`): occupied voxels and the outside of the room
    block, occluded ones do not, for they may turn out empty. The optical centre is taken at the nearest eighth of a
    voxel, so that scans of one room compare.

    The count is exact. Up to ``max_rays`` pairs of candidate and voxel all candidates are counted; beyond that, in a
    hall, those that seem best by a part of the voxels, so that the best of all may be missed by some hundredths of
    its gain. Ties go to the shorter path, then to the lower row and column.

    Args:
        weight: ``all`` occluded voxels count (the paper), or only those of the ``surface`` of what is unseen.
        avoid: discs (x, y, radius) whose candidates failed of late and are left out.
        travel: rank by gain per second of driving and scanning instead of by gain.
        separation: least distance between two listed views, metres.
        earlier: the sight of an earlier cycle of the room; the same result comes sooner with it.

    Raises:
        FailureError: ``NBV_SENSOR_OUTSIDE`` if the optical centre lies above or below the space.
    """
    cells = np.argwhere(field.mask.data & ~_avoided(field.mask, avoid))
    gains = estimates = np.empty(0, np.int64)
    sight = earlier
    if len(cells):
        counter = _Counter(space, sensor, floor_z, weight, cells, earlier)
        gains, estimates, sight = _count(cells, counter, max_rays)
    counted = gains > NOT_EVALUATED
    best = _best(field, cells[counted], gains[counted], travel, separation)
    return Ranking(
        ViewChoice(best, len(cells)), _drawn(field.mask, cells, gains), _drawn(field.mask, cells, estimates), sight
    )


def surface(space: VoxelSpace) -> NDArray[np.bool_]:
    """Occluded voxels that may hold structure: within two voxels of the room's bounds, or next to seen air."""
    occluded = space.labels == Label.OCCLUDED
    outside = np.pad(space.labels == Label.OUTSIDE, 1, constant_values=True)
    near = np.ones((3, 3, 3), bool)
    bounds = ndimage.binary_dilation(outside, near, iterations=2)[1:-1, 1:-1, 1:-1]
    return occluded & (bounds | ndimage.binary_dilation(space.labels == Label.EMPTY, near))


def _avoided(frame: Grid, avoid: Sequence[tuple[float, float, float]]) -> NDArray[np.bool_]:
    x, y = np.moveaxis(frame.centres_of(np.moveaxis(np.indices(frame.shape), 0, -1)), -1, 0)
    mask = np.zeros(frame.shape, bool)
    for centre_x, centre_y, radius in avoid:
        mask |= np.hypot(x - centre_x, y - centre_y) <= radius
    return mask


class _Counter:
    """Counts, for cells (row, column), the unseen voxels that the sensor would see from above them."""

    def __init__(
        self,
        space: VoxelSpace,
        sensor: Sensor,
        floor_z: float,
        weight: Weight,
        cells: NDArray[np.int64],
        earlier: Sight | None,
    ) -> None:
        level = _LEVEL * round((floor_z + sensor.height - space.origin[2]) / space.size * ray_walk.SUBDIVISION / _LEVEL)
        if not 0 <= level < space.labels.shape[2] * ray_walk.SUBDIVISION:
            raise FailureError("NBV_SENSOR_OUTSIDE", "the scanner would stand above or below the room's voxels")
        scale = ray_walk.SUBDIVISION / space.size
        slopes = _slope(sensor.elevation_min), _slope(sensor.elevation_max)
        self._view = View(level, slopes, (sensor.range_min * scale, sensor.range_max * scale))
        self._space, self._earlier = space, earlier
        unseen = space.labels == Label.OCCLUDED if weight == "all" else surface(space)
        self._unseen = unseen & self._within_reach(cells)
        self.targets = int(np.count_nonzero(self._unseen))

    def exactly(self, cells: NDArray[np.int64]) -> tuple[NDArray[np.int64], Sight | None]:
        """``(K,)`` counts, and what helps the next cycle."""
        return visibility.count(self._space, self._unseen, cells[:, ::-1], self._view, self._earlier)

    def roughly(self, cells: NDArray[np.int64], rays: int) -> NDArray[np.int64]:
        """``(K,)`` counts as they may be expected from as many columns, drawn by lot, as ``rays`` allow."""
        share = rays / max(1, len(cells) * self.targets)
        drawn = self._unseen & (np.random.default_rng(0).random(self._unseen.shape[:2]) < share)[:, :, None]
        counts = visibility.count(self._space, drawn, cells[:, ::-1], self._view)[0]
        return np.rint(counts * (self.targets / max(1, int(np.count_nonzero(drawn))))).astype(np.int64)

    def _within_reach(self, cells: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Voxels that are not walled off from every cell; rays pass corners, so 26 neighbours connect."""
        starts = (cells[:, 1], cells[:, 0], np.full(len(cells), self._view.level // ray_walk.SUBDIVISION))
        passable = (self._space.labels != Label.OCCUPIED) & (self._space.labels != Label.OUTSIDE)
        passable[starts] = True
        part, count = ndimage.label(passable, np.ones((3, 3, 3), bool))
        open_parts = np.zeros(count + 1, bool)
        open_parts[part[starts]] = True
        return open_parts[part]


def _slope(elevation: float) -> float:
    """Tangent of an elevation, infinite at the zenith and the nadir, where the view has no edge."""
    return float(np.tan(elevation)) if abs(elevation) < 0.5 * np.pi - 1e-9 else float(np.copysign(np.inf, elevation))


def _count(
    cells: NDArray[np.int64], counter: _Counter, max_rays: int
) -> tuple[NDArray[np.int64], NDArray[np.int64], Sight | None]:
    """``(K,)`` gains and estimates: of all cells exactly, or of the finalists of two rounds on a lot of columns.

    The first round asks one cell in each block, the second all cells around its best; each has a third of the rays.
    """
    if len(cells) * counter.targets <= max_rays:
        gains, sight = counter.exactly(cells)
        return gains, gains, sight
    rays = max_rays // 3
    stride = max(2, int(np.ceil(np.sqrt(len(cells) / COARSE))))
    _, first, block = np.unique(cells // stride, axis=0, return_index=True, return_inverse=True)
    asked = counter.roughly(cells[first], rays)
    estimates = asked[block.ravel()]
    leaders = cells[first[np.argsort(-asked, kind="stable")[:REFINED]]]
    around = np.flatnonzero(np.abs(cells[:, None] - leaders[None]).max(axis=2).min(axis=1) < stride)
    estimates[around] = counter.roughly(cells[around], rays)
    finalists = around[np.argsort(-estimates[around], kind="stable")[: max(1, rays // counter.targets)]]
    gains = np.full(len(cells), NOT_EVALUATED, np.int64)
    gains[finalists], _ = counter.exactly(cells[finalists])
    estimates[finalists] = gains[finalists]
    return gains, estimates, None


def _drawn(frame: Grid, cells: NDArray[np.int64], counts: NDArray[np.int64]) -> Grid:
    """The counts at their cells, NOT_EVALUATED in all others."""
    drawn = np.full(frame.shape, NOT_EVALUATED, np.int64)
    drawn[tuple(cells.T)] = counts
    return frame.with_data(drawn)


def _best(
    field: CandidateField,
    cells: NDArray[np.int64],
    gain: NDArray[np.int64],
    travel: Travel | None,
    separation: float,
) -> tuple[Candidate, ...]:
    path = field.path_length.data[tuple(cells.T)]
    score = gain if travel is None else gain / (travel.scan_seconds + path / travel.speed)
    ranked = np.lexsort((cells[:, 1], cells[:, 0], path, -score))
    places = field.mask.centres_of(cells)
    return tuple(
        Candidate(float(places[n, 0]), float(places[n, 1]), int(gain[n]), float(path[n]))
        for n in _spread(places, ranked, separation)
    )


def _spread(places: NDArray[np.float64], ranked: NDArray[np.int64], separation: float) -> list[int]:
    """The first of the ranking that keep their distance from those before them, at most LISTED."""
    chosen: list[int] = []
    for n in ranked:
        if all(np.hypot(*(places[n] - places[m])) >= separation for m in chosen):
            chosen.append(int(n))
            if len(chosen) == LISTED:
                break
    return chosen
