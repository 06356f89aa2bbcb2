"""Drives a path leg by leg: turns on the spot and regulated pure pursuit, forwards or backwards."""

import numpy as np
from numpy.typing import NDArray

from drivers.simulated.planner import Leg, Path, Pose
from drivers.simulated.profile import BaseProfile

Command = tuple[float, float]
"""Speed (m/s) and turn rate (rad/s)."""

_LOOKAHEAD_MIN, _LOOKAHEAD_TIME = 0.14, 0.5
_ALIGNED = np.deg2rad(12.0)
_TURNED = np.deg2rad(0.8)
_ARRIVED = 0.012
_CREEP = 0.03
_CREEP_TURN = 0.04
_BRAKING_SHARE = 0.5
_GAIN_OF_SPACE, _SPEED_WITHOUT_SPACE = 0.9, 0.14


class Follower:
    """Follows one path; asked for a command at every step until :attr:`done`."""

    def __init__(self, path: Path, profile: BaseProfile) -> None:
        self.path = path
        self._profile = profile
        self._legs = list(path.legs)
        self._aligned = False
        self._progress = 0.0
        self.driven = 0.0

    @property
    def done(self) -> bool:
        return not self._legs

    @property
    def fraction(self) -> float:
        """Share of the path's length that lies behind."""
        return min(1.0, (self.driven + self._progress) / max(self.path.length, 1e-6))

    def ahead(self, distance: float) -> NDArray[np.float64]:
        """Poses ``(N, 3)`` of the path within a distance in front of the robot, metres."""
        steps = np.linalg.norm(np.diff(self.path.poses[:, :2], axis=0), axis=1)
        along = np.concatenate([[0.0], np.cumsum(steps)]) - (self.driven + self._progress)
        return self.path.poses[(along > -0.01) & (along < distance)]

    def command(self, pose: Pose, space: float) -> Command:
        """What to do at a pose in the map, with so many metres between the footprint and the nearest hit."""
        while self._legs:
            leg = self._legs[0]
            command = self._turn(pose, leg.yaw, _TURNED) if leg.direction == 0 else self._run(leg, pose, space)
            if command is not None:
                return command
            if leg.direction:
                self.driven += float(np.linalg.norm(np.diff(leg.points, axis=0), axis=1).sum())
            self._legs.pop(0)
            self._aligned, self._progress = False, 0.0
        return 0.0, 0.0

    def _turn(self, pose: Pose, yaw: float, tolerance: float) -> Command | None:
        error = _wrap(yaw - pose[2])
        if abs(error) < tolerance:
            return None
        braking = np.sqrt(2 * _BRAKING_SHARE * self._profile.turn_acceleration * abs(error))
        rate = min(self._profile.turn_rate, _CREEP_TURN + float(braking) * min(1.0, abs(error) / 0.15))
        return 0.0, float(np.copysign(rate, error))

    def _run(self, leg: Leg, pose: Pose, space: float) -> Command | None:
        facing = pose[2] if leg.direction > 0 else pose[2] + np.pi
        self._progress, remaining, length = _locate(leg.points, pose, self._progress)
        if remaining < _ARRIVED:
            return None
        # Short of space it goes slowly and looks less far ahead, which cuts the corners less.
        cruise = min(self._profile.speed, _SPEED_WITHOUT_SPACE + _GAIN_OF_SPACE * max(space, 0.0))
        lookahead = max(_LOOKAHEAD_MIN, _LOOKAHEAD_TIME * cruise)
        target = _point_at(leg.points, self._progress + lookahead)
        dx, dy = target[0] - pose[0], target[1] - pose[1]
        bearing = _wrap(float(np.arctan2(dy, dx)) - facing)
        if not self._aligned and length > lookahead:
            command = self._turn(pose, pose[2] + bearing, _ALIGNED)
            if command is not None:
                return command
        self._aligned = True
        curvature = 2 * np.sin(bearing) / max(float(np.hypot(dx, dy)), 0.1)
        speed = min(
            cruise,
            _CREEP + float(np.sqrt(2 * _BRAKING_SHARE * self._profile.acceleration * remaining)) * 0.8,
            self._profile.turn_rate / max(abs(curvature), 1e-6),
        )
        speed *= max(0.0, float(np.cos(bearing)))
        return leg.direction * speed, float(np.clip(curvature, -4.0, 4.0)) * max(speed, _CREEP)


def _locate(points: NDArray[np.float64], pose: Pose, progress: float) -> tuple[float, float, float]:
    """Metres along the polyline nearest to the pose (never behind ``progress``), what remains, and its length."""
    steps = np.diff(points, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    starts = np.concatenate([[0.0], np.cumsum(lengths)])
    offset = np.asarray(pose[:2]) - points[:-1]
    along = np.einsum("ij,ij->i", offset, steps) / np.maximum(lengths, 1e-9)
    beyond = along[-1] - lengths[-1]
    along = np.clip(along, 0.0, lengths)
    gaps = np.linalg.norm(offset - steps * (along / np.maximum(lengths, 1e-9))[:, None], axis=1)
    # The path may come by the same place twice: look only a little ahead of where it was last.
    reachable = (starts[:-1] <= progress + 0.5) & (starts[1:] >= progress - 1e-6)
    nearest = int(np.argmin(np.where(reachable, gaps, np.inf)))
    now = max(progress, float(starts[nearest] + along[nearest]))
    total = float(starts[-1])
    return now, -1.0 if beyond > 0 and nearest == len(steps) - 1 else total - now, total


def _point_at(points: NDArray[np.float64], distance: float) -> NDArray[np.float64]:
    """The point so many metres along the polyline, which goes on straight beyond its end."""
    steps = np.diff(points, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    ends = np.cumsum(lengths)
    leg = min(int(np.searchsorted(ends, distance)), len(steps) - 1)
    within = distance - (ends[leg] - lengths[leg])
    return points[leg] + steps[leg] * (within / max(lengths[leg], 1e-9))


def _wrap(angle: float) -> float:
    return float(np.arctan2(np.sin(angle), np.cos(angle)))
