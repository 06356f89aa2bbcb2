"""Search without a heading: ours (every yaw, x and y) against Open3D's FPFH with RANSAC and with FGR.

All begin with thinned clouds; a pose is right within 5 cm and half a degree. Every candidate is then refined and judged
by our own registration, so that only the search differs. Ours is told the place to 3 m, as a mission knows it, and may
answer that two places fit alike; the others search everywhere.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import permutations
from typing import Any

import numpy as np
import open3d as o3d

from benchmarks.data import largest_room
from perception import global_registration, registration, transforms
from perception.failure import FailureError
from perception.matching.surfels import Surface
from perception.registration import Reference
from perception.transforms import Matrix

RIGHT = (0.05, float(np.deg2rad(0.5)))
SEARCHED = (3.0, float(np.pi))
_VOXEL = 0.10
_FPFH = o3d.pipelines.registration


@dataclass(frozen=True)
class Case:
    """Two scans of a room, thinned both ways, and the truth."""

    known: Surface
    new: Surface
    known_cloud: o3d.geometry.PointCloud
    new_cloud: o3d.geometry.PointCloud
    truth: Matrix
    near: Matrix

    @property
    def reference(self) -> Reference:
        return registration.reference_from([(self.known, np.eye(4))])


@dataclass(frozen=True)
class Trial:
    """Right before refining (None if not asked), right after, accepted though wrong, seconds of the processor."""

    before: bool | None
    after: bool
    false_accept: bool
    seconds: float


def ours(case: Case) -> Trial:
    began = time.process_time()
    try:
        found = global_registration.register_globally(case.new, case.reference, case.near, *SEARCHED)
        registration.judge(found, SEARCHED)
    except FailureError:
        return Trial(None, False, False, time.process_time() - began)
    right = _is_right(case.truth, found.map_from_scanner)
    return Trial(None, right, not right, time.process_time() - began)


def ransac(case: Case) -> Trial:
    o3d.utility.random.seed(0)
    return _by_features(
        case,
        lambda new, known, features: (
            _FPFH.registration_ransac_based_on_feature_matching(
                new,
                known,
                *features,
                True,
                1.5 * _VOXEL,
                _FPFH.TransformationEstimationPointToPoint(False),
                3,
                [
                    _FPFH.CorrespondenceCheckerBasedOnEdgeLength(0.9),
                    _FPFH.CorrespondenceCheckerBasedOnDistance(1.5 * _VOXEL),
                ],
                _FPFH.RANSACConvergenceCriteria(100_000, 0.999),
            ).transformation
        ),
    )


def fast_global(case: Case) -> Trial:
    o3d.utility.random.seed(0)
    option = _FPFH.FastGlobalRegistrationOption(maximum_correspondence_distance=0.5 * _VOXEL)
    return _by_features(
        case,
        lambda new, known, features: (
            _FPFH.registration_fgr_based_on_feature_matching(new, known, *features, option).transformation
        ),
    )


CONTENDERS: dict[str, Callable[[Case], Trial]] = {
    "ours, every yaw, x, y": ours,
    "FPFH + RANSAC": ransac,
    "FPFH + FGR": fast_global,
}


def _by_features(case: Case, match: Callable[..., Any]) -> Trial:
    began = time.process_time()
    radius = o3d.geometry.KDTreeSearchParamHybrid(radius=5 * _VOXEL, max_nn=100)
    features = [_FPFH.compute_fpfh_feature(cloud, radius) for cloud in (case.new_cloud, case.known_cloud)]
    guess = np.asarray(match(case.new_cloud, case.known_cloud, features))
    found = registration.register(case.new, case.reference, guess)
    seconds = time.process_time() - began
    after = _is_right(case.truth, found.map_from_scanner)
    try:
        registration.judge(found, SEARCHED)
        accepted = True
    except FailureError:
        accepted = False
    return Trial(_is_right(case.truth, guess), after and accepted, accepted and not after, seconds)


def _is_right(truth: Matrix, pose: Matrix) -> bool:
    metres, radians = transforms.difference(truth, pose)
    return metres <= RIGHT[0] and radians <= RIGHT[1]


def cases(count: int) -> list[Case]:
    """Ordered pairs of the largest room's scans with a place wrong by up to 2 m and any heading."""
    views = [
        (registration.surface_of(view.scan.points), _thinned(view.scan.points), view.map_from_scanner)
        for view in largest_room()
    ]
    rng = np.random.default_rng(0)
    found = []
    for known, new in list(permutations(views, 2))[:count]:
        truth = transforms.inverse(known[2]) @ new[2]
        # The heading is turned about the upright of the known scan, which stands level to a degree.
        near = transforms.planar(0, 0, rng.uniform(-np.pi, np.pi)) @ truth
        near[:3, 3] = truth[:3, 3] + [*rng.uniform(-1.4, 1.4, 2), 0.0]
        found.append(Case(known[0], new[0], known[1], new[1], truth, near))
    return found


def _thinned(points: np.ndarray) -> o3d.geometry.PointCloud:
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points.astype(np.float64))).voxel_down_sample(_VOXEL)
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=3 * _VOXEL, max_nn=30))
    cloud.orient_normals_towards_camera_location()
    return cloud


def rows(count: int = 20) -> list[dict[str, Any]]:
    """One row per contender over the same cases."""
    trials: dict[str, list[Trial]] = {name: [] for name in CONTENDERS}
    for case in cases(count):
        for name, contender in CONTENDERS.items():
            trials[name].append(contender(case))
    return [_row(name, found) for name, found in trials.items()]


def _row(name: str, trials: list[Trial]) -> dict[str, Any]:
    before = [trial.before for trial in trials if trial.before is not None]
    return {
        "contender": name,
        "cases": len(trials),
        "right_before": sum(before) if before else None,
        "right": sum(trial.after for trial in trials),
        "false_accepts": sum(trial.false_accept for trial in trials),
        "processor_s": float(np.median([trial.seconds for trial in trials])),
    }


def table(found: list[dict[str, Any]]) -> str:
    lines = [
        "| search | cases | right before refining | right and accepted | accepted wrong | processor s |",
        "|---|---|---|---|---|---|",
    ]
    for row in found:
        before = "-" if row["right_before"] is None else row["right_before"]
        lines.append(
            f"| {row['contender']} | {row['cases']} | {before} | {row['right']} | {row['false_accepts']} "
            f"| {row['processor_s']:.1f} |"
        )
    return "\n".join(lines)
