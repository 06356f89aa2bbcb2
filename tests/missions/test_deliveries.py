"""A simulated mission from the command line to the last file of its run folder."""

import json
import re
import subprocess
import sys

import numpy as np
import pye57
import pytest
import yaml

from drivers import scan_file
from drivers.wire.naming import full_name
from mission.config import load_config
from mission.export.ros_map import read_ros_map
from mission.store import RunFolder, load_grid, load_space, read_arrays
from perception import transforms
from perception.grids import Cell, Label
from tests.missions.flights import ROOT, Flight, is_listening

pytestmark = pytest.mark.xdist_group("flown")
"""Its fixture is a whole flight: one process makes it for all."""

ROOM_KEYS = ["id", "scans", "reason_ended", "growing_rate", "occluded_decrease_rate"]
EVALUATION_KEYS = [
    "rooms_reachable", "rooms_finished", "scans", "collisions", "pose_error_max_m", "pose_error_max_deg",
    "sensed_fraction", "coverable_fraction", "sensed_of_coverable", "doors_precision", "doors_recall",
]  # fmt: skip


def scan_ids(flown: Flight) -> list[str]:
    return [scan["scan_id"] for scan in flown.read("state.json")["scans"]]


def test_it_ends_complete_and_says_so_in_one_object(flown: Flight) -> None:
    assert flown.code == 0, flown.stderr
    assert list(flown.said) == ["run", "outcome", "rooms", "scans", "wall_s", "simulated_s", "reason"]
    assert flown.said["reason"] == ""
    assert all(list(room) == ROOM_KEYS for room in flown.said["rooms"])
    assert flown.said["outcome"] == "complete"
    assert flown.said["run"] == str(flown.folder)
    assert flown.said["scans"] == sum(room["scans"] for room in flown.said["rooms"]) == len(scan_ids(flown))
    assert flown.said["simulated_s"] == pytest.approx(20 * flown.said["wall_s"], rel=0.1)


def test_nothing_is_said_on_stderr_but_progress(flown: Flight) -> None:
    assert "Traceback" not in flown.stderr
    assert "was not written" not in flown.stderr


def test_both_rooms_and_their_door_are_in_the_survey(flown: Flight) -> None:
    state = flown.read("state.json")
    assert [room["status"] for room in state["rooms"]] == ["complete", "complete"]
    (door,) = state["doors"]
    assert sorted(door["rooms"]) == sorted(room["id"] for room in state["rooms"])
    big, small = (room["area"] for room in state["rooms"])
    assert big == pytest.approx(4.4 * 4.0, rel=0.05)
    assert small == pytest.approx(3.0 * 3.2, rel=0.05)


def test_the_truth_confirms_poses_rooms_and_doors(flown: Flight) -> None:
    told = flown.read("evaluation.json")
    assert (told["rooms_reachable"], told["rooms_finished"], told["collisions"]) == (2, 2, 0)
    assert told["pose_error_max_m"] < 0.01
    assert told["pose_error_max_deg"] < 0.1
    assert (told["doors_precision"], told["doors_recall"]) == (1.0, 1.0)
    assert told["sensed_of_coverable"] > 0.9


def test_the_robot_is_back_where_it_began(flown: Flight) -> None:
    x, y, _ = flown.read("state.json")["track"][-1]
    assert np.hypot(x, y) < 0.15


def test_every_event_has_its_time_and_its_kind_and_time_runs_on(flown: Flight) -> None:
    lines = (flown.folder / "events.jsonl").read_text().splitlines()
    events = [json.loads(line) for line in lines]
    assert all({"t", "utc", "kind"} <= set(event) for event in events)
    times = [event["t"] for event in events]
    assert times == sorted(times)
    assert [event["name"] for event in events if event["kind"] == "agent"] == ["scanner", "base"]
    assert [event["outcome"] for event in events if event["kind"] == "mission_ended"] == ["complete"]
    registered = [event["scan_id"] for event in events if event["kind"] == "registered"]
    assert registered == scan_ids(flown)


def test_no_node_is_left_running(flown: Flight) -> None:
    last = {event["path"]: event["after"] for event in flown.events_of("node")}
    assert last
    assert "RUNNING" not in last.values()


def test_every_scan_is_kept_as_it_was_taken(flown: Flight) -> None:
    run, (started,) = RunFolder(flown.folder), flown.events_of("mission_started")
    for scan_id in scan_ids(flown):
        scan = scan_file.read(run.scan_file(scan_id))
        assert scan.scan_id == full_name(started["mission"], scan_id)
        assert len(scan.points) > 100_000


def test_maps_voxels_and_evidence_load_back(flown: Flight) -> None:
    run, state = RunFolder(flown.folder), flown.read("state.json")
    for room in state["rooms"]:
        for cycle in range(1, len(room["cycles"]) + 1):
            counts = room["cycles"][cycle - 1]
            labels = load_space(run.voxel_file(room["id"], cycle)).labels
            assert np.count_nonzero(labels == Label.OCCUPIED) == counts["occupied"]
            assert np.count_nonzero(labels == Label.OCCLUDED) == counts["occluded"]
            for name in ("ceiling", "flatness", "view"):
                assert read_arrays(run.evidence_file(room["id"], cycle, name))["data"].size
    for scan_id in scan_ids(flown):
        assert np.any(load_grid(run.map_file(f"robot_map_{scan_id}")).data == Cell.FREE)


def test_the_exported_map_is_the_last_robot_map(flown: Flight) -> None:
    exported = read_ros_map(flown.folder / "maps" / "building.yaml")
    last = RunFolder(flown.folder).robot_map(flown.read("state.json")["map_id"])
    np.testing.assert_array_equal(exported.data, last.data)
    assert exported.origin == pytest.approx(last.origin)
    assert exported.resolution == last.resolution == 0.05


def test_the_survey_has_one_set_up_a_scan_with_its_pose(flown: Flight) -> None:
    state = flown.read("state.json")
    file = pye57.E57(str(flown.folder / "building.e57"))
    assert file.scan_count == len(state["scans"])
    for number, scan in enumerate(state["scans"]):
        header = file.get_header(number)
        assert header["name"].value() == f"{scan['room_id']}/{scan['scan_id']}"
        assert header.point_count == len(scan_file.read(flown.folder / scan["file"]).points)
        pose = np.asarray(scan["map_from_scanner"])
        np.testing.assert_allclose(header.translation, pose[:3, 3], atol=1e-6)
        np.testing.assert_allclose(header.rotation_matrix, pose[:3, :3], atol=1e-6)


def test_scans_of_the_survey_lie_on_the_walls_of_the_rooms(flown: Flight) -> None:
    """Both rooms in one frame: what the second room's scans saw of the first one lies where the first one's did."""
    file = pye57.E57(str(flown.folder / "building.e57"))
    heights = []
    for number in range(file.scan_count):
        raw = file.read_scan_raw(number)
        points = np.stack([raw[f"cartesian{axis}"] for axis in "XYZ"], axis=1)
        header = file.get_header(number)
        pose = np.eye(4)
        pose[:3, :3], pose[:3, 3] = header.rotation_matrix, header.translation
        heights.append(np.quantile(transforms.apply(pose, points)[:, 2], (0.02, 0.98)))
    low, high = np.transpose(heights)
    assert np.abs(low).max() < 0.02
    assert np.abs(high - 2.7).max() < 0.02


def test_pictures_and_report_are_there_and_the_report_needs_nothing_else(flown: Flight) -> None:
    report = flown.read("report.json")
    kinds = ("ceiling", "flatness", "robot_map", "view", "cloud_top", "plan")
    for kind in kinds:
        assert any(kind in name for name in report["pictures"]), kind
    assert all((flown.folder / name).stat().st_size > 1000 for name in report["pictures"])
    page = (flown.folder / "report.html").read_text()
    references = re.findall(r"""(?:src|href)\s*=\s*["']([^"']*)""", page)
    assert references
    assert [reference[:40] for reference in references if not reference.startswith(("data:", "#"))] == []
    assert re.findall(r"""url\(\s*["']?(?!data:|#)""", page) == []
    assert len(report["rooms"]) == 2
    assert report["evaluation"]["rooms_finished"] == 2


def test_the_resolved_configuration_is_kept_and_is_one(flown: Flight) -> None:
    config = load_config(flown.folder / "config.yaml")
    assert config.settings.room.predicted_rate == 0.05
    assert config.settings.scanning.step_deg == 0.5
    assert yaml.safe_load((flown.folder / "config.yaml").read_text())["clock_rate"] == 20.0


def test_the_agents_are_gone(flown: Flight) -> None:
    config = load_config(flown.folder / "config.yaml")
    assert not any(map(is_listening, (config.scanner.control, config.scanner.bulk, config.base.control)))


def test_no_file_is_left_half_written(flown: Flight) -> None:
    marks = {".partial", ".part", ".tmp"}
    assert [path.name for path in flown.folder.rglob("*") if marks & set(path.suffixes)] == []


def test_report_and_evaluation_can_be_made_again(flown: Flight) -> None:
    def say(*arguments: str) -> str:
        command = [sys.executable, "-m", "mission", *arguments]
        return subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True, timeout=120).stdout

    before = flown.read("evaluation.json")
    told = json.loads(say("evaluate", str(flown.folder), "--json"))
    assert list(told) == EVALUATION_KEYS
    assert told == {key: before[key] for key in EVALUATION_KEYS}
    (flown.folder / "report.html").unlink()
    assert say("report", str(flown.folder)).strip() == str(flown.folder / "report.html")
    assert (flown.folder / "report.html").is_file()
