"""How much of the structure has been sensed, and how much of it could have been (paper section 6, Table 2).

The structure (walls, floor, ceiling) is cut into square patches of one cell size. A patch is *sensed* when the cloud
holds at least ``min_points`` points inside it; it is *coverable* when the scanner could see it from some place where
the base can stand. The share of all surface says as much about the furniture as about the scanning, the share of the
coverable surface C* says how well the views were chosen.
"""

from dataclasses import dataclass
from enum import IntEnum
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from perception.failure import FailureError

_LATTICE = 4
"""Sample points along the side of a cell: they give a cut cell its area, and its targets for visibility."""

_CLEARANCE = 0.01
"""A ray that comes this near to its target (metres) has reached it: the target's own triangle must not stop it."""

_RAYS = 2_000_000
"""Rays cast at once, which bounds the memory."""


class Structure(IntEnum):
    """The structural elements whose area Table 2 counts."""

    WALL = 0
    FLOOR = 1
    CEILING = 2


@dataclass(frozen=True)
class Patches:
    """A surface cut into cells of equal size; a cell on the surface's rim is smaller than the others.

    Args:
        corners: ``(K, 3)`` float64, the lower corner of each cell's full square, metres.
        axes: ``(K, 2, 3)`` unit vectors along the sides of the square.
        areas: ``(K,)`` of the surface in the cell, square metres.
        targets: ``(S, 3)`` float32 points spread over the surface.
        owner: ``(S,)`` int64, ascending, the patch of each target; every patch has one at least.
        cell: side of a full cell, metres.
    """

    corners: NDArray[np.float64]
    axes: NDArray[np.float64]
    areas: NDArray[np.float64]
    targets: NDArray[np.float32]
    owner: NDArray[np.int64]
    cell: float

    @property
    def count(self) -> int:
        return len(self.areas)

    @property
    def normals(self) -> NDArray[np.float64]:
        """``(K, 3)`` unit normals."""
        return np.cross(self.axes[:, 0], self.axes[:, 1])

    @classmethod
    def merged(cls, parts: "list[Patches]") -> "Patches":
        """All parts as one, patches in their order; the parts share one cell size."""
        starts = np.cumsum([0] + [part.count for part in parts[:-1]])
        return cls(
            np.concatenate([part.corners for part in parts]),
            np.concatenate([part.axes for part in parts]),
            np.concatenate([part.areas for part in parts]),
            np.concatenate([part.targets for part in parts]),
            np.concatenate([part.owner + start for part, start in zip(parts, starts, strict=True)]),
            parts[0].cell,
        )


@dataclass(frozen=True)
class ViewLimits:
    """What a scanner standing upright can see: elevations and largest incidence in radians, ranges in metres."""

    elevation: tuple[float, float]
    ranges: tuple[float, float]
    incidence: float = float(np.deg2rad(82.0))


def sample_surfaces(triangles: ArrayLike, cell: float = 0.10) -> Patches:
    """Cut a surface into square cells.

    Triangles of one plane share one lattice of cells, so that the result does not depend on how the surface was
    triangulated. The lattice of a wall has a horizontal side, that of a floor lies along x and y.

    Args:
        triangles: ``(T, 3, 3)`` corners, metres, in any frame; those without area are left out.
        cell: side of a cell, metres.

    Raises:
        FailureError: ``COVERAGE_NO_SURFACE`` if no triangle has an area.
    """
    corners = np.asarray(triangles, float).reshape(-1, 3, 3)
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    twice_area = np.linalg.norm(cross, axis=1)
    kept = twice_area > 1e-10
    if not kept.any():
        raise FailureError("COVERAGE_NO_SURFACE", "no triangle of the surface has an area", triangles=len(corners))
    corners, areas, normals = corners[kept], twice_area[kept] / 2, cross[kept] / twice_area[kept, None]
    axes = _plane_axes(normals)
    samples, weights, triangle = _lattice_samples(corners, axes, areas, cell / _LATTICE)
    frame = axes[triangle]
    offset = np.einsum("nj,nj->n", samples, normals[triangle])
    square = np.floor(np.einsum("nkj,nj->nk", frame, samples) / cell + 1e-9).astype(np.int64)
    plane = np.round(np.column_stack([normals[triangle] * 200 + 0.3, offset * 200 + 0.3])).astype(np.int64)
    first, inverse = _group(np.column_stack([plane, square]))
    order = np.argsort(inverse, kind="stable")
    return Patches(
        np.einsum("nk,nkj->nj", square[first] * cell, frame[first])
        + offset[first, None] * normals[triangle][first],
        frame[first],
        np.bincount(inverse, weights),
        samples[order].astype(np.float32),
        inverse[order],
        cell,
    )


def _plane_axes(normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Right-handed in-plane axes ``(T, 2, 3)``; the first is horizontal, and along x on a level plane."""
    level = np.abs(normals[:, 2]) > 0.99
    first = np.column_stack([-normals[:, 1], normals[:, 0], np.zeros(len(normals))])
    first[level] = np.array([1.0, 0.0, 0.0]) - normals[level, :1] * normals[level]
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    return np.stack([first, np.cross(normals, first)], axis=1)


def _lattice_samples(
    corners: NDArray[np.float64], axes: NDArray[np.float64], areas: NDArray[np.float64], spacing: float
) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
    """Points ``(S, 3)`` of the plane's lattice inside each triangle, the area each stands for, and its triangle.

    A sliver that no lattice point meets is stood for by its centroid, so that no area is lost.
    """
    samples, weights, numbers = [], [], []
    planar = np.einsum("tkj,tcj->tck", axes, corners)
    for number, (triangle, flat) in enumerate(zip(corners, planar, strict=True)):
        low, high = np.floor(flat.min(axis=0) / spacing), np.ceil(flat.max(axis=0) / spacing)
        u, v = np.meshgrid(*((np.arange(a, b) + 0.5) * spacing for a, b in zip(low, high, strict=True)))
        sides = [_side(flat[i], flat[(i + 1) % 3], u, v) for i in range(3)]
        inside = (sides[0] >= 0) & (sides[1] >= 0) & (sides[2] >= 0)
        if inside.any():
            steps = np.column_stack([u[inside], v[inside]]) - flat[0]
            points = triangle[0] + steps @ axes[number]
        else:
            points = triangle.mean(axis=0, keepdims=True)
        samples.append(points)
        weights.append(np.full(len(points), areas[number] / len(points)))
        numbers.append(np.full(len(points), number))
    return np.concatenate(samples), np.concatenate(weights), np.concatenate(numbers)


def _side(
    a: NDArray[np.float64], b: NDArray[np.float64], u: NDArray[np.float64], v: NDArray[np.float64]
) -> NDArray[np.float64]:
    return (b[0] - a[0]) * (v - a[1]) - (b[1] - a[1]) * (u - a[0])


def _group(keys: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First row of each distinct key, and the number of the key that each row has."""
    _, first, inverse = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    return first, inverse.reshape(-1).astype(np.int64)


def count_points(patches: Patches, cloud: NDArray[np.floating], tolerance: float = 0.05) -> NDArray[np.int64]:
    """Points of the cloud in each patch; counts of several clouds may be added.

    A point counts once, for the patch with the nearest plane among those whose square it falls on within
    ``tolerance`` of the plane: points on the floor beside a wall do not count for the wall.

    Args:
        patches: K patches.
        cloud: ``(N, 3)`` in the frame of the patches, metres.
        tolerance: metres.
    """
    middle = patches.corners + (patches.axes.sum(axis=1)) * (patches.cell / 2)
    reach = np.abs(patches.axes).sum(axis=1) * (patches.cell / 2) + np.abs(patches.normals) * tolerance
    low, high = middle - reach, middle + reach
    origin, size = low.min(axis=0), max(patches.cell, 0.05)
    shape = np.floor((high.max(axis=0) - origin) / size).astype(np.int64) + 1
    first, last = np.floor((low - origin) / size).astype(np.int64), np.floor((high - origin) / size).astype(np.int64)
    starts, members = _bins(first, last, shape)
    points = np.ascontiguousarray(cloud, np.float32)
    return _count(
        points, origin, size, shape, starts, members, patches.corners, patches.axes, patches.cell, tolerance
    )


@njit(cache=True)
def _bins(
    first: NDArray[np.int64], last: NDArray[np.int64], shape: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Which patches touch each bin of a dense grid, as offsets into one list."""
    starts = np.zeros(shape[0] * shape[1] * shape[2] + 1, np.int64)
    for fill in range(2):
        if fill:
            starts[1:] = np.cumsum(starts[1:])
            members = np.empty(starts[-1], np.int32)
            place = starts[:-1].copy()
        for patch in range(len(first)):
            for i in range(first[patch, 0], last[patch, 0] + 1):
                for j in range(first[patch, 1], last[patch, 1] + 1):
                    for k in range(first[patch, 2], last[patch, 2] + 1):
                        at = (i * shape[1] + j) * shape[2] + k
                        if fill:
                            members[place[at]] = patch
                            place[at] += 1
                        else:
                            starts[at + 1] += 1
    return starts, members


@njit(cache=True)
def _count(
    points: NDArray[np.float32],
    origin: NDArray[np.float64],
    size: float,
    shape: NDArray[np.int64],
    starts: NDArray[np.int64],
    members: NDArray[np.int32],
    corners: NDArray[np.float64],
    axes: NDArray[np.float64],
    cell: float,
    tolerance: float,
) -> NDArray[np.int64]:
    counts = np.zeros(len(corners), np.int64)
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
    return counts


def sensed(
    patches: Patches, cloud: NDArray[np.floating], min_points: int = 1, tolerance: float = 0.05
) -> NDArray[np.bool_]:
    """Which of the K patches hold at least ``min_points`` points of the cloud (section 6)."""
    return count_points(patches, cloud, tolerance) >= min_points


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


def _within_limits(
    rays: NDArray[np.float64], normals: NDArray[np.float64], view: ViewLimits
) -> NDArray[np.bool_]:
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
        scene.add_triangles(o3d.core.Tensor(vertices), o3d.core.Tensor(faces))
    return scene


def _unblocked(scene: Any, origins: NDArray[np.float64], targets: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether nothing stands between each origin and target ``(N, 3)``."""
    import open3d as o3d

    if not len(origins):
        return np.zeros(0, bool)
    rays = targets - origins
    rays *= 1 - _CLEARANCE / np.linalg.norm(rays, axis=1, keepdims=True)
    tensor = o3d.core.Tensor(np.ascontiguousarray(np.concatenate([origins, rays], axis=1), np.float32))
    return ~scene.test_occlusions(tensor, tnear=0.0, tfar=1.0).numpy()
