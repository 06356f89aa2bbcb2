"""Stages that give a scan its place: is it a scan, how was it tilted, where was it taken."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mission.stages.scan_library import Library, PlacedScans, matrix
from perception import alignment, global_registration, registration, transforms
from perception.findings import Alignment, Registration
from perception.registration import Reference
from perception.transforms import Matrix

_NEARBY = 20.0
_MOUNTING = 0.2
"""How far the floor may be from where the scanner's mounting puts it, metres: tilt, and a step on the way."""
_ANY_HEIGHT = (0.2, 2.2)


@dataclass(frozen=True)
class ScanSummary:
    """What the tree needs to know of a valid scan."""

    points: int
    dropped: int
    return_share: float
    median_range: float
    base_from_scanner: Matrix


def warm_up(library: Library) -> None:
    """Load what takes long to load, while the first scan is being taken."""
    import open3d  # noqa: F401


def validate_scan(library: Library, scan_id: str) -> ScanSummary:
    valid = library.valid(scan_id)
    scan = valid.scan
    return ScanSummary(len(scan.points), valid.dropped, valid.return_share, valid.median_range, scan.base_from_scanner)


def align_scan(library: Library, scan_id: str) -> Alignment:
    scan = library.scan(scan_id)
    mounted = float(scan.base_from_scanner[2, 3])
    heights = (mounted - _MOUNTING, mounted + _MOUNTING) if mounted > _MOUNTING else _ANY_HEIGHT
    return alignment.align(scan.points, scanner_heights=heights)


def anchor_scan(library: Library, scan_id: str) -> Registration:
    """The map frame: level, its floor at zero, its axes along the first room's walls."""
    found = align_scan(library, scan_id)
    library.surface(scan_id)
    return registration.anchor(transforms.planar(0.0, 0.0, -found.wall_yaw) @ found.level_from_scanner)


def register_scan(
    library: Library,
    scan_id: str,
    guess: Sequence[Sequence[float]],
    reference: PlacedScans,
    error_m: float,
    error_rad: float,
) -> Registration:
    pose = matrix(guess)
    found = registration.register(library.surface(scan_id), _reference(library, reference, pose), pose)
    registration.judge(found, (error_m, error_rad), registration.NEAR_ODOMETRY)
    return found


def register_globally(
    library: Library,
    scan_id: str,
    guess: Sequence[Sequence[float]],
    reference: PlacedScans,
    error_m: float,
    error_rad: float,
) -> Registration:
    pose = matrix(guess)
    found = global_registration.register_globally(
        library.surface(scan_id), _reference(library, reference, pose), pose, radius=error_m, yaw=error_rad
    )
    registration.judge(found, (error_m, error_rad))
    return found


def _reference(library: Library, placed: PlacedScans, guess: Matrix) -> Reference:
    scans = [(library.surface(name), matrix(pose)) for name, pose in placed]
    near = (float(guess[0, 3]), float(guess[1, 3]))
    close = [(surface, pose) for surface, pose in scans if np.hypot(*(pose[:2, 3] - near)) < 2 * _NEARBY]
    return registration.reference_from(close or scans, near, _NEARBY)
