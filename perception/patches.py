"""A surface cut into square patches of one size: the unit in which coverage is counted (paper section 6)."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from perception.failure import FailureError

_LATTICE = 4
"""Sample points along the side of a cell: they give a cut cell its area, and its targets for visibility."""


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
    # A round offset, such as that of a floor at 3.00 m, must not fall between two keys.
    offset = np.einsum("tj,tj->t", corners[:, 0], normals)
    plane_key = np.round(np.column_stack([normals, offset]) * 200 + 0.3)
    plane = np.unique(plane_key, axis=0, return_inverse=True)[1].reshape(-1)
    samples, weights, triangle = _lattice_samples(corners, axes, areas, cell / _LATTICE)
    frame, foot = axes[triangle], (offset[:, None] * normals)[triangle]
    square = np.floor(np.einsum("nkj,nj->nk", frame, samples) / cell + 1e-9).astype(np.int64)
    first, inverse = _group(plane[triangle], square)
    order = np.argsort(inverse, kind="stable")
    return Patches(
        np.einsum("nk,nkj->nj", square[first] * cell, frame[first]) + foot[first],
        frame[first],
        np.bincount(inverse, weights).astype(np.float64),
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


def _group(plane: NDArray[np.int64], square: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """First row of each distinct square of a plane, and the number of the square that each row has."""
    low, high = square.min(axis=0), square.max(axis=0)
    shape = (int(plane.max()) + 1, *(int(n) for n in high - low + 1))
    keys = np.ravel_multi_index((plane, *(square - low).T), shape)
    _, first, inverse = np.unique(keys, return_index=True, return_inverse=True)
    return first.astype(np.int64), inverse.reshape(-1).astype(np.int64)
