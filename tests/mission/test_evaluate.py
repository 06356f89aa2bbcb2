"""Evaluation of a small run whose every figure is known beforehand."""

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest

from drivers.simulated.world import Surface, save_world
from mission.evaluation import Evaluation, EvaluationSettings, evaluate, evaluate_run
from perception import transforms
from perception.failure import FailureError
from tests.mission.fake_run import FakeRun, write_run

KEYS = [
    "rooms_reachable", "rooms_finished", "scans", "collisions", "pose_error_max_m", "pose_error_max_deg",
    "sensed_fraction", "coverable_fraction", "sensed_of_coverable", "doors_precision", "doors_recall",
]  # fmt: skip
COARSE = EvaluationSettings(station_step_m=0.5)


@pytest.fixture(scope="module")
def perfect(tmp_path_factory: pytest.TempPathFactory) -> tuple[FakeRun, Evaluation]:
    run = write_run(tmp_path_factory.mktemp("perfect"))
    return run, evaluate(run.folder, run.world, COARSE)


def change_state(run: FakeRun, **values: object) -> None:
    path = run.folder / "state.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | values))


def test_the_figures_have_the_names_that_callers_expect(perfect: tuple[FakeRun, Evaluation]) -> None:
    assert list(perfect[1].summary()) == KEYS


def test_true_poses_have_no_error_whatever_the_frame_of_the_map(perfect: tuple[FakeRun, Evaluation]) -> None:
    result = perfect[1]
    assert result.pose_error_max_m == pytest.approx(0.0, abs=1e-6)
    assert result.pose_error_max_deg == pytest.approx(0.0, abs=1e-5)
    assert (result.scans, result.collisions) == (3, 0)


def test_reachable_and_finished_rooms_are_told_apart(perfect: tuple[FakeRun, Evaluation]) -> None:
    result = perfect[1]
    assert (result.rooms_reachable, result.rooms_finished) == (2, 1)
    assert result.rooms == [
        {"room": "west", "reachable": True, "finished": True},
        {"room": "east", "reachable": True, "finished": False},
    ]


def test_areas_are_those_of_the_building(perfect: tuple[FakeRun, Evaluation]) -> None:
    rows = {row["name"]: row for row in perfect[1].table_2}
    assert list(rows) == ["west", "east", "Total"]
    assert rows["west"]["floor"]["truth"] == pytest.approx(24.0)
    assert rows["east"]["ceiling"]["truth"] == pytest.approx(16.0)
    assert rows["west"]["wall"]["truth"] == pytest.approx(20 * 3.0 - 2.1)
    assert rows["Total"]["total"]["truth"] == pytest.approx(2 * 40 + (20 + 16) * 3 - 4.2)


def test_nearly_all_of_the_empty_rooms_is_sensed_but_for_the_blind_cones(perfect: tuple[FakeRun, Evaluation]) -> None:
    result = perfect[1]
    total = result.table_2[-1]["total"]
    assert 0.7 < result.sensed_fraction < 0.95
    assert result.sensed_fraction == pytest.approx(total["sensed"] / total["truth"])
    assert result.coverable_fraction > 0.97
    assert result.sensed_of_coverable == pytest.approx(total["sensed"] / total["coverable"])
    # One scan in the west: below it the floor is unseen on a disc of radius 1.3 m / tan 40, here cut by the door scan.
    west_floor = result.table_2[0]["floor"]
    assert west_floor["sensed"] < west_floor["coverable"] - 2.0


def test_a_board_against_a_wall_does_not_count_for_the_wall(tmp_path: Path) -> None:
    board = (np.array([[5.9, 3.97, 0.0], [3.9, 3.97, 0.0], [3.9, 3.97, 3.0], [5.9, 3.97, 3.0]]), 6.0)
    plain = write_run(tmp_path / "plain")
    boarded = write_run(tmp_path / "boarded", board=board[0])
    settings = dataclasses.replace(COARSE, station_step_m=0.3)
    bare, covered = (
        next(row for row in evaluate(run.folder, run.world, settings).table_2 if row["name"] == "west")["wall"]
        for run in (plain, boarded)
    )
    assert bare["hidden"] < 0.5
    assert covered["hidden"] == pytest.approx(board[1], rel=0.15)
    assert bare["sensed"] - covered["sensed"] == pytest.approx(board[1], rel=0.15)
    assert covered["truth"] == pytest.approx(bare["truth"])


def test_a_wrong_pose_is_measured_relative_to_the_first_scan(tmp_path: Path) -> None:
    error = transforms.from_euler(0, 0, np.deg2rad(0.5), (0.03, 0.04, 0.0))
    run = write_run(tmp_path, {"S03": error})
    result = evaluate(run.folder, run.world, dataclasses.replace(COARSE, station_step_m=2.0))
    assert result.pose_error_max_m == pytest.approx(0.05, abs=1e-6)
    assert result.pose_error_max_deg == pytest.approx(0.5, abs=1e-5)
    assert [round(pose["error_m"], 6) for pose in result.poses] == [0.0, 0.0, 0.05]


def test_a_shifted_cloud_senses_less(tmp_path: Path, perfect: tuple[FakeRun, Evaluation]) -> None:
    away = transforms.from_euler(0, 0, 0, (0, 0, 0.3))
    run = write_run(tmp_path, {"S02": away, "S03": away})
    result = evaluate(run.folder, run.world, dataclasses.replace(COARSE, station_step_m=2.0))
    assert result.sensed_fraction < perfect[1].sensed_fraction - 0.1


def test_doors_count_once_and_invented_ones_cost_precision(tmp_path: Path) -> None:
    run = write_run(tmp_path)
    doors = json.loads((run.folder / "state.json").read_text())["doors"]
    twice = {**doors[0], "id": "D2", "x": doors[0]["x"] + 0.1}
    elsewhere = {**doors[0], "id": "D3", "x": doors[0]["x"] + 2.0}
    quick = dataclasses.replace(COARSE, station_step_m=2.0)
    change_state(run, doors=[*doors, twice, elsewhere])
    result = evaluate(run.folder, run.world, quick)
    assert (result.doors_precision, result.doors_recall) == (pytest.approx(1 / 3), 1.0)
    assert result.doors["right"] == ["D1"]
    change_state(run, doors=[elsewhere])
    result = evaluate(run.folder, run.world, quick)
    assert (result.doors_precision, result.doors_recall) == (0.0, 0.0)
    assert result.doors["missed"] == ["D1"]


def test_collisions_are_counted(tmp_path: Path) -> None:
    run = write_run(tmp_path)
    with (run.folder / "simulation" / "truth.jsonl").open("a") as file:
        file.write(json.dumps({"event": "collision", "time": 9.0, "pose": [0, 0, 0]}) + "\n")
    assert evaluate(run.folder, run.world, dataclasses.replace(COARSE, station_step_m=2.0)).collisions == 1


def test_a_run_that_scanned_nothing_is_evaluated_too(tmp_path: Path) -> None:
    run = write_run(tmp_path)
    change_state(run, scans=[], rooms=[], doors=[])
    result = evaluate(run.folder, run.world, dataclasses.replace(COARSE, station_step_m=2.0))
    assert (result.rooms_finished, result.sensed_fraction, result.pose_error_max_m) == (0, 0.0, None)
    assert (result.doors_precision, result.doors_recall) == (1.0, 0.0)


def test_a_world_without_known_surfaces_has_no_table(tmp_path: Path) -> None:
    run = write_run(tmp_path)
    bare = dataclasses.replace(run.world, surface=np.full_like(run.world.surface, Surface.OTHER))
    result = evaluate(run.folder, bare, dataclasses.replace(COARSE, station_step_m=2.0))
    assert (result.table_2, result.sensed_fraction, result.coverable_fraction) == ([], None, None)


def test_the_evaluation_is_kept_as_json_beside_the_run(tmp_path: Path) -> None:
    run = write_run(tmp_path)
    save_world(run.world, run.folder / "simulation" / "world.npz")
    result = evaluate_run(run.folder, settings=dataclasses.replace(COARSE, station_step_m=2.0))
    kept = json.loads((run.folder / "evaluation.json").read_text())
    assert {key: kept[key] for key in KEYS} == result.summary()
    assert kept["settings"]["cell_m"] == 0.1


def test_a_run_is_evaluated_against_the_world_that_is_named(tmp_path: Path) -> None:
    run = write_run(tmp_path)
    other = tmp_path / "other.npz"
    save_world(dataclasses.replace(run.world, surface=np.full_like(run.world.surface, Surface.OTHER)), other)
    assert evaluate_run(run.folder, str(other), COARSE).sensed_fraction is None
    with pytest.raises(FailureError, match="nowhere"):
        evaluate_run(run.folder, "nowhere", COARSE)
