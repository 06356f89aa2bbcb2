"""Scans that somebody else took, read from a folder: 3DTK ``.3d`` with ``.pose``, PLY and PCD.

Such files hold points and no beams; the beams are found again by direction, so that the later stages know where the
scanner looked and where nothing came back.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from perception import transforms
from perception.failure import FailureError
from perception.scan import BeamPattern, Scan
from perception.transforms import Matrix

CLOUDS = (".3d", ".ply", ".pcd")
_STEPS_DEG = (0.1, 0.2, 0.25, 0.4, 0.5, 1.0)
_FILL = 0.6
_KEPT = 0.95
_3DTK_RANGES = (0.4, 20.0)
_RIGHT_FROM_LEFT_HANDED = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])


@dataclass(frozen=True)
class Recorded:
    """A scan of a folder, and where its taker says it was taken: ``world_from_scanner`` 4x4, None where he does not."""

    scan: Scan
    world_from_scanner: Matrix | None


def read_folder(folder: Path) -> list[Recorded]:
    """All scans of a folder in the order of their names.

    Raises:
        FailureError: ``RECORDED_NONE`` when the folder holds no such file, ``RECORDED_BROKEN`` when one cannot be read.
    """
    files = sorted(path for path in folder.iterdir() if path.suffix.lower() in CLOUDS)
    if not files:
        raise FailureError("RECORDED_NONE", f"{folder}: expected files {', '.join(CLOUDS)}, found none")
    return [_read(path, f"S{number:02d}") for number, path in enumerate(files, 1)]


def scan_of(points: NDArray[np.floating], scan_id: str) -> Scan:
    """A scan out of bare points ``(N, 3)`` in the scanner's frame: one point a beam, the nearest one.

    The pattern's step is the finest that the points still fill.
    """
    ranges = np.linalg.norm(points, axis=1)
    pattern = _pattern(points, ranges)
    beam = pattern.beams_towards(points)
    order = np.lexsort((ranges, beam))
    order = order[beam[order] >= 0]
    _, first = np.unique(beam[order], return_index=True)
    kept = order[first]
    ones = np.ones(len(kept), np.float32)
    return Scan(scan_id, points[kept].astype(np.float32), ones, beam[kept], pattern, np.eye(4), np.eye(4))


def _read(path: Path, scan_id: str) -> Recorded:
    try:
        is_3dtk = path.suffix.lower() == ".3d"
        points = _read_3dtk(path) if is_3dtk else _read_cloud(path)
        if len(points) == 0:
            raise ValueError("expected points, found none")
        return Recorded(scan_of(points, scan_id), _read_3dtk_pose(path.with_suffix(".pose")) if is_3dtk else None)
    except (ValueError, OSError) as error:
        raise FailureError("RECORDED_BROKEN", f"{path}: {error}") from error


def _read_cloud(path: Path) -> NDArray[np.float64]:
    import open3d as o3d

    points = np.asarray(o3d.io.read_point_cloud(path).points)
    return points[np.isfinite(points).all(axis=1)]


def _read_3dtk(path: Path) -> NDArray[np.float64]:
    """Points in metres, right-handed; what is nearer or further than the scanner measures is no return."""
    points = np.loadtxt(path, usecols=(0, 1, 2), ndmin=2) @ _RIGHT_FROM_LEFT_HANDED.T / 100
    ranges = np.linalg.norm(points, axis=1)
    return points[(ranges > _3DTK_RANGES[0]) & (ranges < _3DTK_RANGES[1])]


def _read_3dtk_pose(path: Path) -> Matrix | None:
    """Position and Euler angles in centimetres and degrees of a left-handed frame, ``R = Rx Ry Rz``."""
    if not path.exists():
        return None
    values = np.loadtxt(path).ravel()
    if values.shape != (6,):
        raise ValueError(f"{path}: expected 6 numbers, found {len(values)}")
    angles = np.diag(np.deg2rad(values[3:]))
    x, y, z = (transforms.from_euler(*angle)[:3, :3] for angle in angles)
    pose = np.eye(4)
    change = _RIGHT_FROM_LEFT_HANDED
    pose[:3, :3] = change @ (x @ y @ z) @ change.T
    pose[:3, 3] = change @ values[:3] / 100
    return pose


def _pattern(points: NDArray[np.floating], ranges: NDArray[np.floating]) -> BeamPattern:
    elevation = np.arctan2(points[:, 2], np.hypot(points[:, 0], points[:, 1]))
    low, high = (float(value) for value in np.quantile(elevation, (0.0005, 0.9995)))
    limits = (max(0.0, float(ranges.min()) * 0.999), float(ranges.max()) * 1.001)
    patterns = [BeamPattern.with_step(np.deg2rad(step), (low, high), limits) for step in _STEPS_DEG]
    last = len(patterns) - 1
    index = next((i for i, pattern in enumerate(patterns) if _fill(pattern, points) > _FILL), last)
    finest, coarser = patterns[index], patterns[min(index + 1, last)]
    # A grid of 0.5 degrees fills most of one of 0.4 as well; in its own, no two of its points meet.
    return coarser if _returned(coarser, points).size > _KEPT * _returned(finest, points).size else finest


def _returned(pattern: BeamPattern, points: NDArray[np.floating]) -> NDArray[np.int32]:
    """Beams that some point lies in."""
    beams = np.unique(pattern.beams_towards(points))
    return beams[beams >= 0]


def _fill(pattern: BeamPattern, points: NDArray[np.floating]) -> float:
    """Share of the beams that returned, in the columns that the scanner looked at."""
    returned = _returned(pattern, points)
    looked_at = np.unique(returned % pattern.columns).size
    return returned.size / max(looked_at * pattern.rows, 1)
