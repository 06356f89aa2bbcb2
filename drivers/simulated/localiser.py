"""Where the base believes it is: odometry corrected by matching the planar scanner to the robot map.

A Gauss-Newton step on the likelihood field of the map's obstacles, with the odometry prediction as prior, so that a
corridor corrects only across itself and a crowd of unknown obstacles corrects nothing.
"""

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from perception.grids import Cell, Grid

Pose = tuple[float, float, float]
Array = NDArray[np.float64]

_KERNEL, _FAR = 0.05, 2.0
_ITERATIONS = 4
_HITS_USED = 360
_HIT_INFORMATION = 0.4
_MIN_AGREEMENT = 0.2
_MAX_CORRECTION = 0.15
_STEP_BACK = 0.15
_KNOWN_FREE_WEIGHT, _UNKNOWN_WEIGHT = 1.0, 0.1
_START_SIGMA = np.array([0.03, 0.03, np.deg2rad(1.0)])
_PER_METRE = np.array([0.06, 0.06, np.deg2rad(1.5)])
_PER_RADIAN = np.array([0.01, 0.01, 0.03])
_LOST_SIGMA = 0.4


class Localiser:
    """Keeps ``map_from_base`` as (x, y, yaw) with its covariance.

    Args:
        robot_map: of :class:`~perception.grids.Cell`.
        pose: (x, y, yaw) in the map at the start.
    """

    def __init__(self, robot_map: Grid, pose: Pose) -> None:
        self.pose = pose
        self.agreement = 1.0
        self._covariance = np.diag(_START_SIGMA**2)
        self._use_map(robot_map)

    def _use_map(self, robot_map: Grid) -> None:
        obstacle = robot_map.data == Cell.OBSTACLE
        distance = cv2.distanceTransform((~obstacle).astype(np.uint8), cv2.DIST_L2, 5) * robot_map.resolution
        # Far from anything it is 0 whatever the distance, and without any obstacle OpenCV has no finite one.
        self._field = np.exp(-0.5 * (np.minimum(distance, _FAR) / _KERNEL) ** 2).astype(np.float32)
        weights = np.full(robot_map.shape, _UNKNOWN_WEIGHT, np.float32)
        weights[robot_map.data == Cell.FREE] = _KNOWN_FREE_WEIGHT
        weights[obstacle] = 0.0
        self._weights = weights
        self._origin, self._resolution = np.asarray(robot_map.origin, float), robot_map.resolution

    @property
    def sigma(self) -> float:
        """Largest standard deviation of the position, metres."""
        return float(np.sqrt(np.linalg.eigvalsh(self._covariance[:2, :2])[-1]))

    @property
    def lost(self) -> bool:
        return self.sigma > _LOST_SIGMA

    def predict(self, before: Pose, after: Pose) -> None:
        """Move by what the odometry says between two poses in its own frame."""
        cos, sin = np.cos(before[2]), np.sin(before[2])
        dx, dy = after[0] - before[0], after[1] - before[1]
        forward, left = cos * dx + sin * dy, cos * dy - sin * dx
        turn = _wrap(after[2] - before[2])
        x, y, yaw = self.pose
        cos, sin = np.cos(yaw), np.sin(yaw)
        moved_x, moved_y = cos * forward - sin * left, sin * forward + cos * left
        self.pose = float(x + moved_x), float(y + moved_y), _wrap(yaw + turn)
        jacobian = np.array([[1.0, 0.0, -moved_y], [0.0, 1.0, moved_x], [0.0, 0.0, 1.0]])
        distance = float(np.hypot(forward, left))
        # Variances grow in proportion to the way, so that many small steps cost as much as one long one.
        noise = _PER_METRE**2 * distance + _PER_RADIAN**2 * abs(turn)
        self._covariance = jacobian @ self._covariance @ jacobian.T + np.diag(noise)

    def correct(self, hits: Array) -> bool:
        """Match points ``(N, 2)`` in base_link to the map; False if the match was not believed."""
        prior = np.linalg.inv(self._covariance)
        pose, information, self.agreement = _match(
            hits[:: max(1, len(hits) // _HITS_USED)],
            np.array(self.pose),
            prior,
            self._field,
            self._weights,
            self._origin,
            self._resolution,
        )
        moved = np.hypot(pose[0] - self.pose[0], pose[1] - self.pose[1])
        if self.agreement < _MIN_AGREEMENT or not moved < _MAX_CORRECTION:
            return False
        self.pose = float(pose[0]), float(pose[1]), _wrap(float(pose[2]))
        self._covariance = np.linalg.inv(information)
        return True


def _wrap(angle: float) -> float:
    return float(np.arctan2(np.sin(angle), np.cos(angle)))


@njit(cache=True)
def _sample(field: NDArray[np.float32], column: float, row: float) -> tuple[float, float, float]:
    """Bilinear value and its derivatives along column and row, cell centres at integers; 0 outside."""
    c, r = int(np.floor(column)), int(np.floor(row))
    if c < 0 or r < 0 or c + 1 >= field.shape[1] or r + 1 >= field.shape[0]:
        return 0.0, 0.0, 0.0
    a, b = column - c, row - r
    low = field[r, c] * (1 - a) + field[r, c + 1] * a
    high = field[r + 1, c] * (1 - a) + field[r + 1, c + 1] * a
    along = (field[r, c + 1] - field[r, c]) * (1 - b) + (field[r + 1, c + 1] - field[r + 1, c]) * b
    return low * (1 - b) + high * b, along, high - low


@njit(cache=True)
def _match(
    hits: Array,
    guess: Array,
    prior: Array,
    field: NDArray[np.float32],
    weights: NDArray[np.float32],
    origin: Array,
    resolution: float,
) -> tuple[Array, Array, float]:
    """Pose that maximises likelihood and prior, its information matrix, and the mean likelihood of the usable hits."""
    pose = guess.copy()
    information = prior.copy()
    agreement = 0.0
    for _ in range(_ITERATIONS):
        information = prior.copy()
        gradient = prior @ (guess - pose)
        cos, sin = np.cos(pose[2]), np.sin(pose[2])
        total, likely = 1e-9, 0.0
        for i in range(len(hits)):
            px, py = cos * hits[i, 0] - sin * hits[i, 1], sin * hits[i, 0] + cos * hits[i, 1]
            column = (pose[0] + px - origin[0]) / resolution - 0.5
            row = (pose[1] + py - origin[1]) / resolution - 0.5
            # A hit that the beam reaches through cells the map does not know is on a face the map may not have.
            back = _STEP_BACK / max(np.hypot(px, py), _STEP_BACK) / resolution
            c, r = int(np.rint(column - px * back)), int(np.rint(row - py * back))
            if c < 0 or r < 0 or c >= field.shape[1] or r >= field.shape[0]:
                continue
            weight = weights[r, c]
            if weight == 0.0:
                continue
            value, along, across = _sample(field, column, row)
            jx, jy = along / resolution, across / resolution
            jt = jy * px - jx * py
            w = weight * _HIT_INFORMATION
            residual = 1.0 - value
            jacobian = (jx, jy, jt)
            for k in range(3):
                gradient[k] += w * jacobian[k] * residual
                for m in range(3):
                    information[k, m] += w * jacobian[k] * jacobian[m]
            total += weight
            likely += weight * value
        agreement = likely / total
        pose += np.linalg.solve(information, gradient)
    return pose, information, agreement
