"""Planes through small groups of points: the smallest eigenvector of each one's covariance, in closed form."""

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True)
def fit_planes(
    points: NDArray[np.float32], groups: NDArray[np.int64]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float64]]:
    """Least-squares plane of each group of points.

    Args:
        points: ``(N, 3)`` float32.
        groups: ``(M, k)`` indices into ``points``.

    Returns:
        Centroids ``(M, 3)``, unit normals ``(M, 3)`` of either sense, and variances ``(M, 3)`` along the principal
        axes, ascending. Where the two smallest are equal (a line, a point) the normal is one of many.
    """
    count, size = groups.shape
    centroids, normals = np.empty((count, 3), np.float32), np.empty((count, 3), np.float32)
    variances = np.empty((count, 3))
    for m in range(count):
        mean = np.zeros(3)
        for k in range(size):
            mean += points[groups[m, k]]
        mean /= size
        xx = xy = xz = yy = yz = zz = 0.0
        for k in range(size):
            x, y, z = points[groups[m, k]] - mean
            xx, xy, xz = xx + x * x, xy + x * y, xz + x * z
            yy, yz, zz = yy + y * y, yz + y * z, zz + z * z
        covariance = (xx / size, xy / size, xz / size, yy / size, yz / size, zz / size)
        variances[m] = _eigenvalues(covariance)
        centroids[m] = mean
        normals[m] = _eigenvector(covariance, variances[m, 0])
    return centroids, normals, variances


@njit(cache=True)
def _eigenvalues(covariance: tuple[float, float, float, float, float, float]) -> tuple[float, float, float]:
    """Ascending eigenvalues of a symmetric matrix by Smith's trigonometric formula (CACM 4, 1961)."""
    xx, xy, xz, yy, yz, zz = covariance
    third = (xx + yy + zz) / 3
    a, b, c = xx - third, yy - third, zz - third
    spread = np.sqrt((a * a + b * b + c * c + 2 * (xy * xy + xz * xz + yz * yz)) / 6)
    if spread <= 0.0:
        return third, third, third
    determinant = a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)
    angle = np.arccos(min(1.0, max(-1.0, determinant / (2 * spread**3)))) / 3
    largest = third + 2 * spread * np.cos(angle)
    smallest = third + 2 * spread * np.cos(angle + 2 * np.pi / 3)
    return max(smallest, 0.0), 3 * third - largest - smallest, largest


@njit(cache=True)
def _eigenvector(
    covariance: tuple[float, float, float, float, float, float], value: float
) -> tuple[float, float, float]:
    """Unit vector at right angles to the rows of ``covariance - value``: the longest product of two of them."""
    xx, xy, xz, yy, yz, zz = covariance
    a, b, c = xx - value, yy - value, zz - value
    u = (xy * yz - xz * b, xz * xy - a * yz, a * b - xy * xy)
    v = (xy * c - xz * yz, xz * xz - a * c, a * yz - xy * xz)
    w = (b * c - yz * yz, yz * xz - xy * c, xy * yz - b * xz)
    best, length = u, _squared(u)
    for other in (v, w):
        if _squared(other) > length:
            best, length = other, _squared(other)
    if length <= 0.0:
        return 0.0, 0.0, 1.0
    scale = 1.0 / np.sqrt(length)
    return best[0] * scale, best[1] * scale, best[2] * scale


@njit(cache=True)
def _squared(vector: tuple[float, float, float]) -> float:
    return vector[0] * vector[0] + vector[1] * vector[1] + vector[2] * vector[2]
