"""Rigid transforms as 4x4 float64 matrices named ``target_from_source`` (REP-103: metres, radians, z up)."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Matrix = NDArray[np.float64]


def from_euler(roll: float, pitch: float, yaw: float, translation: ArrayLike = (0.0, 0.0, 0.0)) -> Matrix:
    """Transform with rotation ``Rz(yaw) Ry(pitch) Rx(roll)`` and the given translation in metres."""
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (np.cos, np.sin))
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
        [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
        [-sp, cp * sr, cp * cr],
    ]
    matrix[:3, 3] = translation
    return matrix


def to_euler(matrix: Matrix) -> tuple[float, float, float]:
    """Inverse of :func:`from_euler`: (roll, pitch, yaw) in radians."""
    r = matrix[:3, :3]
    return (
        float(np.arctan2(r[2, 1], r[2, 2])),
        float(np.arcsin(np.clip(-r[2, 0], -1.0, 1.0))),
        float(np.arctan2(r[1, 0], r[0, 0])),
    )


def planar(x: float, y: float, yaw: float) -> Matrix:
    """Transform of a pose on the floor plane."""
    return from_euler(0.0, 0.0, yaw, (x, y, 0.0))


def to_planar(matrix: Matrix) -> tuple[float, float, float]:
    """(x, y, yaw) of a transform; roll, pitch and z are dropped."""
    return float(matrix[0, 3]), float(matrix[1, 3]), float(np.arctan2(matrix[1, 0], matrix[0, 0]))


def inverse(matrix: Matrix) -> Matrix:
    """Inverse of a rigid transform."""
    result = np.eye(4)
    rotation = matrix[:3, :3].T
    result[:3, :3] = rotation
    result[:3, 3] = -rotation @ matrix[:3, 3]
    return result


def apply(matrix: Matrix, points: NDArray[np.floating]) -> NDArray[np.float32]:
    """Points ``(N, 3)`` of the source frame in the target frame, as float32."""
    rotation = matrix[:3, :3].astype(np.float32)
    return points.astype(np.float32, copy=False) @ rotation.T + matrix[:3, 3].astype(np.float32)


def rotation_angle(matrix: Matrix) -> float:
    """Size of the rotation in radians, in [0, pi]."""
    r = matrix[:3, :3]
    skew = np.array([r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]])
    return float(np.arctan2(np.linalg.norm(skew), np.trace(r) - 1.0))


def difference(a: Matrix, b: Matrix) -> tuple[float, float]:
    """Distance in metres and angle in radians between two transforms of the same pair of frames."""
    return float(np.linalg.norm(a[:3, 3] - b[:3, 3])), rotation_angle(inverse(a) @ b)


# scipy has both as well, but the process that ticks would load half of scipy for nothing else.


def to_quaternion(matrix: Matrix) -> tuple[float, float, float, float]:
    """Unit quaternion (x, y, z, w) of the rotation; of the two, the one whose largest component is positive."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = matrix[:3, :3]
    products = np.array(
        [
            [1 + xx - yy - zz, xy + yx, xz + zx, zy - yz],
            [xy + yx, 1 - xx + yy - zz, yz + zy, xz - zx],
            [xz + zx, yz + zy, 1 - xx - yy + zz, yx - xy],
            [zy - yz, xz - zx, yx - xy, 1 + xx + yy + zz],
        ]
    )
    # Each row is the quaternion times four times one of its components: the largest of these loses no digits.
    row = products[np.argmax(np.diagonal(products))]
    x, y, z, w = row / np.linalg.norm(row)
    return float(x), float(y), float(z), float(w)


def from_quaternion(quaternion: ArrayLike, translation: ArrayLike = (0.0, 0.0, 0.0)) -> Matrix:
    """Transform from a quaternion (x, y, z, w), normalised here, and a translation in metres.

    Raises:
        ValueError: the quaternion is zero, or no number.
    """
    given = np.asarray(quaternion, float)
    norm = np.linalg.norm(given)
    if not norm > 0.0:
        raise ValueError(f"expected a quaternion of some length, found {given.tolist()}")
    x, y, z, w = given / norm
    matrix = np.eye(4)
    matrix[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    matrix[:3, 3] = translation
    return matrix
