"""The next best view (paper section 4.2): from which candidate would the most occluded voxels become visible?"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from perception import ray_walk
from perception.failure import FailureError
from perception.findings import Candidate, ViewChoice
from perception.grids import Grid, Label, VoxelSpace
from perception.labelled_map import CandidateField
from perception.sensor import Sensor

Weight = Literal["all", "surface"]
NOT_EVALUATED = -1
LISTED = 20
"""Views in the choice, at most."""
REFINED = 8
"""Leaders of the coarse count whose neighbours are counted too."""


@dataclass(frozen=True)
class Travel:
    """What a view costs: seconds for the scan, metres per second on the way."""

    scan_seconds: float = 45.0
    speed: float = 0.4


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
    """Rank the candidates by the occluded voxels that a scan there would show.

    A voxel counts when its centre is within the sensor's field of view and range of the optical centre over the
    pixel's centre, and in free sight (:mod:`perception.ray_walk`): occupied voxels and the outside of the room
    block, occluded ones do not, for they may turn out empty.

    The count is exact. Up to ``max_rays`` pairs of candidate and voxel all candidates are counted; beyond that one in
    each block of a coarser lattice, then the neighbours of the best, so that the best of all may be missed. Ties go
    to the shorter path, then to the lower row and column.

    Args:
        weight: ``all`` occluded voxels count (the paper), or only those of the ``surface`` of what is unseen.
        avoid: discs (x, y, radius) whose candidates failed of late and are left out.
        travel: rank by gain per second of driving and scanning instead of by gain.
        separation: least distance between two listed views, metres.

    Raises:
        FailureError: ``NBV_SENSOR_OUTSIDE`` if the optical centre lies above or below the space.

    Returns:
        The best views with the number of candidates, and the gain of each pixel, NOT_EVALUATED where not counted.
    """
    cells = np.argwhere(field.mask.data & ~_avoided(field.mask, avoid))
    gains = np.full(field.mask.shape, NOT_EVALUATED, np.int64)
    if len(cells):
        _count(cells, _Counter(space, sensor, floor_z, weight, cells), gains, max_rays)
    counted = np.argwhere(gains > NOT_EVALUATED)
    path = field.path_length.data[tuple(counted.T)]
    gain = gains[tuple(counted.T)]
    score = gain if travel is None else gain / (travel.scan_seconds + path / travel.speed)
    ranked = np.lexsort((counted[:, 1], counted[:, 0], path, -score))
    places = field.mask.centres_of(counted)
    best = [
        Candidate(float(places[n, 0]), float(places[n, 1]), int(gain[n]), float(path[n]))
        for n in _spread(places, ranked, separation)
    ]
    return ViewChoice(tuple(best), len(cells)), field.mask.with_data(gains)


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
        self, space: VoxelSpace, sensor: Sensor, floor_z: float, weight: Weight, cells: NDArray[np.int64]
    ) -> None:
        self._level = round((floor_z + sensor.height - space.origin[2]) / space.size * ray_walk.SUBDIVISION)
        if not 0 <= self._level < space.labels.shape[2] * ray_walk.SUBDIVISION:
            raise FailureError("NBV_SENSOR_OUTSIDE", "the scanner would stand above or below the room's voxels")
        self._slopes = _slope(sensor.elevation_min), _slope(sensor.elevation_max)
        scale = ray_walk.SUBDIVISION / space.size
        self._ranges = sensor.range_min * scale, sensor.range_max * scale
        self._blocking = (space.labels == Label.OCCUPIED) | (space.labels == Label.OUTSIDE)
        unseen = space.labels == Label.OCCLUDED if weight == "all" else surface(space)
        self.targets = np.argwhere(unseen & self._within_reach(cells))

    def __call__(self, cells: NDArray[np.int64]) -> NDArray[np.int64]:
        centres = cells[:, ::-1] * ray_walk.SUBDIVISION + ray_walk.SUBDIVISION // 2
        places = np.column_stack([centres, np.full(len(cells), self._level)])
        return ray_walk.count_visible(self._blocking, self.targets, places, self._slopes, self._ranges)

    def _within_reach(self, cells: NDArray[np.int64]) -> NDArray[np.bool_]:
        """Voxels that are not walled off from every cell; rays pass corners, so 26 neighbours connect."""
        starts = (cells[:, 1], cells[:, 0], np.full(len(cells), self._level // ray_walk.SUBDIVISION))
        passable = ~self._blocking
        passable[starts] = True
        part, count = ndimage.label(passable, np.ones((3, 3, 3), bool))
        open_parts = np.zeros(count + 1, bool)
        open_parts[part[starts]] = True
        return open_parts[part]


def _slope(elevation: float) -> float:
    """Tangent of an elevation, infinite at the zenith and the nadir, where the view has no edge."""
    return float(np.tan(elevation)) if abs(elevation) < 0.5 * np.pi - 1e-9 else float(np.copysign(np.inf, elevation))


def _count(cells: NDArray[np.int64], counter: _Counter, gains: NDArray[np.int64], max_rays: int) -> None:
    """Fill in the gains of all cells, or where that is too much of one in each block and all around the best."""
    stride = max(1, int(np.ceil(np.sqrt(len(cells) * len(counter.targets) / max_rays))))
    _, first = np.unique(cells // stride, axis=0, return_index=True)
    gains[tuple(cells[first].T)] = counter(cells[first])
    if stride > 1:
        coarse = gains[tuple(cells.T)]
        leaders = cells[np.argsort(-coarse, kind="stable")[:REFINED]]
        apart = np.abs(cells[:, None] - leaders[None]).max(axis=2).min(axis=1)
        around = cells[(apart < stride) & (coarse == NOT_EVALUATED)]
        gains[tuple(around.T)] = counter(around)


def _spread(places: NDArray[np.float64], ranked: NDArray[np.int64], separation: float) -> list[int]:
    """The first of the ranking that keep their distance from those before them, at most LISTED."""
    chosen: list[int] = []
    for n in ranked:
        if all(np.hypot(*(places[n] - places[m])) >= separation for m in chosen):
            chosen.append(int(n))
            if len(chosen) == LISTED:
                break
    return chosen
