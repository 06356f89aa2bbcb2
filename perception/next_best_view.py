"""The next best view (paper section 4.2): from which candidate would the most occluded voxels become visible?"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from perception import ray_walk
from perception.findings import Candidate, ViewChoice
from perception.grids import Grid, Label, VoxelSpace
from perception.labelled_map import CandidateField
from perception.sensor import Sensor

Weight = Literal["all", "surface"]
NOT_EVALUATED = -1
LISTED = 20


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
    max_rays: int = 40_000_000,
    separation: float = 0.5,
) -> tuple[ViewChoice, Grid]:
    """Rank the candidates by the occluded voxels that a scan there would show.

    A voxel counts when its centre is within the sensor's field of view and range of the optical centre over the
    pixel's centre, and in free sight (:mod:`perception.ray_walk`): occupied voxels and the outside of the room
    block, occluded ones do not, for they may turn out empty.

    The count is exact. Up to ``max_rays`` pairs of candidate and voxel all candidates are counted; beyond that those
    on a coarser lattice first, then the neighbours of the best, so that the very best may be missed by a pixel or
    two. Ties go to the shorter path, then to the lower row and column.

    Args:
        weight: ``all`` occluded voxels count (the paper), or only those of the ``surface`` of what is unseen.
        avoid: discs (x, y, radius) whose candidates failed of late and are left out.
        travel: rank by gain per second of driving and scanning instead of by gain.
        separation: least distance between two listed views, metres.

    Returns:
        The best views with the number of candidates, and the gain of each pixel, NOT_EVALUATED where not counted.
    """
    cells = np.argwhere(field.mask.data & ~_avoided(field.mask, avoid))
    gains = np.full(field.mask.shape, NOT_EVALUATED, np.int64)
    if len(cells):
        _count(space, cells, gains, sensor, floor_z, weight, max_rays)
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
    rows, columns = frame.shape
    centres = frame.centres_of(np.stack(np.mgrid[:rows, :columns], axis=-1))
    mask = np.zeros(frame.shape, bool)
    for x, y, radius in avoid:
        mask |= np.hypot(centres[..., 0] - x, centres[..., 1] - y) <= radius
    return mask


def _count(
    space: VoxelSpace,
    cells: NDArray[np.int64],
    gains: NDArray[np.int64],
    sensor: Sensor,
    floor_z: float,
    weight: Weight,
    max_rays: int,
) -> None:
    """Fill in the gains of the cells, all of them or coarse to fine."""
    unseen = space.labels == Label.OCCLUDED if weight == "all" else surface(space)
    blocking = (space.labels == Label.OCCUPIED) | (space.labels == Label.OUTSIDE)
    unseen &= _not_enclosed(blocking, cells, _level(space, sensor, floor_z) // ray_walk.SUBDIVISION)
    targets = np.argwhere(unseen)
    scale = ray_walk.SUBDIVISION / space.size

    def evaluate(chosen: NDArray[np.int64]) -> None:
        places = np.column_stack(
            [
                chosen[:, ::-1] * ray_walk.SUBDIVISION + ray_walk.SUBDIVISION // 2,
                np.full(len(chosen), _level(space, sensor, floor_z)),
            ]
        )
        gains[tuple(chosen.T)] = ray_walk.count_visible(
            blocking,
            targets,
            places,
            np.tan(sensor.elevation_min),
            np.tan(sensor.elevation_max),
            sensor.range_min * scale,
            sensor.range_max * scale,
        )

    stride = 1
    while len(cells) / stride**2 * len(targets) > max_rays:
        stride += 1
    evaluate(cells[np.all(cells % stride == 0, axis=1)])
    if stride > 1:
        _refine(cells, gains, stride, evaluate)
