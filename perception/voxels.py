"""The voxel space V(t) of a room and its labels (paper section 4.1): which parts are structure, air, or not yet seen.

All spaces share one lattice: voxel sides are multiples of ``size`` in x and y, and multiples of ``size`` plus half a
voxel in z, so that a floor at z = 0 runs through the middle of a layer and its noise never fills two.
"""

from typing import Literal

import numpy as np
import shapely
from numpy.typing import NDArray

from perception.failure import FailureError
from perception.findings import LabelCounts, RoomShape
from perception.grids import Label, VoxelSpace
from perception.outline.frontier import seen_and_beyond
from perception.rays.hits import enter, solid
from perception.rays.labelling import Seen, empty_by_range, empty_by_spheres
from perception.scan import Scan
from perception.transforms import Matrix, inverse

Labeller = Literal["range", "paper"]

LATTICE_SHIFT = np.array([0.0, 0.0, 0.5])
SURFACE_NOISE = 0.02
"""Metres by which floor and ceiling points may miss their plane and still belong to the room."""


def room_space(
    shape: RoomShape, size: float = 0.10, previous: VoxelSpace | None = None, margin: float = 0.05
) -> VoxelSpace:
    """The voxels of a room, all OCCLUDED, with the labels of an earlier space carried over.

    A voxel belongs to the room when it touches the contour grown by ``margin`` metres (so that wall points fall
    inside), or the strip beyond a side where the contour ends without a wall
    (:mod:`perception.outline.frontier`), and the layers from floor to ceiling, both included. V grows and never
    shrinks: voxels of ``previous`` stay, with their labels. Voxels that are new to a grown space must be labelled
    again from all scans.

    Raises:
        FailureError: ``VOXELS_BAD_SHAPE`` if the shape holds no volume or ``previous`` has another voxel size.
    """
    if len(shape.contour) < 3 or shape.ceiling_z <= shape.floor_z:
        raise FailureError("VOXELS_BAD_SHAPE", "the room has no volume", vertices=len(shape.contour))
    if previous is not None and previous.size != size:
        raise FailureError("VOXELS_BAD_SHAPE", "the voxel size changed", size=size, previous=previous.size)
    grown = seen_and_beyond(shape).buffer(margin, join_style="mitre")
    x0, y0, x1, y1 = grown.bounds
    low = _lattice(np.array([x0, y0, shape.floor_z - SURFACE_NOISE]), size)
    high = _lattice(np.array([x1, y1, shape.ceiling_z + SURFACE_NOISE]), size) + 1
    inside = _touched(grown, low, high, size)
    labels = np.where(inside[:, :, None], np.uint8(Label.OCCLUDED), np.uint8(Label.OUTSIDE))
    labels = np.repeat(labels, high[2] - low[2], axis=2)
    return _space(labels, low, size) if previous is None else _union(_space(labels, low, size), previous)


def added(space: VoxelSpace, previous: VoxelSpace) -> NDArray[np.bool_]:
    """The voxels ``(nx, ny, nz)`` that :func:`room_space` added to ``previous``."""
    known = np.zeros(space.labels.shape, bool)
    low, low_before = _low(space), _low(previous)
    part = tuple(slice(a, a + n) for a, n in zip(low_before - low, previous.labels.shape, strict=True))
    known[part] = previous.labels != Label.OUTSIDE
    return (space.labels != Label.OUTSIDE) & ~known


def label(
    space: VoxelSpace,
    scan: Scan,
    map_from_scanner: Matrix,
    labeller: Labeller = "range",
    min_points: int = 3,
    within: NDArray[np.bool_] | None = None,
) -> VoxelSpace:
    """The space with what one more scan shows: occupied outranks empty, empty outranks occluded.

    Voxels with points are OCCUPIED; one with fewer than ``min_points`` must have a neighbour with points (26 of
    them), so that a stray return in the air is no obstacle. OCCLUDED voxels that the scan saw through become EMPTY:

    - ``range``: most of the returned beams towards the voxel went past its far side, and at most one ended in it;
    - ``paper``: the beam towards its centre returned, and no occupied voxel nearer to the scanner hides the centre
      (spheres of radius ``l / sqrt 2``, occluded iff alpha > beta, Figure 4).

    Under either rule a voxel outside the field of view, or towards which no beam returned, is not empty.
    Labelling again with the same scan changes nothing.

    Args:
        within: the voxels that may change, all by default: those that are new to a space that knows the scan.
    """
    scanner_from_map = inverse(map_from_scanner)
    pattern, origin = scan.pattern, np.asarray(space.origin)
    hits, ranges = enter(
        scan.points,
        scan.beam,
        map_from_scanner,
        origin,
        space.size,
        space.labels.shape,
        (pattern.rows, pattern.columns),
    )
    labels = space.labels.copy()
    changing = labels != Label.OUTSIDE if within is None else within
    labels[solid(hits, min_points) & changing] = Label.OCCUPIED
    seen = Seen(scanner_from_map, ranges, pattern.elevation_min, pattern.elevation_step, pattern.azimuth_step)
    rule = empty_by_range if labeller == "range" else empty_by_spheres
    # The rules look at occluded voxels only.
    asked = labels if within is None else np.where(within | (labels != Label.OCCLUDED), labels, np.uint8(Label.EMPTY))
    empty = rule(asked, origin, space.size, seen)
    labels.reshape(-1)[empty] = Label.EMPTY
    return VoxelSpace(labels, space.origin, space.size)


def counts(space: VoxelSpace) -> LabelCounts:
    """Voxels by label, the figures of Table 1."""
    by_label = np.bincount(space.labels.ravel(), minlength=len(Label))
    return LabelCounts(int(by_label[Label.OCCUPIED]), int(by_label[Label.EMPTY]), int(by_label[Label.OCCLUDED]))


def _lattice(position: NDArray[np.float64], size: float) -> NDArray[np.int64]:
    return np.floor(position / size + LATTICE_SHIFT).astype(np.int64)


def _space(labels: NDArray[np.uint8], low: NDArray[np.int64], size: float) -> VoxelSpace:
    x, y, z = (low - LATTICE_SHIFT) * size
    return VoxelSpace(labels, (float(x), float(y), float(z)), size)


def _low(space: VoxelSpace) -> NDArray[np.int64]:
    """Place of voxel [0, 0, 0] on the lattice."""
    return np.rint(np.asarray(space.origin) / space.size + LATTICE_SHIFT).astype(np.int64)


def _touched(
    polygon: shapely.Geometry, low: NDArray[np.int64], high: NDArray[np.int64], size: float
) -> NDArray[np.bool_]:
    """``(nx, ny)``: columns of the lattice whose square touches the polygon."""
    x = np.arange(low[0], high[0])[:, None] * size
    y = np.arange(low[1], high[1])[None, :] * size
    shapely.prepare(polygon)
    return shapely.intersects(polygon, shapely.box(x, y, x + size, y + size))


def _union(new: VoxelSpace, previous: VoxelSpace) -> VoxelSpace:
    """Both spaces on one array; the labels of ``previous`` win where it has any."""
    lows = [_low(space) for space in (new, previous)]
    low = np.minimum(*lows)
    high = np.maximum(lows[0] + new.labels.shape, lows[1] + previous.labels.shape)
    labels = np.zeros(high - low, np.uint8)
    for space, start in zip((new, previous), lows, strict=True):
        part = labels[tuple(slice(a, a + n) for a, n in zip(start - low, space.labels.shape, strict=True))]
        np.copyto(part, space.labels, where=space.labels != Label.OUTSIDE)
    return _space(labels, low, new.size)
