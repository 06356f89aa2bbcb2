"""The survey as ``state.json`` has it."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from behaviours.survey import Cycle, Survey
from mission.report.run import read_run
from mission.state import describe
from mission.store import RunFolder
from perception.findings import Door, LabelCounts, RoomShape
from perception.stopping import StopDecision
from tests.behaviours.bench import current, scan

SQUARE = np.array([(-1.0, -1.0), (3.0, -1.0), (3.0, 3.0), (-1.0, 3.0)])
SHAPE = RoomShape(SQUARE, 0.0, 3.0, np.array([[-1.0, -1.0, 3.0, -1.0]]))
DECISION = StopDecision(True, "lambda_mu", 0.03, 0.02, None)


@pytest.fixture
def survey() -> Survey:
    """One room with two scans and a door, and a scan that never found its place."""
    survey = Survey()
    building, room = survey.building.add_room((0.0, 0.0))
    door = Door(3.0, 1.0, (1.0, 0.0), 0.9, 0.8, 2.1, 0.95)
    survey = replace(survey, building=building.observe_doors(room, [door], {room: SHAPE}), map_id="robot_map_S02")
    survey = survey.with_shape(room, SHAPE).with_scan(scan("S01")).with_scan(scan("S02", 1.0, 0.5))
    cycles = (Cycle("S01", LabelCounts(10, 70, 20), DECISION), Cycle("S02", LabelCounts(12, 78, 10), DECISION))
    ended = survey.building.end_room(room, "complete", "lambda_mu")
    return replace(survey, building=ended, cycles={room: cycles}, set_aside=(current("S03", None),))


def test_a_survey_that_has_not_begun_can_be_described() -> None:
    state = describe(Survey())
    assert (state["rooms"], state["doors"], state["scans"], state["map_id"]) == ([], [], [], None)


def test_rooms_have_their_cycles_and_their_shape(survey: Survey) -> None:
    (room,) = describe(survey)["rooms"]
    assert (room["id"], room["status"], room["reason_ended"]) == ("R1", "complete", "lambda_mu")
    assert room["scans"] == ["S01", "S02"]
    assert [cycle["occluded"] for cycle in room["cycles"]] == [20, 10]
    assert room["cycles"][1]["growing_rate"] == 0.03
    assert (room["contour"], room["area"]) == (SQUARE.tolist(), 16.0)


def test_a_room_without_a_shape_yet_is_described_all_the_same(survey: Survey) -> None:
    (room,) = describe(replace(survey, shapes={}))["rooms"]
    assert "contour" not in room
    assert room["scans"] == ["S01", "S02"]


def test_scans_have_poses_figures_and_their_file(survey: Survey) -> None:
    state = describe(survey)
    first, second = state["scans"]
    assert (first["file"], first["points"], first["sha256"]) == ("scans/S01.scan", 1000, "0" * 64)
    assert np.asarray(second["map_from_scanner"])[:3, 3].tolist() == [1.0, 0.5, 1.3]
    assert set(second["registration"]) >= {"fitness", "rmse", "overlap", "min_eigenvalue", "method"}
    assert state["scans_without_place"] == ["S03"]


def test_doors_name_the_rooms_they_join(survey: Survey) -> None:
    (door,) = describe(survey)["doors"]
    assert (door["id"], door["net_width"]) == ("D1", 0.8)
    assert "R1" in door["rooms"]


def test_the_state_goes_to_disk_and_the_report_reads_it_back(survey: Survey, tmp_path: Path) -> None:
    folder = RunFolder.at(tmp_path)
    folder.write_state(describe(survey) | {"outcome": "complete"})
    run = read_run(tmp_path)
    assert run.state == json.loads(folder.state.read_text())
    assert [scan["scan_id"] for scan in run.scans] == ["S01", "S02"]
    assert run.room_names == {"R1": "R1"}
