"""Executives that are killed in the middle of a mission, and what takes it up again."""

import shutil
from pathlib import Path

import pytest

from drivers.simulated.truth_log import read_truth
from drivers.wire.naming import own_name
from mission.config import load_config
from mission.resume import orphans_ended
from mission.store import RunFolder
from tests.missions.flights import ENOUGH, TWO_ROOMS, is_listening, is_running, landed, mission, simulate, wait_until


@pytest.mark.parametrize("instant", ["take the scan", "drive under the door"])
def test_a_mission_whose_executive_was_killed_is_resumed_to_its_end(instant: str, tmp_path: Path) -> None:
    process = simulate(TWO_ROOMS, tmp_path, f"--set={ENOUGH}")
    wait_until(lambda: is_running(tmp_path / "runs", instant), process)
    process.kill()
    process.wait()
    (run,) = (tmp_path / "runs").iterdir()
    assert mission("fsck", run).wait() == 0
    looks_around = instant == "drive under the door"
    if looks_around:
        end_agents(run)
        assert_refused_when_a_scan_is_damaged(Path(shutil.copytree(run, tmp_path / "damaged")))
    flight = landed(mission("resume", run, "--auto-resume", "--json"), tmp_path)
    assert flight.code == 0, flight.stderr
    assert flight.said["outcome"] == "complete"
    scans = flight.read("state.json")["scans"]
    assert len({scan["room_id"] for scan in scans}) == 2
    taken = [own_name(event["scan_id"]) for event in read_truth(run / "simulation") if event["event"] == "scan"]
    assert taken == sorted(set(taken)) == [scan["scan_id"] for scan in scans]
    assert [event["kind"] for event in flight.events if event["kind"].startswith("mission_")] == [
        "mission_started", "mission_resumed", "mission_ended",
    ]  # fmt: skip
    methods = {scan["registration"]["method"] for scan in scans}
    assert ("global" in methods) == looks_around
    assert ("NAV_INTERRUPTED" in [event["code"] for event in flight.events_of("failure")]) == looks_around
    config = load_config(run / "config.yaml")
    assert not any(map(is_listening, (config.scanner.control, config.base.control)))


def end_agents(run: Path) -> None:
    """They are gone as well: others are started, and the simulated robot stands where it stood."""
    with orphans_ended(RunFolder(run)):
        pass


def assert_refused_when_a_scan_is_damaged(run: Path) -> None:
    scan = run / "scans" / "S01.scan"
    content = bytearray(scan.read_bytes())
    content[len(content) // 2] ^= 1
    scan.chmod(0o644)
    scan.write_bytes(content)
    assert mission("fsck", run).wait() == 3
    refused = mission("resume", run)
    _, words = refused.communicate()
    assert refused.returncode == 2
    assert "S01.scan: expected SHA-256" in words
    assert mission("abort", run).wait() == 2
