"""The command line: what it refuses and how, what it prints, and what it does not load."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import yaml
from typer.testing import CliRunner, Result

from mission import cli, finish, rehearsal
from mission.preflight import NoGoError, UnreachableError
from mission.run import Summary
from mission.store import RunFolder
from tests.mission.fake_run import write_run

SITE = {
    "site": "laboratory",
    "scanner": {"control": "tcp://127.0.0.1:1", "bulk": "tcp://127.0.0.1:1"},
    "base": {"control": "tcp://127.0.0.1:1", "telemetry": "tcp://127.0.0.1:1"},
}
HEAVY = ("open3d", "numba", "matplotlib", "scipy", "cv2", "pye57", "zmq")


def call(*arguments: object) -> Result:
    return CliRunner().invoke(cli.app, [str(argument) for argument in arguments])


def refused(*arguments: object) -> str:
    result = call(*arguments)
    assert result.exit_code == 2, result.output
    assert result.stdout == ""
    assert "Traceback" not in result.stderr
    return " ".join(result.stderr.split())


def loaded_by(*arguments: str) -> set[str]:
    """Which of the heavy modules are loaded once a command has ended."""
    code = (
        "import atexit, sys\n"
        f"atexit.register(lambda: print(*[m for m in {HEAVY} if m in sys.modules], file=sys.stderr))\n"
        f"sys.argv = ['mission', *{list(arguments)}]\n"
        "from mission.cli import main\n"
        "main()\n"
    )
    return set(subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stderr.split())


@pytest.mark.parametrize("arguments", [("--help",), ("simulate", "--help"), ("agent", "scanner", "--help")])
def test_help_answers_without_loading_anything_heavy(arguments: tuple[str, ...]) -> None:
    assert loaded_by(*arguments) == set()


def test_drawing_the_tree_as_text_needs_neither_perception_nor_sockets() -> None:
    assert loaded_by("tree").isdisjoint({"open3d", "numba", "matplotlib", "zmq"})


@pytest.mark.parametrize("command", ["simulate", "run", "agent", "tree", "report", "evaluate", "process", "doctor"])
def test_every_command_is_in_the_help(command: str) -> None:
    assert command in call("--help").stdout


def test_a_command_that_does_not_exist_is_refused() -> None:
    assert "simulat" in refused("simulat")


# --- refusals: the file or the key by its name, one message, exit code 2 -------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (("--profile", "vz-4000"), "--profile: expected vz-400 or vz-400i, found 'vz-4000'"),
        (("--scenario", "absent.yaml"), "--scenario absent.yaml: "),
        (("--set", "settings.room.max_scan=3"), "settings.room.max_scan: unknown key; did you mean 'max_scans'?"),
        (("--set", "settings.room.max_scans=[3"), "--set settings.room.max_scans=[3: the value is not YAML"),
        (("--set", "settings.room.labeller=magic"), "settings.room.labeller: "),
        (("--start", "1,2"), "--start: expected x,y,yaw, found '1,2'"),
        (("--step", "0"), "'--step'"),
        (("--speed", "-3"), "'--speed'"),
        (("--storey", "EG"), "storey"),
    ],
)
def test_a_rehearsal_with_a_wrong_option_is_refused_before_anything_is_made(
    arguments: tuple[str, ...], named: str, tmp_path: Path
) -> None:
    assert named in refused("simulate", "school", "--out", tmp_path / "runs", *arguments)
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("text", "complaint"),
    [("tracks: 3", "tracks"), ("scanner: {fail_first: often}", "fail_first"), ("tracks: [", "scenario.yaml")],
)
def test_a_scenario_that_breaks_a_rule_is_refused_by_its_key(text: str, complaint: str, tmp_path: Path) -> None:
    scenario = tmp_path / "scenario.yaml"
    scenario.write_text(text)
    message = refused("simulate", "school", "--scenario", scenario, "--out", tmp_path / "runs")
    assert message.startswith(f"--scenario {scenario}")
    assert complaint in message


@pytest.mark.parametrize(
    ("world", "complaint"), [("atlantis", "'atlantis' is neither school"), ("absent.yaml", "there is no file")]
)
def test_a_world_that_is_not_there_is_refused(world: str, complaint: str, tmp_path: Path) -> None:
    assert complaint in refused("simulate", world, "--out", tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_every_error_of_a_plan_is_told_with_its_key(tmp_path: Path) -> None:
    plan = tmp_path / "plan.yaml"
    rooms = {"hall": {"box": [0, 0, 4, 4], "colour": "red"}}
    plan.write_text(yaml.safe_dump({"name": "x", "rooms": rooms, "doors": [{"room": "hall", "at": [1]}]}))
    message = refused("simulate", plan, "--out", tmp_path / "runs")
    assert "rooms.hall.colour" in message
    assert "doors.0.at" in message


def test_every_error_of_a_site_is_told_at_once(tmp_path: Path) -> None:
    site = tmp_path / "site.yaml"
    site.write_text(yaml.safe_dump({**SITE, "scaner": {}, "clock_rate": 0}))
    message = refused("run", site, "--out", tmp_path / "runs")
    assert f"{site}: scaner: unknown key; did you mean 'scanner'?" in message
    assert f"{site}: clock_rate: " in message
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize("command", ["run", "report", "evaluate", "process"])
def test_what_is_not_there_is_named(command: str, tmp_path: Path) -> None:
    assert str(tmp_path / "absent") in refused(command, tmp_path / "absent")


@pytest.mark.parametrize(
    ("command", "code"), [("report", "RUN_UNREADABLE"), ("evaluate", "WORLD_UNREADABLE"), ("process", "RECORDED_NONE")]
)
def test_a_folder_that_holds_something_else_is_refused(command: str, code: str, tmp_path: Path) -> None:
    assert refused(command, tmp_path).startswith(code)


def test_an_agent_without_a_world_is_refused(tmp_path: Path) -> None:
    world = tmp_path / "absent.npz"
    common = ("--world", world, "--truth", tmp_path, "--plant", "tcp://127.0.0.1:*")
    assert str(world) in refused("agent", "scanner", *common)
    assert str(world) in refused("agent", "base", *common)


# --- how a mission's end becomes an exit code ------------------------------------------------------------------------


def ending(outcome: str, reason: str = "") -> Callable[..., Summary]:
    room = {"id": "R1", "scans": 2, "reason_ended": "lambda_mu", "growing_rate": 0.01, "occluded_decrease_rate": 0.02}
    return lambda *_: Summary("runs/x", outcome, [room], 2, 61.0, 610.0, reason)


@pytest.fixture
def delivered(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The runs whose deliveries were asked for; all of them are made."""
    runs: list[str] = []
    monkeypatch.setattr(finish, "finish", lambda folder: runs.append(str(folder.path)) is None)
    return runs


@pytest.mark.parametrize(
    ("outcome", "code"), [("complete", 0), ("fault", 1), ("incomplete", 3), ("aborted", 4), ("safety_stop", 5)]
)
def test_the_outcome_is_the_exit_code(
    outcome: str, code: int, delivered: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rehearsal, "rehearse", ending(outcome))
    result = call("simulate", "school", "--json")
    assert result.exit_code == code
    assert list(json.loads(result.stdout)) == ["run", "outcome", "rooms", "scans", "wall_s", "simulated_s", "reason"]
    words = call("simulate", "school")
    assert words.exit_code == code
    assert f"{outcome}: 1 rooms, 2 scans in 61 s" in words.stdout
    assert "runs/x/report.html" in words.stdout
    assert delivered == ["runs/x", "runs/x"]


@pytest.mark.parametrize("how", ["a file cannot be written", "Ctrl-C"])
def test_a_mission_that_cannot_deliver_has_ended_as_it_did(how: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def kept_from(_: RunFolder) -> bool:
        if how == "Ctrl-C":
            raise KeyboardInterrupt
        return False

    monkeypatch.setattr(rehearsal, "rehearse", ending("complete"))
    monkeypatch.setattr(finish, "finish", kept_from)
    result = call("simulate", "school")
    assert result.exit_code == 0
    assert "complete: 1 rooms" in result.stdout
    assert "`mission report runs/x` writes it" in result.stderr
    assert "report.html" not in result.stdout


@pytest.mark.parametrize(
    ("outcome", "reason"),
    [
        ("complete", "NAV_BLOCKED: the robot did not come home: something stays in the way"),
        ("fault", "RESUME_DIVERGED: job 3 was take S01, but this tree begins drive G01"),
    ],
)
@pytest.mark.usefixtures("delivered")
def test_what_went_wrong_at_the_end_is_told(outcome: str, reason: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rehearsal, "rehearse", ending(outcome, reason))
    assert reason in call("simulate", "school").stdout.splitlines()
    assert json.loads(call("simulate", "school", "--json").stdout)["reason"] == reason


def raising(error: BaseException) -> Callable[..., Summary]:
    def rehearse(*_: object) -> Summary:
        raise error

    return rehearse


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (UnreachableError("the base's agent did not come up"), 6, "unreachable: "),
        (NoGoError("battery: 12%"), 7, "no-go:"),
        (KeyboardInterrupt(), 4, "aborted"),
    ],
)
def test_a_mission_that_never_began_has_its_own_code(
    error: BaseException, code: int, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(rehearsal, "rehearse", raising(error))
    result = call("simulate", "school", "--json")
    assert (result.exit_code, result.stdout) == (code, "")
    assert said in result.stderr


@pytest.mark.usefixtures("delivered")
def test_what_is_asked_for_is_what_is_rehearsed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    asked: list[tuple[rehearsal.Rehearsal, Path]] = []

    def rehearse(plan: rehearsal.Rehearsal, out: Path, _: object) -> Summary:
        asked.append((plan, out))
        return ending("complete")()

    monkeypatch.setattr(rehearsal, "rehearse", rehearse)
    options = ("--seed=3", "--step=0.4", "--profile=vz-400i", "--speed=7", "--set=a=1", "--set=b=2", "--start=1,2,90")
    call("simulate", "house.glb", *options, "--up=y", "--ceiling=2.6", f"--out={tmp_path}")
    (plan, out), *_ = asked
    assert (plan.world, plan.seed, plan.step_deg, plan.profile, plan.speed) == ("house.glb", 3, 0.4, "vz-400i", 7.0)
    assert plan.overrides == ("a=1", "b=2")
    assert plan.options == {"up": "y", "ceiling": 2.6, "start": (1.0, 2.0, pytest.approx(1.5708, abs=1e-4))}
    assert out == tmp_path


# --- commands about a run that is there ------------------------------------------------------------------------------


def test_a_report_is_written_again_where_the_run_is(tmp_path: Path) -> None:
    run = write_run(tmp_path)
    result = call("report", run.folder)
    assert (result.exit_code, result.stdout.strip()) == (0, str(run.folder / "report.html"))
    assert (run.folder / "report.html").is_file()


def test_a_report_makes_up_for_what_an_ended_mission_could_not_deliver(tmp_path: Path) -> None:
    run = write_run(tmp_path)
    assert call("report", run.folder).exit_code == 0
    cloud = run.folder / "building.e57"
    made = cloud.stat().st_mtime_ns
    assert call("report", run.folder).exit_code == 0
    assert cloud.stat().st_mtime_ns == made


@pytest.mark.parametrize("text", ["null", "[]", "{", "\xff"])
@pytest.mark.parametrize("command", ["report", "status"])
def test_a_state_that_is_none_is_named(command: str, text: str, tmp_path: Path) -> None:
    run = write_run(tmp_path)
    (run.folder / "state.json").write_bytes(text.encode("latin-1"))
    assert "state.json" in refused(command, run.folder)


def test_a_run_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    site = tmp_path / "site.yaml"
    site.write_text(yaml.safe_dump(SITE))
    (tmp_path / "file").write_text("in the way")
    assert str(tmp_path / "file" / "runs") in refused("run", site, "--out", tmp_path / "file" / "runs")


def test_a_world_that_cannot_be_read_is_named(tmp_path: Path) -> None:
    run = write_run(tmp_path)
    assert "absent.npz" in refused("evaluate", run.folder, "--world", tmp_path / "absent.npz")


# --- the tree --------------------------------------------------------------------------------------------------------


def test_the_tree_is_drawn_in_every_form(tmp_path: Path) -> None:
    text = call("tree").stdout
    assert "take the scan" in text
    assert call("tree", "--format", "dot").stdout.startswith("digraph")
    for form, signature in (("png", b"\x89PNG"), ("svg", b"<?xml")):
        path = tmp_path / f"tree.{form}"
        assert call("tree", "--format", form, "--out", path).stdout.strip() == str(path)
        assert path.read_bytes().startswith(signature)


def test_a_form_that_nobody_draws_is_refused() -> None:
    assert "found 'jpg'" in refused("tree", "--format", "jpg")


# --- the doctor ------------------------------------------------------------------------------------------------------


def test_the_doctor_says_what_it_found_as_words_and_as_json() -> None:
    words, figures = call("doctor"), call("doctor", "--json")
    assert words.exit_code == figures.exit_code == 0
    findings = json.loads(figures.stdout)
    assert [list(finding) for finding in findings] == [["what", "good", "found", "doubtful"]] * len(findings)
    assert {"Python", "numpy", "disk"} <= {finding["what"] for finding in findings}
    assert words.stdout.count("ok  ") == len(findings)


def test_the_doctor_refuses_a_site_that_breaks_a_rule(tmp_path: Path) -> None:
    site = tmp_path / "site.yaml"
    site.write_text(yaml.safe_dump({**SITE, "clock_rate": 0}))
    result = call("doctor", site, "--json")
    assert result.exit_code == 1
    bad = [finding for finding in json.loads(result.stdout) if not finding["good"]]
    assert [finding["what"] for finding in bad] == [str(site)]
    assert "clock_rate" in bad[0]["found"]
