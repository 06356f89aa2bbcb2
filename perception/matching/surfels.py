"""What registration keeps of a scan: small oriented planes to pair, and how far it saw in each direction to object."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import minimum_filter
from scipy.spatial import cKDTree

from perception import transforms
from perception.matching import thinning
from perception.matching.planes import fit_planes
from perception.transforms import Matrix

SPACING = 0.08
"""Distance between neighbouring surfels, metres."""

_GRAIN = 0.03
_NEIGHBOURS = 14
_MAX_ROUGHNESS = 0.008
_MIN_WIDTH_RATIO = 0.12
_SEEN_THROUGH = 0.4
_VIEW_POINTS = 2_000_000


@dataclass(frozen=True)
class Surfels:
    """Points on locally flat surface with their normals.

    Args:
        points: ``(N, 3)`` float32, metres.
        normals: ``(N, 3)`` float32, unit length, towards the scanner that saw them: the two faces of a thin wall
            are told apart by nothing else.
        slants: ``(N,)`` float32, cosine between the normal and the beam that saw it, -1 head-on to 0 grazing: a range
            that is wrong by b moves the surface by b times this along the normal.
    """

    points: NDArray[np.float32]
    normals: NDArray[np.float32]
    slants: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.points)

    @classmethod
    def joined(cls, parts: "Sequence[Surfels]") -> "Surfels":
        """All of several, in their order."""
        return cls(*(np.concatenate([getattr(part, name) for part in parts]) for name in cls.__dataclass_fields__))

    def moved(self, target_from_source: Matrix) -> "Surfels":
        """The same surfels in another frame."""
        rotation = target_from_source[:3, :3].astype(np.float32)
        return Surfels(transforms.apply(target_from_source, self.points), self.normals @ rotation.T, self.slants)

    def pick(self, index: NDArray | slice) -> "Surfels":
        """The surfels of an index, mask or slice."""
        return Surfels(self.points[index], self.normals[index], self.slants[index])


@dataclass(frozen=True)
class Surface:
    """A thinned scan in its scanner's frame, some hundred kilobytes, made once and used by every later registration.

    Args:
        surfels: where it met flat surface.
        sight: ``(180, 360)`` float32 over elevation and azimuth in degrees: metres that were surely free (the
            shortest range of the direction and its neighbours), 0 where nothing returned.
    """

    surfels: Surfels
    sight: NDArray[np.float32]

    def compare(self, surfels: Surfels) -> tuple[int, int]:
        """How many of other surfels (in this scanner's frame) this scan confirms, and how many it saw through.

        Seen through means that the scan measured at least 10 cm (and 2 %) behind a surfel that faces it.
        """
        distance = np.linalg.norm(surfels.points, axis=1)
        facing = np.einsum("ij,ij->i", surfels.points, surfels.normals) < -0.2 * distance
        free = self.sight.ravel()[thinning.view_cells(surfels.points)[0]]
        known = facing & (free > 0)
        through = known & (free > 1.02 * distance + 0.10)
        confirmed = known & (np.abs(free - distance) <= 0.02 * distance + 0.10)
        return int(np.count_nonzero(confirmed)), int(np.count_nonzero(through))


def surface_of(points: NDArray[np.floating], spacing: float = SPACING) -> Surface:
    """Thin one scan.

    Each surfel is the plane of its nearest neighbours among 3 cm voxel means. Means lie on the surface wherever it is
    flat; where it is not (corners, edges, mixed pixels, scan lines too far apart to span a plane) the surfel is left
    out, so that averaging never biases a surface. Panes are left out as well: what the scan itself saw through is
    there for one station and not for the next.

    Args:
        points: ``(N, 3)`` in the scanner's frame (the scanner at the origin), metres; non-finite rows are ignored.
        spacing: side of the voxels that keep one surfel each, metres.
    """
    points = np.ascontiguousarray(points, np.float32)
    surfels = _surfels(thinning.voxel_means(points, _GRAIN), spacing)
    # A degree of the view holds a hundred beams of a fine scan; a third of them says as much.
    cells, ranges = thinning.view_cells(np.ascontiguousarray(points[:: len(points) // _VIEW_POINTS + 1]))
    return Surface(surfels.pick(~_transparent(surfels, cells, ranges)), _sight(cells, ranges))


def _surfels(grains: NDArray[np.float32], spacing: float) -> Surfels:
    if len(grains) < _NEIGHBOURS:
        return Surfels(np.empty((0, 3), np.float32), np.empty((0, 3), np.float32), np.empty(0, np.float32))
    centres = grains[first_per_voxel(grains, spacing)]
    _, index = cKDTree(grains, balanced_tree=False, compact_nodes=False).query(centres, _NEIGHBOURS, workers=2)
    middle, normals, variance = fit_planes(grains, index)
    flat = (variance[:, 0] < _MAX_ROUGHNESS**2) & (variance[:, 0] < 0.05 * variance[:, 1])
    flat &= variance[:, 1] > _MIN_WIDTH_RATIO**2 * variance[:, 2]
    on_plane = centres - np.einsum("ij,ij->i", centres - middle, normals)[:, None] * normals
    normals[np.einsum("ij,ij->i", on_plane, normals) > 0] *= -1
    slants = np.einsum("ij,ij->i", on_plane, normals) / np.maximum(np.linalg.norm(on_plane, axis=1), 1e-6)
    return Surfels(on_plane[flat], normals[flat], slants[flat])


def _transparent(surfels: Surfels, cells: NDArray[np.int32], ranges: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Surfels in whose direction a good part of the beams went on, well behind them: a pane, or an edge."""
    at, own = thinning.view_cells(surfels.points)
    grouped, bounds = thinning.ranges_by_cell(cells, ranges)
    return thinning.share_beyond(grouped, bounds, at, 1.02 * own + 0.10) > _SEEN_THROUGH


def _sight(cells: NDArray[np.int32], ranges: NDArray[np.float32]) -> NDArray[np.float32]:
    nearest = thinning.least_by_cell(cells, ranges).reshape(thinning.VIEW_ROWS, thinning.VIEW_COLUMNS)
    # The neighbours' minimum: an edge or a slanting surface within the cell must not look transparent.
    eroded = minimum_filter(nearest, size=3, mode=("nearest", "wrap"))
    return np.where(np.isfinite(nearest), eroded, 0.0).astype(np.float32)


def _voxel_keys(points: NDArray[np.float32], size: float, kind: NDArray | int) -> NDArray[np.int64]:
    cells = np.floor((points - points.min(axis=0)) / np.float32(size)).astype(np.int64)
    return ((cells[:, 0] << 42) | (cells[:, 1] << 23) | (cells[:, 2] << 4)) + kind


def first_per_voxel(points: NDArray[np.float32], size: float, kind: NDArray | int = 0) -> NDArray[np.int64]:
    """Index of the first point of every voxel (and of every ``kind`` in 0..15 within it), ascending."""
    if len(points) == 0:
        return np.empty(0, np.int64)
    return thinning.first_of_keys(_voxel_keys(points, size, kind))
