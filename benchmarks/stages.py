"""The stages between registration and the goal at five million points a scan, ours against alternatives.

    python -m benchmarks.stages

The scans of the school's largest room are taken one after another, as in a mission. On each of them ours and the
alternative run one after the other in this process, so that a busy machine is busy for both; the processor's seconds
stand beside the wall's for the same reason. A figure is the median over the scans.
"""

import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import open3d as o3d
from numba import njit
from numpy.typing import NDArray

from benchmarks.data import STATIONS, Placed, largest_room
from benchmarks.timing import Row, Runs, table
from drivers import scan_file
from mission import stages
from mission.stages.scan_library import Library, without_own_body
from mission.store import RunFolder
from perception import (
    alignment,
    contour,
    flatness,
    labelled_map,
    next_best_view,
    robot_map,
    segmentation,
    transforms,
    voxels,
)
from perception.findings import RoomShape
from perception.grids import Grid, Label, VoxelSpace
from perception.labelled_map import CandidateField
from perception.rays import ray_walk, sightlines
from perception.rays.visibility import Sight
from perception.sensor import Sensor

HALL_M = (30.0, 30.0, 4.0)
SAMPLE = 400
"""Voxels that the slow oracle of the labels looks at; its seconds are scaled up to all of them."""


@dataclass
class Books:
    """What a mission knows of the room so far, and the seconds of every stage and alternative."""

    runs: dict[str, Runs] = field(default_factory=dict)
    remarks: dict[str, list[Any]] = field(default_factory=dict)
    thinned: list[NDArray[np.float32]] = field(default_factory=list)
    stations: list[NDArray[np.float64]] = field(default_factory=list)
    shape: RoomShape | None = None
    evidence: robot_map.MapEvidence | None = None
    space: VoxelSpace | None = None
    sight: Sight | None = None

    def time(self, name: str, call: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
        return self.runs.setdefault(name, Runs()).time(call, *arguments, **options)

    def note(self, name: str, value: Any) -> None:
        self.remarks.setdefault(name, []).append(value)


def rows() -> list[Row]:
    """All rows of the table."""
    stages.run(Library(RunFolder(Path())), "warm_up", {})
    books = Books()
    for number, view in enumerate(largest_room()):
        if number == 0:
            _cycle(Books(), view)
        _cycle(books, view)
    return [*_stage_rows(books), _hall_row(), _whole_cycles()]


def _cycle(books: Books, view: Placed) -> None:
    """One scan through all stages, each beside its alternative."""
    scan, pose = without_own_body(view.scan), view.map_from_scanner
    station = pose[:3, 3]
    books.time("align", alignment.align, scan.points)
    books.time("RANSAC", _planes_by_ransac, scan.points)
    books.shape = books.time("segment", _segment, books, scan.points, pose)
    books.time("patches", _planar_patches, scan.points)
    low = books.time("believe", _believed, scan.points, pose, books.shape)
    partial = books.time("map", robot_map.partial_map, low, station, azimuth_step=2 * scan.pattern.azimuth_step)
    books.evidence = robot_map.couple(books.evidence, partial.evidence)
    floor = low[np.abs(low[:, 2]) < robot_map.STEP_HEIGHT]
    books.time("flatness", flatness.flatness_map, floor, station=tuple(station))
    books.time("normals", _normals, floor)
    before = voxels.room_space(books.shape, 0.10, books.space)
    books.space = books.time("label", voxels.label, before, scan, pose)
    paper = books.time("label by spheres", voxels.label, before, scan, pose, "paper")
    books.note("DDA", books.time("DDA labels", _labels_by_dda, books.space, station))
    books.note("oracle", _sphere_oracle(books, before, paper, station))
    books.note("V", books.space.total)
    sensor = Sensor.of(scan.pattern, float(station[2]) - books.shape.floor_z)
    _choose(books, sensor)


def _segment(books: Books, points: NDArray[np.float32], pose: NDArray[np.float64]) -> RoomShape:
    """Section 3.1 on all scans so far, the newest of which is thinned first."""
    thinned = points[segmentation.one_per_voxel(points, 0.025, limit=600_000)]
    books.thinned.append(transforms.apply(pose, thinned))
    books.stations.append(pose[:3, 3])
    cloud = np.concatenate(books.thinned)
    station_of = np.repeat(np.arange(len(books.thinned)), [len(part) for part in books.thinned])
    levels = segmentation.floor_and_ceiling(cloud)
    seed = (float(books.stations[0][0]), float(books.stations[0][1]))
    return contour.room_shape(cloud, levels, seed, np.array(books.stations), station_of, previous=books.shape)


def _believed(points: NDArray[np.float32], pose: NDArray[np.float64], shape: RoomShape) -> NDArray[np.float32]:
    low = robot_map.below(points, pose, shape.floor_z + robot_map.ROBOT_HEIGHT)
    return low[sightlines.believable(low, pose[:3, 3], shape.contour, (), shape.floor_z)]


def _choose(books: Books, sensor: Sensor) -> None:
    assert books.space is not None and books.shape is not None and books.evidence is not None
    track = STATIONS[: len(books.stations)]
    field_ = labelled_map.candidates(
        books.space,
        track[-1],
        sensor,
        books.shape.floor_z,
        stations=np.array(books.stations)[:, :2],
        driven=track,
        robot_map=robot_map.mark_free(books.evidence.to_grid(), track, 0.3),
    )
    floor_z = books.shape.floor_z
    ranking = books.time("NBV", next_best_view.rank_views, books.space, field_, sensor, floor_z, earlier=books.sight)
    choice, gains, books.sight = ranking.choice, ranking.gains, ranking.sight
    if not choice.candidates:
        return
    books.time("NBV, no memory", next_best_view.next_best_view, books.space, field_, sensor, floor_z)
    every = books.time("NBV, every ray", _gains_ray_by_ray, books.space, field_, sensor, floor_z)
    same = np.array_equal(gains.data[field_.mask.data], every)
    books.note("gains", (choice.candidates, same, choice.best[0].gain / max(1, int(every.max()))))


# Alternatives


def _thinned_by_open3d(points: NDArray[np.float32], normals: bool = False) -> o3d.geometry.PointCloud:
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points.astype(np.float64))).voxel_down_sample(0.05)
    if normals:
        cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=0.15, max_nn=20))
    return cloud


def _planes_by_ransac(points: NDArray[np.float32]) -> Any:
    return _thinned_by_open3d(points).segment_plane(0.02, 3, 1000)


def _planar_patches(points: NDArray[np.float32]) -> Any:
    return _thinned_by_open3d(points, normals=True).detect_planar_patches()


def _normals(floor: NDArray[np.float32]) -> None:
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(floor.astype(np.float64)))
    cloud.estimate_normals(o3d.geometry.KDTreeSearchParamHybrid(radius=0.05, max_nn=30))


def _labels_by_dda(space: VoxelSpace, station: NDArray[np.float64]) -> float:
    """Follow a ray from every voxel to the scanner; the share of the empty ones that occupied voxels hide from it."""
    place = np.floor((station - space.origin) / space.size * ray_walk.SUBDIVISION).astype(np.int64)
    clear = _clear(space.labels == Label.OCCUPIED, *place)
    empty = space.labels == Label.EMPTY
    return float(np.mean(~clear[empty]))


@njit(cache=True)
def _clear(blocking: NDArray[np.bool_], x: int, y: int, z: int) -> NDArray[np.bool_]:
    clear = np.zeros(blocking.shape, np.bool_)
    for i in range(blocking.shape[0]):
        for j in range(blocking.shape[1]):
            for k in range(blocking.shape[2]):
                clear[i, j, k] = not blocking[i, j, k] and ray_walk.is_clear(blocking, i, j, k, x, y, z)
    return clear


def _sphere_oracle(
    books: Books, before: VoxelSpace, labelled: VoxelSpace, station: NDArray[np.float64]
) -> tuple[int, int]:
    """Figure 4 for every pair of a sampled voxel and an occupied one: how many were asked, how many differ.

    A voxel that the fast rule left occluded may also have had no return, so only those that it called empty can differ.
    """
    offset = labelled.centres(np.argwhere(labelled.labels == Label.OCCUPIED)) - station
    range_a = np.linalg.norm(offset, axis=1)
    alpha = np.arcsin(np.minimum(1.0, np.sqrt(0.5) * labelled.size / range_a))
    asked = np.argwhere((before.labels == Label.OCCLUDED) & (labelled.labels != Label.OCCUPIED))
    sample = asked[np.random.default_rng(0).permutation(len(asked))[:SAMPLE]]

    def hidden(voxel: NDArray[np.int64]) -> bool:
        b = labelled.centres(voxel[None])[0] - station
        range_b = np.linalg.norm(b)
        beta = np.arccos(np.clip(offset @ b / (range_a * range_b), -1.0, 1.0))
        nearer = (range_a < range_b) & (range_a > np.sqrt(0.5) * labelled.size)
        return bool(np.any(nearer & (alpha > beta + 1e-9)))

    runs = Runs()
    found = runs.time(lambda: np.array([hidden(voxel) for voxel in sample]))
    scaled = books.runs.setdefault("oracle labels", Runs())
    scaled.wall.append(runs.wall[0] * len(asked) / len(sample))
    scaled.processor.append(runs.processor[0] * len(asked) / len(sample))
    empty = labelled.labels[tuple(sample.T)] == Label.EMPTY
    return len(sample), int(np.count_nonzero(empty & found))


def _gains_ray_by_ray(space: VoxelSpace, field_: CandidateField, sensor: Sensor, floor_z: float) -> NDArray[np.int64]:
    """Every pair of candidate and occluded voxel by a ray of its own."""
    unit = ray_walk.SUBDIVISION
    cells = np.argwhere(field_.mask.data)[:, ::-1]
    level = round((floor_z + sensor.height - space.origin[2]) / space.size * 8) * (unit // 8)
    places = np.column_stack([cells * unit + unit // 2, np.full(len(cells), level)])
    blocking = (space.labels == Label.OCCUPIED) | (space.labels == Label.OUTSIDE)
    slopes = float(np.tan(sensor.elevation_min)), float(np.tan(sensor.elevation_max))
    ranges = sensor.range_min * unit / space.size, sensor.range_max * unit / space.size
    return ray_walk.count_visible(blocking, np.argwhere(space.labels == Label.OCCLUDED), places, slopes, ranges)


# Rows


def _stage_rows(books: Books) -> list[Row]:
    runs = books.runs
    parts = [runs[name] for name in ("align", "segment", "believe", "map")]
    four = Runs(*(np.sum([getattr(part, kind) for part in parts], axis=0).tolist() for kind in ("wall", "processor")))
    asked, differ = (sum(values) for values in zip(*books.remarks["oracle"], strict=True))
    hidden = float(np.mean(books.remarks["DDA"]))
    counted = [row[0] for row in books.remarks["gains"]]
    same = all(row[1] for row in books.remarks["gains"])
    worst = min(row[2] for row in books.remarks["gains"])
    proof = f"gains of all candidates {'the same' if same else 'NOT the same'}, best score {worst:.1%} of the best"
    volume = f"V = {max(books.remarks['V']):,}"
    spheres = f"empty by spheres, hidden by the oracle: {differ} of {asked:,} sampled"
    first = f"worst (the first cycle, {counted[0]} candidates): {max(runs['NBV'].wall):.3f} s"
    return [
        Row("align", "-", "", runs["align"], "Open3D voxels 5 cm + RANSAC plane", runs["RANSAC"]),
        Row("segment: levels, contour", "-", "", runs["segment"], "Open3D planar patches", runs["patches"]),
        Row("robot map: sightlines", "-", "", runs["believe"]),
        Row("robot map: obstacles, flatness", "-", "", runs["map"]),
        Row("flatness alone", "-", "", runs["flatness"], "Open3D normals of the floor", runs["normals"]),
        Row("align + segment + flatness + map", "-", "1.0", four),
        Row("label by ranges", "39 s with NBV", "0.03", runs["label"], "DDA per voxel", runs["DDA labels"],
            f"{volume}; DDA hides {hidden:.1%} of the empty ones"),
        Row("label by spheres", "39 s with NBV", "", runs["label by spheres"], "all pairs (scaled)",
            runs["oracle labels"], spheres),
        Row("NBV, every 10 cm", "39 s", "0.25", runs["NBV"], "DDA of all pairs", runs["NBV, every ray"], proof),
        Row("NBV without memory", "39 s", "1.0 worst", runs["NBV, no memory"], "DDA of all pairs",
            runs["NBV, every ray"], first),
    ]  # fmt: skip


def _hall_row() -> Row:
    """NBV in a hall of 3.6 million voxels, a third of which has been seen."""
    space, field_, sensor = _hall()
    runs, far = Runs(), Runs()
    for _ in range(3):
        choice, _gains = runs.time(next_best_view.next_best_view, space, field_, sensor, 0.0)
    wider, _gains = far.time(next_best_view.next_best_view, space, field_, sensor, 0.0, max_rays=300_000_000)
    share = choice.best[0].gain / wider.best[0].gain
    remark = f"V = {space.total:,}, {choice.candidates:,} candidates; {share:.1%} of the best of the larger search"
    return Row("NBV in a hall 30 x 30 x 4 m", "-", "2.0", runs, "ours with ten times the rays", far, remark)


def _hall() -> tuple[VoxelSpace, CandidateField, Sensor]:
    size = 0.10
    nx, ny, nz = (round(side / size) + extra for side, extra in zip(HALL_M, (0, 0, 1), strict=True))
    i, j = np.indices((nx, ny))
    seen = np.hypot(i - nx / 5, j - ny / 5) < nx / 2.7
    labels = np.where(seen[:, :, None], np.uint8(Label.EMPTY), np.uint8(Label.OCCLUDED)).repeat(nz, axis=2)
    for axis in range(3):
        np.moveaxis(labels, axis, 0)[[0, -1]] = Label.OCCUPIED
    rng = np.random.default_rng(0)
    for x, y in rng.integers(3, (nx - 20, ny - 20), (250, 2)):
        if np.hypot(x - nx / 5, y - ny / 5) > 15:
            a, b, height = rng.integers(5, 20, 3)
            part = np.s_[x : x + a, y : y + b]
            labels[part][:, :, 1 : height + 5] = np.where(seen[part], Label.OCCUPIED, Label.OCCLUDED)[:, :, None]
    space = VoxelSpace(labels, (0.0, 0.0, -size / 2), size)
    mask = (labels[:, :, 1:13].max(axis=2) == Label.EMPTY).T
    frame = Grid(mask, (0.0, 0.0), size)
    sensor = Sensor(1.3, float(np.deg2rad(-40)), float(np.deg2rad(60)), 1.5, 120.0)
    return space, CandidateField(frame, frame.with_data(np.ones(mask.shape))), sensor


def _whole_cycles() -> Row:
    """From the received file to the goal, every stage as the worker runs it, files and evidence included."""
    runs = Runs()
    with tempfile.TemporaryDirectory() as name:
        run = RunFolder.at(Path(name))
        library, known = Library(run), _Known()
        for view in largest_room():
            scan_file.write(run.scan_file(view.scan.scan_id), view.scan)
            runs.time(known.cycle, library, view)
    return Row("whole cycle: file to goal", "> 45 s", "3", runs, remark=f"worst {max(runs.wall):.2f} s")


class _Known:
    """The tree's books of one room, kept by hand."""

    def __init__(self) -> None:
        self._placed: list[tuple[str, list[list[float]]]] = []
        self._shape: RoomShape | None = None
        self._map_id: str | None = None

    def cycle(self, library: Library, view: Placed) -> None:
        def stage(name: str, **arguments: Any) -> Any:
            return stages.run(library, name, arguments)

        scan_id = view.scan.scan_id
        stage("validate_scan", scan_id=scan_id)
        level = stage("align_scan", scan_id=scan_id).level_from_scanner
        pose = view.map_from_scanner
        if self._placed:
            x, y, yaw = transforms.to_planar(pose)
            guess = (transforms.planar(x + 0.05, y - 0.04, yaw + 0.01) @ level).tolist()
            trust = {"error_m": 0.3, "error_rad": 0.07}
            found = stage("register_scan", scan_id=scan_id, guess=guess, reference=self._placed, **trust)
            pose = found.map_from_scanner
        else:
            stage("anchor_scan", scan_id=scan_id)
        self._placed.append((scan_id, pose.tolist()))
        if self._shape is not None:
            earlier = self._placed[:-1]
            stage("find_movement", scan_id=scan_id, pose=pose.tolist(), earlier=earlier, shape=self._shape)
        room = {"room_id": "R1", "cycle": len(self._placed)}
        track = [transforms.to_planar(np.asarray(station)) for _, station in self._placed]
        contour_of = {"seed": track[0][:2], "doors": (), "others": (), "previous": self._shape}
        self._shape = stage("segment_room", **room, scans=self._placed, **contour_of)
        ground = {"doors": (), "previous": self._map_id, "track": track, "shape": self._shape}
        self._map_id = stage("build_map", **room, scan_id=scan_id, pose=pose.tolist(), **ground).map_id
        stage("label_space", **room, shape=self._shape, scans=self._placed, voxel=0.10, labeller="range")
        where = {"pose": track[-1], "stations": self._placed, "track": track, "map_id": self._map_id}
        rules = {"avoid": (), "rule": "graded", "gain": "all", "path_clearance": 0.36, "goal_clearance": 0.58}
        stage("choose_view", **room, shape=self._shape, scan_id=scan_id, **where, **rules)


def main() -> None:
    print(table(row.cells() for row in rows()))


if __name__ == "__main__":
    main()
