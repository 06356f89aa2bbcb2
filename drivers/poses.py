"""Rigid transforms that come from outside: checked before anything is computed with them."""

import numpy as np
from numpy.typing import ArrayLike

from perception.transforms import Matrix

TOLERANCE = 1e-6


def rigid(values: ArrayLike) -> Matrix:
    """The 4x4 float64 transform in ``values`` (16 numbers, row by row, in any shape).

    Raises:
        ValueError: unless it is finite, with an orthonormal right-handed rotation and a last row of 0 0 0 1.
    """
    matrix = np.asarray(values, np.float64)
    if matrix.size != 16:
        raise ValueError(f"a transform has 16 numbers, not {matrix.size}")
    matrix = matrix.reshape(4, 4)
    if not np.isfinite(matrix).all():
        raise ValueError("a transform must be finite")
    rotation = matrix[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > TOLERANCE or np.linalg.det(rotation) < 0:
        raise ValueError("the rotation of a transform must be orthonormal and right-handed")
    if np.abs(matrix[3] - (0, 0, 0, 1)).max() > TOLERANCE:
        raise ValueError("the last row of a transform must be 0 0 0 1")
    return matrix
