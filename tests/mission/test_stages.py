"""The stages in a row, as the worker runs them, on synthetic scans: what they return and what they leave on disk."""

import shutil
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from drivers import scan_file
from mission import stages
from mission.stages import scan_library
from mission.stages.memory import Memory
from mission.stages.placing import ScanSummary
from mission.stages.scan_library import Library, without_own_body
from mission.stages.shaping import MapSummary
from mission.store import RunFolder, load_space, read_arrays
from perception import transforms
from perception.failure import FailureError
from perception.findings import Alignment, DoorFindings, LabelCounts, Movement, Registration, RoomShape, ViewChoice
from perception.grids import Cell, Label
from perception.scan import BeamPattern, Scan
from tests.perception import rooms
from tests.synthetic import Scene, box

pytestmark = pytest.mark.xdist_group("surveyed")
"""Its fixture is every stage of two scans: one process makes it for all."""

MOUNT = transforms.from_euler(0, 0, 0, (0, 0, 1.3))
PATTERN = BeamPattern.with_step(np.deg2rad(0.8), (np.deg2rad(-40), np.deg2rad(60)), (0.5, 120.0))
PLACES = {"S01": (2.6, 2.6, 0.3), "S02": (4.4, 1.6, -0.5)}
TILTS = {"S01": (0.012, -0.008), "S02": (-0.006, 0.010)}
MAP_FROM_WORLD = transforms.planar(-2.6, -2.6, 0.0)
"""The map lies along the walls of the first room with its origin under the first scan."""


def true_pose(name: str) -> np.ndarray:
    """``world_from_scanner``: the base on the floor, leaning, with the scanner on top."""
    return transforms.planar(*PLACES[name]) @ transforms.from_euler(*TILTS[name], 0) @ MOUNT


@dataclass(frozen=True)
class Survey:
    """What came out of each stage."""

    run: RunFolder
    summary: ScanSummary
    alignment: Alignment
    anchor: Registration
    second: Registration
    shape: RoomShape
    maps: list[MapSummary]
    counts: list[LabelCounts]
    view: ViewChoice
    doors: DoorFindings


@pytest.fixture(scope="module")
def survey(tmp_path_factory: pytest.TempPathFactory) -> Survey:
    run = RunFolder.at(tmp_path_factory.mktemp("run"))
    scene = rooms.two_rooms(rooms.CABINET, rooms.TABLE)
    for seed, name in enumerate(PLACES):
        scan = scene.take(true_pose(name), PATTERN, seed=seed, scan_id=name)
        scan_file.write(run.scan_file(name), replace(scan, base_from_scanner=MOUNT))
    library = Library(run)

    def stage(name: str, **arguments: object) -> object:
        return stages.run(library, name, arguments)

    summary = stage("validate_scan", scan_id="S01")
    alignment = stage("align_scan", scan_id="S01")
    anchor = stage("anchor_scan", scan_id="S01")
    placed = [("S01", anchor.map_from_scanner.tolist())]
    level = stage("align_scan", scan_id="S02").level_from_scanner
    x, y, yaw = transforms.to_planar(MAP_FROM_WORLD @ true_pose("S02"))
    guess = transforms.planar(x + 0.06, y - 0.05, yaw + 0.02) @ level
    trust = {"error_m": 0.15, "error_rad": 0.06}
    second = stage("register_scan", scan_id="S02", guess=guess.tolist(), reference=placed, **trust)
    placed.append(("S02", second.map_from_scanner.tolist()))

    room = {"room_id": "R1"}
    contour = {"seed": (0.0, 0.0), "doors": (), "others": (), "previous": None}
    shape = stage("segment_room", **room, cycle=2, scans=placed, **contour)
    track = [transforms.to_planar(np.asarray(pose)) for _, pose in placed]
    maps, counts = [], []
    for cycle, (name, pose) in enumerate(placed, 1):
        before = maps[-1].map_id if maps else None
        place = {"pose": pose, "previous": before, "track": track[:cycle], "shape": shape, "doors": ()}
        maps.append(stage("build_map", **room, cycle=cycle, scan_id=name, **place))
        space = {"shape": shape, "scans": placed[:cycle], "voxel": 0.1, "labeller": "range"}
        counts.append(stage("label_space", **room, cycle=cycle, **space))
    where = {"scan_id": "S02", "pose": track[-1], "stations": placed, "track": track, "map_id": maps[-1].map_id}
    rules = {"avoid": (), "rule": "graded", "gain": "all", "path_clearance": 0.36, "goal_clearance": 0.58}
    view = stage("choose_view", **room, cycle=2, shape=shape, **where, **rules)
    doors = stage("find_doors", **room, shape=shape, scans=placed)
    return Survey(run, summary, alignment, anchor, second, shape, maps, counts, view, doors)


def test_a_valid_scan_is_summed_up(survey: Survey) -> None:
    assert survey.summary.points > 50_000
    assert 0.9 < survey.summary.return_share <= 1.0
    np.testing.assert_array_equal(survey.summary.base_from_scanner, MOUNT)


def test_the_tilt_is_taken_out(survey: Survey) -> None:
    up = survey.alignment.level_from_scanner[:3, :3] @ true_pose("S01")[:3, :3].T @ [0, 0, 1]
    assert np.rad2deg(np.arccos(min(1.0, up[2]))) < 0.05
    assert survey.alignment.scanner_height == pytest.approx(1.3, abs=0.01)


@pytest.mark.parametrize("name", PLACES)
def test_every_scan_is_where_it_was_taken(survey: Survey, name: str) -> None:
    found = survey.anchor if name == "S01" else survey.second
    distance, angle = transforms.difference(MAP_FROM_WORLD @ true_pose(name), found.map_from_scanner)
    # The frame is the first scan's, the scanner of which leans a centimetre away from above its place.
    assert distance < 0.03
    assert np.rad2deg(angle) < 0.15
    assert found.method == ("anchor" if name == "S01" else "icp")


def test_the_step_between_the_scans_is_true_to_the_centimetre(survey: Survey) -> None:
    step = transforms.inverse(survey.anchor.map_from_scanner) @ survey.second.map_from_scanner
    truth = transforms.inverse(true_pose("S01")) @ true_pose("S02")
    distance, angle = transforms.difference(truth, step)
    assert distance < 0.01
    assert np.rad2deg(angle) < 0.1


def test_a_scan_that_cannot_be_where_it_is_said_to_be_is_refused(survey: Survey) -> None:
    library = Library(survey.run)
    placed = [("S01", survey.anchor.map_from_scanner.tolist())]
    far = transforms.planar(1.2, 0.8, 0.9) @ survey.second.map_from_scanner
    with pytest.raises(FailureError) as refused:
        trust = {"error_m": 0.1, "error_rad": 0.05}
        stages.run(library, "register_scan", {"scan_id": "S02", "guess": far, "reference": placed, **trust})
    assert refused.value.failure.code.startswith("REG_")


def test_a_registration_is_asked_for_rivals_before_it_counts(survey: Survey, monkeypatch: pytest.MonkeyPatch) -> None:
    def rivalled(*_: object) -> None:
        raise FailureError("REG_AMBIGUOUS", "two poses fit alike")

    monkeypatch.setattr("perception.global_registration.challenge", rivalled)
    placed, guess = [("S01", true_pose("S01").tolist())], true_pose("S02").tolist()
    arguments = {"scan_id": "S02", "guess": guess, "reference": placed, "error_m": 0.2, "error_rad": 0.1}
    with pytest.raises(FailureError, match="REG_AMBIGUOUS"):
        stages.run(Library(survey.run), "register_scan", arguments)


def test_the_room_is_found_with_floor_ceiling_and_contour(survey: Survey) -> None:
    assert survey.shape.area == pytest.approx(6.0 * 5.0, rel=0.03)
    assert survey.shape.floor_z == pytest.approx(0.0, abs=0.02)
    assert survey.shape.ceiling_z == pytest.approx(3.0, abs=0.02)
    kept = read_arrays(survey.run.evidence_file("R1", 2, "ceiling"))
    np.testing.assert_array_equal(kept["contour"], survey.shape.contour)
    assert kept["data"].any()


def test_the_robot_map_is_fused_and_loads_back(survey: Survey) -> None:
    first, second = survey.maps
    assert second.free_m2 > first.free_m2
    grid = survey.run.robot_map(second.map_id)
    assert np.count_nonzero(grid.data == Cell.FREE) * grid.resolution**2 == pytest.approx(second.free_m2)
    front_of_cabinet = np.column_stack([np.linspace(1.1, 2.9, 30), np.full(30, 4.57)]) - 2.6
    assert np.mean(grid.data[tuple(grid.cells_of(front_of_cabinet).T)] == Cell.OBSTACLE) > 0.8
    assert read_arrays(survey.run.evidence_file("R1", 2, "flatness"))["data"].size


def test_the_robot_is_not_walled_in_where_it_stands(survey: Survey) -> None:
    grid = survey.run.robot_map(survey.maps[-1].map_id)
    for name in PLACES:
        x, y, _ = transforms.to_planar(MAP_FROM_WORLD @ true_pose(name))
        centres = grid.centres_of(np.argwhere(grid.data == Cell.OBSTACLE))
        assert np.hypot(*(centres - (x, y)).T).min() > 0.4


def test_a_fence_stands_in_the_robot_map(survey: Survey, tmp_path: Path) -> None:
    run = RunFolder(Path(shutil.copytree(survey.run.path, tmp_path / "fenced")))
    pose = survey.anchor.map_from_scanner.tolist()
    place = {"room_id": "R1", "cycle": 1, "scan_id": "S01", "pose": pose, "previous": None, "doors": ()}
    fence = np.array([[-1.0, -1.0], [1.2, -1.0], [1.2, 1.0], [-1.0, 1.0]])
    asked = place | {"shape": survey.shape, "track": [(0.0, 0.0, 0.0)], "fence": fence}
    made = stages.run(Library(run), "build_map", asked)
    fenced = run.robot_map(made.map_id)
    corners = np.vstack([fence, fence[:1]])
    for (x0, y0), (x1, y1) in pairwise(corners):
        along = np.linspace((x0, y0), (x1, y1), 50)
        rows, columns = fenced.cells_of(along).T
        assert (fenced.data[rows, columns] == Cell.OBSTACLE).all()
    assert fenced.data[tuple(fenced.cells_of((0.0, 0.0)))] == Cell.FREE


def test_nobody_moved_between_the_two_scans(survey: Survey) -> None:
    earlier = [("S01", survey.anchor.map_from_scanner.tolist())]
    asked = {"scan_id": "S02", "pose": survey.second.map_from_scanner.tolist(), "earlier": earlier}
    found = stages.run(Library(survey.run), "find_movement", asked | {"shape": survey.shape})
    assert isinstance(found, Movement) and found.share < 0.002


def test_the_second_scan_leaves_less_occluded_and_the_space_loads_back(survey: Survey) -> None:
    first, second = survey.counts
    assert first.total == second.total
    assert second.occluded < first.occluded
    labels = load_space(survey.run.voxel_file("R1", 2)).labels
    assert np.count_nonzero(labels == Label.EMPTY) == second.empty
    assert np.count_nonzero(labels == Label.OCCUPIED) == second.occupied


def test_the_next_view_is_in_the_room_and_its_evidence_is_kept(survey: Survey) -> None:
    best = survey.view.best[0]
    assert survey.view.candidates > 0
    assert -2.6 < best.x < 3.4
    assert -2.6 < best.y < 2.4
    assert best.gain == max(view.gain for view in survey.view.best)
    kept = read_arrays(survey.run.evidence_file("R1", 2, "view"))
    assert kept["candidates"].shape == (survey.view.candidates, 4)
    assert kept["candidates"][:, 2].max() == best.gain
    np.testing.assert_allclose(kept["best"][0], (best.x, best.y, best.gain, best.path_length))


def test_the_one_door_is_found_where_it_is(survey: Survey) -> None:
    (door,) = survey.doors.doors
    assert (door.x + 2.6, door.y + 2.6) == pytest.approx((6.0, 2.45), abs=0.06)
    assert door.normal == pytest.approx((1.0, 0.0), abs=0.02)
    assert door.width == pytest.approx(0.9, abs=0.06)


def test_a_stage_of_another_name_does_not_exist(tmp_path: Path) -> None:
    with pytest.raises(KeyError):
        stages.run(Library(RunFolder(tmp_path)), "guess_room", {})


def test_a_scan_that_never_came_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FailureError):
        stages.run(Library(RunFolder.at(tmp_path)), "validate_scan", {"scan_id": "S99"})


def a_room_with_a_robot(pattern: BeamPattern, mount: np.ndarray) -> Scan:
    robot = box((-0.45, -0.3, 0), (0.45, 0.3, 0.9))
    shell = [
        box((-3.2, -3.2, -0.2), (3.2, 3.2, 0)),
        box((-3.2, -3.2, 0), (-3, 3.2, 3)),
        box((3, -3.2, 0), (3.2, 3.2, 3)),
    ]
    scene = Scene(robot, *shell, box((0.6, -0.3, 0), (0.9, 0.3, 0.8)))
    return replace(scene.take(mount, pattern), base_from_scanner=mount)


def test_the_robot_itself_is_no_part_of_the_room_but_what_stands_before_it_is() -> None:
    scan = a_room_with_a_robot(PATTERN, MOUNT)
    kept = without_own_body(scan)
    on_robot = (np.abs(scan.points[:, 0]) < 0.47) & (np.abs(scan.points[:, 1]) < 0.32) & (scan.points[:, 2] < 0)
    assert np.count_nonzero(on_robot) > 100
    assert len(kept.points) == len(scan.points) - np.count_nonzero(on_robot)
    assert len(kept.beam) == len(kept.intensity) == len(kept.points)
    np.testing.assert_allclose(kept.pattern.directions(kept.beam), _directions(kept.points), atol=0.02)


def _directions(points: np.ndarray) -> np.ndarray:
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def test_of_a_scanner_without_a_robot_nothing_is_taken_away() -> None:
    scan = replace(a_room_with_a_robot(PATTERN, MOUNT), base_from_scanner=np.eye(4))
    assert len(without_own_body(scan).points) == len(scan.points)


def test_poses_that_are_a_little_wrong_are_mended_by_the_pairs_and_no_pair_is_compared_twice(
    survey: Survey, monkeypatch: pytest.MonkeyPatch
) -> None:
    true = {"S01": survey.anchor.map_from_scanner, "S02": survey.second.map_from_scanner}
    off = {**true, "S02": true["S02"] @ transforms.planar(0.002, -0.001, 0.0)}
    arguments = {"scans": [(name, pose.tolist()) for name, pose in off.items()]}
    library = Library(survey.run)
    found = stages.run(library, "optimise_poses", arguments)
    assert (found.compared, found.refused, found.reason) == (1, (), "")
    assert transforms.difference(found.poses["S02"], true["S02"])[0] < 0.001
    assert set(found.residuals) == {"S01", "S02"} and max(found.residuals.values()) < 0.006
    monkeypatch.setattr("perception.pose_graph.compare", None)
    again = stages.run(library, "optimise_poses", arguments)
    assert transforms.difference(found.poses["S02"], again.poses["S02"])[0] < 1e-6


def a_run_of(folder: Path, *scans: Scan) -> RunFolder:
    run = RunFolder.at(folder)
    for scan in scans:
        scan_file.write(run.scan_file(scan.scan_id), scan)
    return run


def spoiled_scan(name: str, seed: int) -> Scan:
    """A scan with a robot in it and a few points that are none."""
    scan = a_room_with_a_robot(PATTERN, MOUNT)
    noise = np.random.default_rng(seed).normal(1, 1e-3, (len(scan.points), 1)).astype(np.float32)
    points = scan.points * noise
    points[:: len(points) // 7] = np.nan
    return replace(scan, scan_id=name, points=points)


def test_a_scan_that_was_forgotten_is_the_same_when_it_is_read_again(tmp_path, monkeypatch) -> None:
    monkeypatch.setattr(scan_library, "_WHOLE", 1)
    library = Library(a_run_of(tmp_path, spoiled_scan("S01", 1), spoiled_scan("S02", 2)))
    first = library.scan("S01")
    kept = first.points.copy(), first.beam.copy()
    library.scan("S02")
    again = library.scan("S01")
    assert again is not first
    np.testing.assert_array_equal(again.points, kept[0])
    np.testing.assert_array_equal(again.beam, kept[1])
    assert np.isfinite(again.points).all() and len(without_own_body(again).points) == len(again.points)


def test_a_scan_that_comes_again_under_another_name_is_refused(tmp_path) -> None:
    scan = spoiled_scan("S01", 1)
    library = Library(a_run_of(tmp_path, scan, replace(scan, scan_id="S02"), spoiled_scan("S03", 3)))
    library.scan("S01")
    with pytest.raises(FailureError, match="SCAN_REPEATED"):
        stages.run(library, "validate_scan", {"scan_id": "S02"})
    stages.run(library, "validate_scan", {"scan_id": "S03"})


def test_scans_side_by_side_are_coarsened_when_they_are_many(tmp_path, monkeypatch) -> None:
    scans = [spoiled_scan(f"S{n:02d}", n) for n in range(4)]
    library = Library(a_run_of(tmp_path, *scans))
    placed = [(scan.scan_id, np.eye(4).tolist()) for scan in scans]
    assert [len(scan.points) for scan, _ in library.placed(placed)] == [
        len(library.scan(scan.scan_id).points) for scan in scans
    ]
    monkeypatch.setattr(scan_library, "_PLACED_POINTS", PATTERN.size)
    coarse = [scan for scan, _ in library.placed(placed)]
    assert sum(scan.pattern.size for scan in coarse) < 1.2 * PATTERN.size
    for scan in coarse:
        seen = np.einsum("ij,ij->i", _directions(scan.points), scan.pattern.directions(scan.beam))
        assert seen.min() > np.cos(np.deg2rad(0.1)), "every point is still on its beam"


def test_a_cloud_of_many_scans_is_no_larger_than_one_of_ten(tmp_path, monkeypatch) -> None:
    scans = [spoiled_scan(f"S{n:02d}", n) for n in range(4)]
    library = Library(a_run_of(tmp_path, *scans))
    placed = [(scan.scan_id, np.eye(4).tolist()) for scan in scans]
    whole = library.cloud(placed)
    monkeypatch.setattr(scan_library, "_CLOUD_POINTS", 2 * scan_library._THINNED_POINTS)
    points, stations, station_of = library.cloud(placed)
    assert len(points) == len(station_of) == pytest.approx(len(whole[0]) / 2, rel=0.01) and len(stations) == 4


def test_memory_keeps_the_newest_within_its_bytes_and_makes_the_rest_again() -> None:
    memory: Memory[np.ndarray] = Memory(100)
    made: list[str] = []

    def ask(name: str, size: int = 40) -> None:
        memory.get(name, lambda: made.append(name) or np.zeros(size, np.uint8))

    for name in "abacab":
        ask(name)
    assert "".join(made) == "abcb", "b was the oldest when c came"
    assert len(memory) == 2 and memory.bytes == 80
    ask("large", 500)
    assert len(memory) == 1 and memory.bytes == 500, "the newest stays however large"
    with pytest.raises(ZeroDivisionError):
        memory.get("broken", lambda: 1 // 0)
    assert memory.bytes == 500
