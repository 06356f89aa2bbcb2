"""3DTK ``.3d`` with ``.pose``: text, centimetres and degrees of a left-handed frame (x right, y up, z ahead)."""

from pathlib import Path

import numpy as np

from drivers.recorded.raw import RawScan, broken, raw_scan
from drivers.recorded.text import numbers
from perception import transforms
from perception.transforms import Matrix

SUFFIXES = (".3d",)
_RANGES = (0.4, 20.0)
"""Metres; what 3DTK's scanners report nearer or further is no return."""
_RIGHT_FROM_LEFT_HANDED = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


def read(path: Path) -> list[RawScan]:
    """The one scan of a file, in metres of a right-handed frame, with the pose beside it if there is one."""
    points = numbers(path, 3) @ _RIGHT_FROM_LEFT_HANDED.T / 100
    ranges = np.linalg.norm(points, axis=1)
    returned = points[(ranges > _RANGES[0]) & (ranges < _RANGES[1])]
    return [raw_scan(returned, path, _pose(path.with_suffix(".pose")))]


def _pose(path: Path) -> Matrix | None:
    """Position and Euler angles, ``R = Rx Ry Rz``."""
    if not path.exists():
        return None
    try:
        values = np.loadtxt(path).ravel()
    except ValueError as error:
        broken(path, "pose", "6 numbers", str(error))
    if values.shape != (6,) or not np.isfinite(values).all():
        broken(path, "pose", "6 numbers", f"{len(values)}: {values.tolist()}")
    x, y, z = (transforms.from_euler(*angles)[:3, :3] for angles in np.diag(np.deg2rad(values[3:])))
    pose = np.eye(4)
    change = _RIGHT_FROM_LEFT_HANDED
    pose[:3, :3] = change @ (x @ y @ z) @ change.T
    pose[:3, 3] = change @ values[:3] / 100
    return pose
