"""Stages that give a scan its place: is it a scan, how was it tilted, where was it taken."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace

import numpy as np

from mission.journal import plain
from mission.stages.scan_library import Library, PlacedScans, matrix
from mission.store import RunFolder, write_text
from mission.summaries import ScanSummary
from perception import alignment, global_registration, movement, pose_graph, registration, transforms
from perception.failure import FailureError
from perception.findings import Alignment, Movement, PoseAdjustment, Registration, RoomShape
from perception.pose_graph import Comparison
from perception.registration import Reference
from perception.transforms import Matrix

_NEARBY = 20.0
_MOUNTING = 0.2
"""How far the floor may be from where the scanner's mounting puts it, metres: tilt, and a step on the way."""
_ANY_HEIGHT = (0.2, 2.2)
_LOOKED_AT = 200_000
"""Points of a scan in which movement is looked for: enough to count a person in hundreds."""


def validate_scan(library: Library, scan_id: str) -> ScanSummary:
    scan, found = library.scan(scan_id), library.verdict(scan_id)
    return ScanSummary(len(scan.points), found.dropped, found.return_share, found.median_range, scan.base_from_scanner)


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
    surface, known = library.surface(scan_id), _reference(library, reference, pose)
    found = registration.register(surface, known, pose)
    registration.judge(found, (error_m, error_rad), registration.NEAR_ODOMETRY)
    global_registration.challenge(found, surface, known, pose, (error_m, error_rad))
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


def find_movement(
    library: Library, scan_id: str, pose: Sequence[Sequence[float]], earlier: PlacedScans, shape: RoomShape
) -> Movement:
    points = library.scan(scan_id).points
    views = [(library.surface(name), matrix(place)) for name, place in earlier]
    return movement.find_movement(points[:: len(points) // _LOOKED_AT + 1], matrix(pose), views, shape)


def optimise_poses(library: Library, scans: PlacedScans) -> PoseAdjustment:
    """All poses by all pairs that see the same surface; a pair that was compared before is not compared again."""
    poses = {name: matrix(pose) for name, pose in scans}
    footprints = {name: pose_graph.footprint(library.surface(name), pose) for name, pose in poses.items()}
    known = _read_comparisons(library.run)
    fitted, refused = [], []
    for target, source in pose_graph.pairs_to_compare(footprints):
        try:
            fitted.append(known.get((target, source)) or _compare(library, target, source, poses))
        except FailureError as error:
            refused.append((target, source, error.failure.code))
    write_text(library.run.comparisons, json.dumps([asdict(pair) for pair in fitted], default=plain))
    return replace(pose_graph.optimise(poses, fitted), refused=tuple(refused))


def _compare(library: Library, target: str, source: str, poses: Mapping[str, Matrix]) -> Comparison:
    target_from_source = transforms.inverse(poses[target]) @ poses[source]
    return pose_graph.compare((target, library.surface(target)), (source, library.surface(source)), target_from_source)


def _read_comparisons(run: RunFolder) -> dict[tuple[str, str], Comparison]:
    if not run.comparisons.exists():
        return {}
    rows = json.loads(run.comparisons.read_text(encoding="utf-8"))
    arrays = ("target_from_source", "information")
    pairs = [Comparison(**row | {name: np.array(row[name]) for name in arrays}) for row in rows]
    return {(pair.target, pair.source): pair for pair in pairs}


def _reference(library: Library, placed: PlacedScans, guess: Matrix) -> Reference:
    scans = [(library.surface(name), matrix(pose)) for name, pose in placed]
    near = (float(guess[0, 3]), float(guess[1, 3]))
    close = [(surface, pose) for surface, pose in scans if np.hypot(*(pose[:2, 3] - near)) < 2 * _NEARBY]
    return registration.reference_from(close or scans, near, _NEARBY)
