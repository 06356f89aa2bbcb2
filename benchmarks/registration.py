"""Registration of one scan to another at five million points a scan: ours, Open3D's pipeline, small_gicp.

    python -m benchmarks.registration [--pairs 10] [--global-cases 20]

All contenders begin with both raw clouds and the same guess, one after the other on each pair, so that a busy machine
is busy for all of them. A second table compares the searches without a trustworthy guess.
"""

import argparse
import multiprocessing
import time
from collections.abc import Callable, Iterable
from itertools import combinations
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
import open3d as o3d
import small_gicp
from numpy.typing import NDArray

from benchmarks import global_search
from benchmarks.data import Placed, largest_room
from perception import registration, transforms
from perception.transforms import Matrix

Points = NDArray[np.float32]
Contender = Callable[[Points, Points, Matrix], Matrix]
"""Takes the known cloud, the new one (each in its scanner's frame) and a guess; gives ``known_from_new``."""

_THREADS = 2


def ours(known: Points, new: Points, guess: Matrix) -> Matrix:
    """Both scans thinned, though in a mission the known ones were when they came."""
    reference = registration.reference_from([(registration.surface_of(known), np.eye(4))])
    return registration.register(registration.surface_of(new), reference, guess).map_from_scanner


def ours_as_in_a_mission(known: Points) -> Contender:
    """What one more scan costs when the surface of the earlier ones is kept."""
    kept = registration.surface_of(known)

    def contender(_: Points, new: Points, guess: Matrix) -> Matrix:
        reference = registration.reference_from([(kept, np.eye(4))])
        return registration.register(registration.surface_of(new), reference, guess).map_from_scanner

    return contender


def open3d_pipeline(known: Points, new: Points, guess: Matrix) -> Matrix:
    """Voxels of 10 and of 5 cm, normals, point-to-plane ICP within 50 and within 10 cm."""
    pose = guess
    for voxel, distance in ((0.10, 0.50), (0.05, 0.10)):
        target, source = (_thinned_by_open3d(points, voxel) for points in (known, new))
        loss = o3d.pipelines.registration.TukeyLoss(k=distance)
        pose = o3d.pipelines.registration.registration_icp(
            source,
            target,
            distance,
            pose,
            o3d.pipelines.registration.TransformationEstimationPointToPlane(loss),
            o3d.pipelines.registration.ICPConvergenceCriteria(max_iteration=40),
        ).transformation
    return np.asarray(pose)


def small_gicp_pipeline(known: Points, new: Points, guess: Matrix) -> Matrix:
    """Voxels of 5 cm, covariances, generalised ICP within 50 and within 10 cm."""
    (target, tree), (source, _) = (
        small_gicp.preprocess_points(points.astype(np.float64), 0.05, num_threads=_THREADS) for points in (known, new)
    )
    pose = guess
    for distance in (0.50, 0.10):
        pose = small_gicp.align(
            target,
            source,
            tree,
            pose,
            registration_type="GICP",
            max_correspondence_distance=distance,
            num_threads=_THREADS,
            max_iterations=40,
            rotation_epsilon=1e-5,
            translation_epsilon=1e-5,
        ).T_target_source
    return np.asarray(pose)


OURS = "ours, both clouds"
MISSION = "ours, new cloud only"
CONTENDERS: dict[str, Contender] = {
    OURS: ours,
    "Open3D pipeline": open3d_pipeline,
    "small_gicp": small_gicp_pipeline,
}


def odometry_guess(truth: Matrix, rng: np.random.Generator) -> Matrix:
    """Wrong as odometry is after some metres: sigma 0.15 m and 3 degrees; tilt and height are measured."""
    guess: Matrix = truth @ transforms.from_euler(*rng.normal(0, np.deg2rad(0.05), 2), rng.normal(0, np.deg2rad(3)))
    guess[:3, 3] += [*rng.normal(0, 0.15, 2), rng.normal(0, 0.005)]
    return guess


def rows(pairs: int = 10, memory: bool = True) -> list[dict[str, Any]]:
    """One row per contender: median seconds (wall and processor), errors, ratio of ours, peak memory."""
    views = list(largest_room())
    runs: dict[str, list[tuple[float, float, float, float]]] = {name: [] for name in (*CONTENDERS, MISSION)}
    for number, (known, new) in enumerate(list(combinations(views, 2))[:pairs]):
        truth = transforms.inverse(known.map_from_scanner) @ new.map_from_scanner
        guess = odometry_guess(truth, np.random.default_rng(number))
        for name, contender in (*CONTENDERS.items(), (MISSION, ours_as_in_a_mission(known.scan.points))):
            if number == 0:
                contender(known.scan.points[::20], new.scan.points[::20], guess)
            runs[name].append(_timed(contender, known.scan.points, new.scan.points, guess, truth))
    own = np.median([run[:2] for run in runs[OURS]], axis=0)
    peaks = {name: peak_memory(name, views[:2]) for name in CONTENDERS} if memory else {}
    return [_row(name, np.array(found), own, peaks.get(name)) for name, found in runs.items()]


def _timed(contender: Contender, known: Points, new: Points, guess: Matrix, truth: Matrix) -> tuple[float, ...]:
    wall, processor = time.perf_counter(), time.process_time()
    pose = contender(known, new, guess)
    seconds = time.perf_counter() - wall, time.process_time() - processor
    return *seconds, *transforms.difference(truth, pose)


def _row(name: str, runs: NDArray[np.float64], own: NDArray[np.float64], peak: float | None) -> dict[str, Any]:
    wall, processor, distance, angle = np.median(runs, axis=0)
    return {
        "stage": "register",
        "contender": name,
        "wall_s": wall,
        "processor_s": processor,
        "ours_to_it": own[0] / wall,
        "ours_to_it_processor": own[1] / processor,
        "error_mm": 1000 * distance,
        "error_deg": np.rad2deg(angle),
        "worst_mm": 1000 * runs[:, 2].max(),
        "worst_deg": np.rad2deg(runs[:, 3].max()),
        "peak_mb": peak,
    }


def peak_memory(name: str, views: Iterable[Placed]) -> float:
    """Megabytes that a contender needs over the two clouds, in a process of its own."""
    known, new = views
    truth = transforms.inverse(known.map_from_scanner) @ new.map_from_scanner
    given = known.scan.points, new.scan.points, odometry_guess(truth, np.random.default_rng(0))
    spawning = multiprocessing.get_context("spawn")
    answer, telling = spawning.Pipe(duplex=False)
    process = spawning.Process(target=_tell_peak, args=(name, *given, telling), daemon=True)
    process.start()
    telling.close()
    peak: float = answer.recv()
    # Open3D's threads may keep a process from ending by itself.
    process.kill()
    return peak


def _tell_peak(name: str, known: Points, new: Points, guess: Matrix, answer: Connection) -> None:
    CONTENDERS[name](known[::50], new[::50], guess)
    # Linux forgets the peak so far when asked to.
    Path("/proc/self/clear_refs").write_text("5")
    before = _status("VmRSS")
    CONTENDERS[name](known, new, guess)
    answer.send(_status("VmHWM") - before)


def _status(field: str) -> float:
    """A figure of this process in megabytes."""
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(int(line.split()[1]) for line in lines if line.startswith(field + ":")) / 1024


def _thinned_by_open3d(points: Points, voxel: float) -> o3d.geometry.PointCloud:
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points.astype(np.float64)))
    thinned = cloud.voxel_down_sample(voxel)
    thinned.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=3 * voxel, max_nn=20))
    return thinned


def table(found: list[dict[str, Any]]) -> str:
    lines = [
        "| contender | wall s | processor s | ours : it (processor) | error mm (worst) | error ° (worst) | peak MB |",
        "|---|---|---|---|---|---|---|",
    ]
    for row in found:
        peak = "-" if row["peak_mb"] is None else f"{row['peak_mb']:.0f}"
        lines.append(
            f"| {row['contender']} | {row['wall_s']:.2f} | {row['processor_s']:.2f} "
            f"| {row['ours_to_it']:.2f} ({row['ours_to_it_processor']:.2f}) "
            f"| {row['error_mm']:.2f} ({row['worst_mm']:.1f}) | {row['error_deg']:.4f} ({row['worst_deg']:.3f}) "
            f"| {peak} |"
        )
    return "\n".join(lines)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--pairs", type=int, default=10)
    parser.add_argument("--global-cases", type=int, default=20)
    arguments = parser.parse_args()
    print(table(rows(arguments.pairs)), flush=True)
    print("\n" + global_search.table(global_search.rows(arguments.global_cases)))


if __name__ == "__main__":
    main()
