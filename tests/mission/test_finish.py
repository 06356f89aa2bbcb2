"""What is delivered when a mission has ended, and what is made up for later."""

import json
import os
from pathlib import Path

import pytest

from mission.finish import report_again
from mission.store import RunFolder
from tests.mission.fake_run import write_run

DELIVERIES = ("building.e57", "maps/building.yaml", "maps/building.pgm", "report.html")


def ended(tmp_path: Path) -> RunFolder:
    folder = RunFolder(write_run(tmp_path).folder)
    folder.write_state(json.loads(folder.state.read_text()) | {"map_id": "robot_map_S10"})
    return folder


def test_whatever_is_missing_of_the_deliveries_is_made_with_the_report(tmp_path: Path) -> None:
    folder = ended(tmp_path)
    for missing in ("building.e57", "maps/building.yaml", "report.html"):
        (folder.path / missing).unlink(missing_ok=True)
        assert report_again(folder)
        assert all((folder.path / name).is_file() for name in DELIVERIES), missing


@pytest.mark.parametrize("older", ["building.e57", "maps/building.yaml"])
def test_what_an_earlier_end_of_the_mission_delivered_is_not_taken_for_this_ones(older: str, tmp_path: Path) -> None:
    folder = ended(tmp_path)
    assert report_again(folder)
    end = folder.state.stat().st_mtime
    os.utime(folder.path / older, (end - 1, end - 1))
    assert report_again(folder)
    assert (folder.path / older).stat().st_mtime >= end


def test_what_is_delivered_is_not_made_again(tmp_path: Path) -> None:
    folder = ended(tmp_path)
    assert report_again(folder)
    before = (folder.path / "building.e57").stat().st_mtime_ns
    assert report_again(folder)
    assert (folder.path / "building.e57").stat().st_mtime_ns == before
