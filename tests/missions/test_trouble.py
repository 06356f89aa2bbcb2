"""Whole missions that do not go as planned: operators, people, faults, and agents that are not there."""

import signal
from concurrent.futures import Future
from pathlib import Path
from typing import Any

import yaml

from drivers.simulated.truth_log import read_truth
from drivers.simulated.world import save_world
from drivers.simulated.worlds import load_world
from mission.config import load_config
from mission.evaluation.survey import pose_errors, true_poses, world_from_map
from mission.report.run import read_run
from tests.missions.flights import (
    ENOUGH,
    ONE_ROOM,
    Flight,
    agents,
    freeze,
    is_listening,
    is_running,
    landed,
    mission,
    simulate,
    wait_until,
    worker_of,
    write_site_of_nobody,
)
from tests.missions.promises import broken_in

FROZEN_S = 0.8
"""Longer than the base waits for a beat, shorter than anybody is given up."""


def saved_world(folder: Path) -> Path:
    plan, world = folder / "plan.yaml", folder / "world.npz"
    plan.write_text(yaml.safe_dump(ONE_ROOM))
    save_world(load_world(str(plan)), world)
    return world


def test_an_operator_who_interrupts_gets_a_mission_that_was_ended_properly(tmp_path: Path) -> None:
    """The first Ctrl-C pauses, the second one aborts."""
    process = simulate(ONE_ROOM, tmp_path)
    wait_until(lambda: is_running(tmp_path / "runs", "take the scan"), process)
    process.send_signal(signal.SIGINT)
    wait_until(lambda: is_running(tmp_path / "runs", "pause ordered?"), process)
    assert_nothing_heavy_ticks(process.pid)
    process.send_signal(signal.SIGINT)
    flight = landed(process, tmp_path)
    assert flight.code == 4, flight.stderr
    assert flight.said["outcome"] == flight.read("state.json")["outcome"] == "aborted"
    assert "Traceback" not in flight.stderr
    last = {event["path"]: event["after"] for event in flight.events_of("node")}
    assert "RUNNING" not in last.values()
    assert (flight.folder / "report.html").is_file()
    config = load_config(flight.folder / "config.yaml")
    assert not any(map(is_listening, (config.scanner.control, config.base.control)))


def assert_nothing_heavy_ticks(pid: int) -> None:
    """What the process has mapped of libraries that take seconds to load or hold the interpreter while they work."""
    mapped = Path(f"/proc/{pid}/maps").read_text()
    assert "/numpy/" in mapped
    assert [name for name in ("open3d", "llvmlite", "cv2", "scipy", "matplotlib") if f"/{name}" in mapped] == []


def test_an_operator_who_interrupts_before_anything_moved_is_obeyed_too(tmp_path: Path) -> None:
    process = mission("run", write_site_of_nobody(tmp_path), f"--out={tmp_path / 'runs'}")
    wait_until(lambda: any((tmp_path / "runs").glob("*/config.yaml")), process)
    process.send_signal(signal.SIGTERM)
    flight = landed(process, tmp_path)
    assert flight.code == 4, flight.stderr
    assert "Traceback" not in flight.stderr


def test_a_failed_scan_and_a_person_in_the_way_do_not_end_a_mission(tmp_path: Path) -> None:
    scenario = tmp_path / "scenario.yaml"
    person = {"kind": "person", "waypoints": [[100, 2.7, 2.3], [500, 2.7, 2.3]]}
    scenario.write_text(yaml.safe_dump({"scanner": {"fail_first": 1}, "tracks": [person]}))
    flight = landed(simulate(ONE_ROOM, tmp_path, f"--set={ENOUGH}", f"--scenario={scenario}"), tmp_path)
    assert flight.code == 0, flight.stderr
    assert "SCAN_FAILED" in [event["code"] for event in flight.events_of("failure")]
    assert flight.read("state.json")["scans"][0]["scan_id"] == "S02"
    assert any(event["purpose"] == "view" and event["result"] == "arrived" for event in flight.events_of("drive"))
    told = flight.read("evaluation.json")
    assert (told["rooms_finished"], told["collisions"]) == (1, 0)
    assert told["pose_error_max_m"] < 0.01


def test_with_a_scanner_that_fails_its_self_test_nothing_begins(tmp_path: Path) -> None:
    scenario = tmp_path / "scenario.yaml"
    scenario.write_text(yaml.safe_dump({"scanner": {"self_test": ["the mirror does not reach its speed"]}}))
    flight = landed(simulate(ONE_ROOM, tmp_path, f"--scenario={scenario}"), tmp_path)
    assert flight.code == 7, flight.stderr
    assert "scanner's self-test: the mirror does not reach its speed" in flight.stderr
    assert [event["kind"] for event in flight.events] == ["preflight", "agent", "agent"]


def test_agents_serve_one_mission_after_another_until_one_of_them_dies(tmp_path: Path) -> None:
    """Each calls its first scan S01 and its first goal G001, and none is given what the one before it left.

    In one of them each process freezes for a while, which costs no more than that.
    """
    folders = [tmp_path / name for name in ("killed", "frozen", "alone")]
    with agents(saved_world(tmp_path), tmp_path) as up:
        commands = (
            mission("run", up.site, f"--out={folder / 'runs'}", "--json", f"--set={ENOUGH}") for folder in folders
        )
        killed = next(commands)
        wait_until(lambda: is_running(folders[0] / "runs", "take the scan"), killed)
        killed.kill()
        killed.communicate()
        process = next(commands)
        wait_until(lambda: is_running(folders[1] / "runs", "take the scan"), process)
        worker = worker_of(process.pid)
        assert worker is not None
        for pid in (up.base.pid, process.pid, up.scanner.pid, worker):
            freeze(pid, FROZEN_S)
        flight = landed(process, folders[1])
        assert flight.code == 0, flight.stderr
        assert [room["scans"] for room in flight.said["rooms"]] == [2]
        assert (flight.folder / "building.e57").is_file()
        assert (flight.folder / "report.html").is_file()
        assert scans_taken(tmp_path / "truth") == 1 + 2
        assert evaluated(flight.folder, read_truth(tmp_path / "truth")) < 0.01
        assert broken_in(tmp_path) == []
        assert up.scanner.poll() is up.base.poll() is None

        process = next(commands)
        wait_until(lambda: scans_taken(tmp_path / "truth") == 1 + 2 + 1, process)
        up.scanner.kill()
        flight = landed(process, folders[2])
        assert flight.code == 3, flight.stderr
        assert flight.said["outcome"] == "incomplete"
        assert [room["reason_ended"] for room in flight.said["rooms"]] == ["AGENT_UNREACHABLE"]
        assert flight.seconds < 60
        assert up.base.poll() is None


def scans_taken(truth: Path) -> int:
    return sum(event["event"] == "scan" for event in read_truth(truth))


def evaluated(folder: Path, truth: list[dict[str, Any]]) -> float:
    """The worst error of a pose, metres, against where the simulator says that the mission's own scans were taken."""
    run = read_run(folder)
    true = true_poses(run, truth)
    assert sorted(true) == ["S01", "S02"]
    return max(pose["error_m"] for pose in pose_errors(run, world_from_map(run, true), true))


def test_without_agents_a_mission_says_who_is_missing_within_seconds(unanswered: "Future[Flight]") -> None:
    flight = unanswered.result()
    assert flight.code == 6
    assert flight.stdout == ""
    assert "scanner: " in flight.stderr
    assert "base: " in flight.stderr
    assert flight.seconds < 30
