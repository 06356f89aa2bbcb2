"""How much of the structure has been sensed, and how much of it could have been (paper section 6, Table 2).

The structure (walls, floor, ceiling) is cut into square patches (:mod:`perception.patches`). A patch is *sensed* when
the cloud holds at least ``min_points`` points inside it; it is *coverable* when the scanner could see it from some
place where the base can stand. The share of all surface says as much about the furniture as about the scanning, the
share of the coverable surface C* says how well the views were chosen.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from perception.patches import Patches

_CLEARANCE = 0.01
"""A ray that comes this near to its target (metres) has reached it: the target's own triangle must not stop it."""

_RAYS = 2_000_000
"""Rays cast at once, which bounds the memory."""


@dataclass(frozen=True)
class ViewLimits:
    """What a scanner standing upright can see: elevations and largest incidence in radians, ranges in metres."""

    elevation: tuple[float, float]
    ranges: tuple[float, float]
    incidence: float = float(np.deg2rad(82.0))


class PatchCounter:
    """Counts points per patch, cloud after cloud.

    A point counts once, for the patch with the nearest plane among those whose square it falls on within
    ``tolerance`` of the plane: points on the floor beside a wall do not count for the wall.

    Args:
        patches: K patches.
        tolerance: greatest distance of a point from a patch's plane, metres.
    """

    def __init__(self, patches: Patches, tolerance: float = 0.05) -> None:
        self.counts: NDArray[np.int64] = np.zeros(patches.count, np.int64)
        self._patches = patches
        self._tolerance = tolerance
        middle = patches.corners + patches.axes.sum(axis=1) * (patches.cell / 2)
        reach = np.abs(patches.axes).sum(axis=1) * (patches.cell / 2) + np.abs(patches.normals) * tolerance
        self._origin = (middle - reach).min(axis=0)
        self._bin = max(patches.cell, tolerance)
        first, last = (
            np.floor((end - self._origin) / self._bin).astype(np.int64) for end in (middle - reach, middle + reach)
        )
        self._shape = last.max(axis=0) + 1
        self._starts, self._members = _bins(first, last, self._shape)

    def add(self, cloud: NDArray[np.floating]) -> None:
        """Add the points ``(N, 3)`` of a cloud in the frame of the patches, metres."""
        _count(
            np.ascontiguousarray(cloud, np.float32),
            self._origin,
            self._bin,
            self._shape,
            self._starts,
            self._members,
            self._patches.corners,
            self._patches.axes,
            self._patches.cell,
            self._tolerance,
            self.counts,
        )


def _bins(
    first: NDArray[np.int64], last: NDArray[np.int64], shape: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Which patches touch each bin of a dense grid, as offsets into one list."""
    bins, patches = [], []
    for step in np.ndindex(*((last - first).max(axis=0) + 1)):
        touched = np.flatnonzero((first + step <= last).all(axis=1))
        bins.append(np.ravel_multi_index((first[touched] + step).T, shape))
        patches.append(touched)
    bin_of, patch = np.concatenate(bins), np.concatenate(patches)
    starts = np.append(0, np.cumsum(np.bincount(bin_of, minlength=int(np.prod(shape)))))
    return starts, patch[np.argsort(bin_of, kind="stable")]


@njit(cache=True)
def _count(
    points: NDArray[np.float32],
    origin: NDArray[np.float64],
    size: float,
    shape: NDArray[np.int64],
    starts: NDArray[np.int64],
    members: NDArray[np.int64],
    corners: NDArray[np.float64],
    axes: NDArray[np.float64],
    cell: float,
    tolerance: float,
    counts: NDArray[np.int64],
) -> None:
    for n in range(len(points)):
        x, y, z = float(points[n, 0]), float(points[n, 1]), float(points[n, 2])
        i, j, k = (x - origin[0]) // size, (y - origin[1]) // size, (z - origin[2]) // size
        if not (0 <= i < shape[0] and 0 <= j < shape[1] and 0 <= k < shape[2]):
            continue
        at = int((i * shape[1] + j) * shape[2] + k)
        best, nearest = -1, tolerance
        for m in range(starts[at], starts[at + 1]):
            patch = members[m]
            dx, dy, dz = x - corners[patch, 0], y - corners[patch, 1], z - corners[patch, 2]
            u0, u1, u2 = axes[patch, 0, 0], axes[patch, 0, 1], axes[patch, 0, 2]
            v0, v1, v2 = axes[patch, 1, 0], axes[patch, 1, 1], axes[patch, 1, 2]
            along, up = dx * u0 + dy * u1 + dz * u2, dx * v0 + dy * v1 + dz * v2
            if 0 <= along < cell and 0 <= up < cell:
                away = dx * (u1 * v2 - u2 * v1) + dy * (u2 * v0 - u0 * v2) + dz * (u0 * v1 - u1 * v0)
                if abs(away) <= nearest:
                    best, nearest = patch, abs(away)
        if best >= 0:
            counts[best] += 1


def sensed(
    patches: Patches, cloud: NDArray[np.floating], min_points: int = 1, tolerance: float = 0.05
) -> NDArray[np.bool_]:
    """Which of the K patches hold at least ``min_points`` points of the cloud (section 6)."""
    counter = PatchCounter(patches, tolerance)
    counter.add(cloud)
    return counter.counts >= min_points


def coverable(
    patches: Patches, stations: ArrayLike, blockers: ArrayLike, view: ViewLimits, targets_per_patch: int = 5
) -> NDArray[np.bool_]:
    """Which of the K patches the scanner could see from at least one station: the coverable surface C*.

    Args:
        patches: K patches.
        stations: ``(P, 3)`` positions of the optical centre, in the frame of the patches.
        blockers: ``(T, 3, 3)`` triangles that stop a beam (glass does not).
        view: limits of the scanner.
        targets_per_patch: places of a patch that are looked at; one seen is enough.
    """
    places = np.asarray(stations, float).reshape(-1, 3)
    scene = _scene(np.asarray(blockers, float).reshape(-1, 3, 3))
    chosen = _spread_targets(patches.owner, targets_per_patch)
    targets, owner = patches.targets[chosen].astype(float), patches.owner[chosen]
    seen = np.zeros(patches.count, bool)
    waiting = np.arange(len(targets))
    normals = patches.normals[owner]
    batch: list[tuple[NDArray[np.float64], NDArray[np.int64]]] = []
    size = 0
    for number, station in enumerate(_far_apart_first(places)):
        candidates = waiting[_within_limits(targets[waiting] - station, normals[waiting], view)]
        batch.append((station, candidates))
        size += len(candidates)
        # Early stations see most of the surface: cast them one by one, so that the rest is not asked for again.
        if size > min(_RAYS, 20_000 * (number + 1)) or number + 1 == len(places):
            index = np.concatenate([c for _, c in batch])
            origin = np.repeat([s for s, _ in batch], [len(c) for _, c in batch], axis=0)
            seen[owner[index[_unblocked(scene, origin, targets[index])]]] = True
            waiting = waiting[~seen[owner[waiting]]]
            batch, size = [], 0
    return seen


def _spread_targets(owner: NDArray[np.int64], per_patch: int) -> NDArray[np.int64]:
    """Index of up to ``per_patch`` evenly spread targets of each patch (``owner`` ascends)."""
    starts = np.flatnonzero(np.diff(owner, prepend=-1))
    lengths = np.diff(np.append(starts, len(owner)))
    rank = (np.arange(per_patch)[None, :] + 0.5) / per_patch
    picks = starts[:, None] + np.floor(rank * lengths[:, None]).astype(np.int64)
    return np.unique(picks)


def _far_apart_first(places: NDArray[np.float64]) -> NDArray[np.float64]:
    """The same places in an order whose beginnings spread over all of them (fixed shuffle)."""
    return places[np.random.default_rng(0).permutation(len(places))]


def _within_limits(rays: NDArray[np.float64], normals: NDArray[np.float64], view: ViewLimits) -> NDArray[np.bool_]:
    distance = np.linalg.norm(rays, axis=1)
    sine = rays[:, 2] / np.maximum(distance, 1e-9)
    incidence_cosine = np.abs(np.einsum("nj,nj->n", rays, normals)) / np.maximum(distance, 1e-9)
    result: NDArray[np.bool_] = (
        (distance >= view.ranges[0])
        & (distance <= view.ranges[1])
        & (sine >= np.sin(view.elevation[0]))
        & (sine <= np.sin(view.elevation[1]))
        & (incidence_cosine >= np.cos(view.incidence))
    )
    return result


def _scene(triangles: NDArray[np.float64]) -> Any:
    import open3d as o3d

    scene = o3d.t.geometry.RaycastingScene()
    if len(triangles):
        vertices = np.ascontiguousarray(triangles.reshape(-1, 3), np.float32)
        faces = np.arange(len(vertices), dtype=np.uint32).reshape(-1, 3)
        scene.add_triangles(o3d.core.Tensor.from_numpy(vertices), o3d.core.Tensor.from_numpy(faces))
    return scene


def _unblocked(scene: Any, origins: NDArray[np.float64], targets: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether nothing stands between each origin and target ``(N, 3)``."""
    import open3d as o3d

    if not len(origins):
        return np.zeros(0, bool)
    rays = targets - origins
    rays *= 1 - _CLEARANCE / np.linalg.norm(rays, axis=1, keepdims=True)
    tensor = o3d.core.Tensor.from_numpy(np.ascontiguousarray(np.concatenate([origins, rays], axis=1), np.float32))
    return ~scene.test_occlusions(tensor, tnear=0.0, tfar=1.0).numpy()
