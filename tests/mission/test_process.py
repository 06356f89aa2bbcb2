"""Recorded scans through the stages to a report: rooms made here, and rooms that somebody really scanned."""

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pye57
import pytest

from mission.process import ROOM, process_folder
from mission.store import RunFolder, load_space
from perception import transforms
from perception.failure import FailureError
from perception.grids import Cell
from perception.scan import BeamPattern
from tests.perception import rooms
from tests.shared_data import SCANS

pytestmark = pytest.mark.xdist_group("processed")
"""Its fixture is two scans taken through the whole pipeline: one process makes it for all."""

PLACES = ((2.0, 2.5, 0.2), (4.4, 1.6, -0.3))


@dataclass(frozen=True)
class Processed:
    said: dict[str, Any]

    @property
    def folder(self) -> Path:
        return Path(self.said["run"])

    @property
    def state(self) -> dict[str, Any]:
        return json.loads((self.folder / "state.json").read_text())

    def row(self, number: int) -> dict[str, Any]:
        return self.said["scans"][number]


def real(name: str, out: Path) -> Processed:
    if not (SCANS / name).is_dir():
        pytest.skip(f"the recorded scans are not on this machine: {SCANS / name}")
    return Processed(process_folder(SCANS / name, out))


def true_pose(number: int) -> np.ndarray:
    x, y, yaw = PLACES[number]
    return transforms.from_euler(0.01, -0.015, yaw, (x, y, 1.3))


def write_3dtk(folder: Path, name: str, points: np.ndarray, pose: np.ndarray) -> None:
    """As 3DTK has it: centimetres, x right, y up, z forward; the pose as position and angles of ``Rx Ry Rz``."""
    left_from_right = np.array([[0.0, -1, 0], [0, 0, 1], [1, 0, 0]])
    np.savetxt(folder / f"{name}.3d", 100 * points @ left_from_right.T, fmt="%.3f")
    turn = left_from_right @ pose[:3, :3] @ left_from_right.T
    angles = np.rad2deg(
        [np.arctan2(-turn[1, 2], turn[2, 2]), np.arcsin(turn[0, 2]), np.arctan2(-turn[0, 1], turn[0, 0])]
    )
    np.savetxt(folder / f"{name}.pose", [100 * left_from_right @ pose[:3, 3], angles], fmt="%.6f")


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Processed:
    """Two scans of one room as 3DTK files, whose poses are off by some centimetres, and a file that holds no room."""
    folder = tmp_path_factory.mktemp("Made Room")
    scene = rooms.two_rooms(rooms.CABINET)
    for number in range(2):
        points = scene.take(true_pose(number), rooms.PATTERN, seed=number).points
        off = transforms.from_euler(0, 0, 0.01 * number, (0.04 * number, 0.03 * number, 0))
        write_3dtk(folder, f"scan00{number}", points, true_pose(number) @ off)
    (folder / "scan002.3d").write_text("100 0 0\n200 50 0\n0 100 90\n")
    return Processed(process_folder(folder, tmp_path_factory.mktemp("runs")))


def test_the_scans_are_placed_to_the_centimetre(made: Processed) -> None:
    first, second = (np.asarray(made.row(number)["map_from_scanner"]) for number in range(2))
    truth = transforms.inverse(true_pose(0)) @ true_pose(1)
    distance, angle = transforms.difference(truth, transforms.inverse(first) @ second)
    assert distance < 0.01
    assert np.rad2deg(angle) < 0.1


def test_how_far_the_given_poses_are_off_is_told(made: Processed) -> None:
    assert made.row(0)["from_given_pose"] is None
    assert made.row(1)["from_given_pose"]["distance_m"] == pytest.approx(0.05, abs=0.015)
    assert made.row(1)["from_given_pose"]["angle_deg"] == pytest.approx(0.57, abs=0.15)


def test_a_scan_that_is_none_is_refused_with_its_reason_and_the_others_go_on(made: Processed) -> None:
    assert made.row(2)["refused"].startswith("SCAN_")
    assert "registration" not in made.row(2)
    assert [scan["scan_id"] for scan in made.state["scans"]] == ["S01", "S02"]
    assert [failure["code"][:5] for failure in _events(made, "failure")] == ["SCAN_"]


def test_the_room_is_measured_mapped_and_labelled(made: Processed) -> None:
    room = made.said["room"]
    assert room["area"] == pytest.approx(30.0, rel=0.03)
    assert room["ceiling_z"] - room["floor_z"] == pytest.approx(3.0, abs=0.02)
    run = RunFolder(made.folder)
    assert np.any(run.robot_map(made.state["map_id"]).data == Cell.FREE)
    counts = room["cycles"][0]
    assert load_space(run.voxel_file(ROOM, 1)).total == sum(counts[k] for k in ("occupied", "empty", "occluded"))
    assert [name for name in room if name.endswith("_refused")] == []


def test_the_door_of_the_room_is_found(made: Processed) -> None:
    (door,) = made.state["doors"]
    assert door["width"] == pytest.approx(0.9, abs=0.08)


def test_everything_is_delivered_that_a_mission_delivers(made: Processed) -> None:
    assert made.said["report"] == str(made.folder / "report.html")
    assert made.folder.name.endswith("_made room0")
    for name in ("report.html", "report.json", "events.jsonl", "maps/building.pgm", "maps/building.yaml"):
        assert (made.folder / name).stat().st_size > 0, name
    assert pye57.E57(str(made.folder / "building.e57")).scan_count == 2


def test_every_stage_is_on_record_with_its_time(made: Processed) -> None:
    stages = _events(made, "stage")
    assert {"validate_scan", "align_scan", "anchor_scan", "register_scan", "segment_room", "build_map"} <= {
        stage["name"] for stage in stages
    }
    assert all(stage["seconds"] >= 0 for stage in stages)


def _events(made: Processed, kind: str) -> list[dict[str, Any]]:
    lines = (made.folder / "events.jsonl").read_text().splitlines()
    return [event for event in map(json.loads, lines) if event["kind"] == kind]


def test_a_folder_of_which_no_scan_can_be_placed_has_a_report_all_the_same(tmp_path: Path) -> None:
    source = tmp_path / "nothing"
    source.mkdir()
    (source / "scan000.3d").write_text("100 0 0\n200 50 0\n0 100 90\n")
    result = Processed(process_folder(source, tmp_path / "runs"))
    assert "refused" in result.row(0)
    assert result.state["scans"] == []
    assert (result.folder / "report.html").is_file()


def test_a_file_that_cannot_be_read_is_a_row_and_the_others_go_on(tmp_path: Path) -> None:
    source = tmp_path / "mixed"
    source.mkdir()
    (source / "a.ply").write_bytes(b"ply\nformat ascii 1.0\nelement vertex 99999999999\nproperty float x\nend_header\n")
    (source / "b.3d").write_text("100 0 0\n200 50 0\n0 100 90\n")
    result = Processed(process_folder(source, tmp_path / "runs"))
    assert [row["source"] for row in result.said["scans"]] == ["a.ply", "b.3d"]
    assert result.row(0)["refused"].startswith("RECORDED_BROKEN")
    assert result.row(1)["scan_id"] == "S01"


@pytest.mark.parametrize("names", [("a.ply",), ("a.ply", "b.ply")])
def test_files_none_of_which_can_be_read_leave_no_run_behind(names: tuple[str, ...], tmp_path: Path) -> None:
    source = tmp_path / "broken"
    source.mkdir()
    for name in names:
        (source / name).write_bytes(b"no cloud at all")
    with pytest.raises(FailureError, match="RECORDED_BROKEN"):
        process_folder(source, tmp_path / "runs")
    assert not (tmp_path / "runs").exists()


def test_the_views_of_a_merged_cloud_are_scans_and_lie_where_the_cloud_has_them(tmp_path: Path) -> None:
    source = tmp_path / "merged"
    source.mkdir()
    tripod = BeamPattern.with_step(np.deg2rad(0.7), (np.deg2rad(-60), np.deg2rad(85)), (0.3, 60.0))
    poses = [transforms.from_euler(0, 0, 0.3 * n, place) for n, place in enumerate(((1.7, 2.5, 1.6), (4.4, 1.6, 1.6)))]
    scene = rooms.two_rooms()
    clouds = [transforms.apply(pose, scene.take(pose, tripod, seed=n).points) for n, pose in enumerate(poses)]
    np.savetxt(source / "merged.xyz", np.concatenate(clouds) + np.array([5000.0, 7000.0, 120.0]), fmt="%.4f")
    result = Processed(process_folder(source, tmp_path / "runs"))
    assert [row["origin"] for row in result.said["scans"]] == ["floor", "floor"]
    assert all(row["alone"]["area"] == pytest.approx(30.0, rel=0.05) for row in result.said["scans"])
    assert result.row(1)["from_given_pose"]["distance_m"] < 0.01
    stations = [np.asarray(row["map_from_scanner"])[:3, 3] for row in result.said["scans"]]
    apart = np.linalg.norm(poses[0][:3, 3] - poses[1][:3, 3])
    assert np.linalg.norm(stations[0] - stations[1]) == pytest.approx(apart, abs=0.06)


def test_each_scan_says_what_it_shows_by_itself_and_what_each_stage_took(made: Processed) -> None:
    for number in range(2):
        row = made.row(number)
        assert row["alone"]["area"] == pytest.approx(30.0, rel=0.06)
        assert row["alone"]["ceiling_z"] - row["alone"]["floor_z"] == pytest.approx(3.0, abs=0.03)
        assert {"read", "align_scan", "segment_room", "find_doors"} <= row["seconds"].keys()
        assert math.degrees(row["alignment"]["roll"]) == pytest.approx(math.degrees(0.01), abs=0.1)
    report = json.loads((made.folder / "report.json").read_text())["recorded"]
    assert report[1]["error_cm"] == pytest.approx(100 * made.row(1)["from_given_pose"]["distance_m"])
    assert report[2]["refused"] == made.row(2)["refused"]
    page = (made.folder / "report.html").read_text()
    assert all(row["source"] in page for row in made.said["scans"])


def test_a_folder_without_scans_leaves_no_run_behind(tmp_path: Path) -> None:
    with pytest.raises(FailureError, match="RECORDED_NONE"):
        process_folder(tmp_path, tmp_path / "runs")
    assert not (tmp_path / "runs").exists()


def test_two_real_scans_without_poses_find_each_other(tmp_path: Path) -> None:
    """A small apartment by a tilting line scanner, 0.6 m and 7 degrees apart; larger sets are for the benchmark."""
    result = real("lpm_apartment", tmp_path)
    assert [row.get("refused") for row in result.said["scans"]] == [None, None]
    found = result.row(1)["registration"]
    assert found["overlap"] > 0.5
    assert found["rmse"] < 0.015
    assert found["correction_m"] == pytest.approx(0.62, abs=0.03)
    assert 2.4 < result.said["room"]["ceiling_z"] - result.said["room"]["floor_z"] < 2.6
