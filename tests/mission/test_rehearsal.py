"""A rehearsal's configuration and its agents' processes; whole missions are flown in ``tests/missions``."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
import yaml

from drivers.wire.endpoints import Endpoints
from mission import rehearsal
from mission.config import ConfigError, dump_config, load_config
from mission.rehearsal import Rehearsal, configure, rehearse
from mission.run import UnreachableError
from tests.missions.flights import ONE_ROOM

SCANNER = Endpoints("tcp://127.0.0.1:5601", bulk="tcp://127.0.0.1:5602")
BASE = Endpoints("tcp://127.0.0.1:5611", telemetry="tcp://127.0.0.1:5612")


@pytest.mark.parametrize(
    ("world", "site"),
    [
        ("school", "school-3"),
        ("my plans/Haus Nord (2).yaml", "haus-nord-2-3"),
        ("/x/ä.glb", "world-3"),
        ("---", "world-3"),
    ],
)
def test_the_site_is_named_after_its_world_and_seed(world: str, site: str) -> None:
    assert Rehearsal(world, seed=3).site == site


@pytest.mark.parametrize("world", ["école.yaml", "Ä.glb", "日本.ifc", "x" * 200, "a/b/.yaml"])
def test_any_file_name_makes_a_site_that_a_configuration_takes(world: str) -> None:
    configure(Rehearsal(world), SCANNER, BASE)


def test_the_configuration_is_what_a_site_with_such_agents_would_have(tmp_path: Path) -> None:
    plan = Rehearsal("school", step_deg=0.4, speed=12.0, overrides=("settings.room.max_scans=4",))
    config = configure(plan, SCANNER, BASE)
    assert (config.clock_rate, config.settings.scanning.step_deg, config.settings.room.max_scans) == (12.0, 0.4, 4)
    assert config.scanner.bulk == SCANNER.bulk
    assert config.base.telemetry == BASE.telemetry
    path = tmp_path / "config.yaml"
    path.write_text(dump_config(config))
    assert load_config(path) == config


@pytest.mark.parametrize(
    "override",
    [
        "settings.room.voxel=0.2",
        "settings.scanning.step_deg=fine",
        "settings.scanning.step_deg=-0.2",
        "settings.room.max_scans=0",
        "settings.room.growing_rate=1.5",
        "clock_rate=-1",
    ],
)
def test_an_override_that_breaks_a_rule_is_refused_by_its_key(override: str) -> None:
    with pytest.raises(ConfigError, match=override.partition("=")[0]):
        configure(Rehearsal("school", overrides=(override,)), SCANNER, BASE)


def test_an_agent_that_does_not_come_up_says_why(tmp_path: Path) -> None:
    absent = tmp_path / "absent.npz"
    arguments = [f"--world={absent}", f"--truth={tmp_path}", "--plant=tcp://127.0.0.1:*"]
    with pytest.raises(UnreachableError, match=r"base.*absent\.npz"), rehearsal._process("base", arguments, tmp_path):
        pass


def test_an_agent_is_ended_whatever_happens_to_who_started_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", str(_talker(tmp_path)))
    with pytest.raises(ZeroDivisionError), rehearsal._process("base", [], tmp_path) as told:
        assert told["group"] != str(os.getpgrp()), "the operator's Ctrl-C must not reach it"
        raise ZeroDivisionError
    with pytest.raises(ProcessLookupError):
        os.kill(int(told["pid"]), 0)


def _talker(folder: Path) -> Path:
    """An agent that says who it is and then waits, without the time it takes to load a real one."""
    script = folder / "talker"
    script.write_text(
        f"#!{sys.executable}\n"
        "import json, os, time\n"
        "print(json.dumps({'pid': str(os.getpid()), 'group': str(os.getpgrp())}), flush=True)\n"
        "time.sleep(60)\n"
    )
    script.chmod(0o755)
    return script


def test_an_agent_that_stays_silent_is_given_up(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rehearsal, "_COMING_UP_S", 0.2)
    with subprocess.Popen(["sleep", "60"], stdout=subprocess.PIPE, text=True) as silent:
        assert rehearsal._first_line(silent) == ""


def test_an_unknown_key_of_a_scenario_is_refused_by_its_name(tmp_path: Path) -> None:
    scenario = tmp_path / "scenario.yaml"
    scenario.write_text("scanner: {fail_frist: 1}")
    with pytest.raises(ConfigError, match="fail_frist"):
        rehearse(Rehearsal("school", scenario=scenario), tmp_path)


def test_a_signal_while_the_agents_end_takes_nothing_from_a_mission_that_has_ended(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    @contextmanager
    def interrupted(*_: object) -> Iterator[tuple[Endpoints, Endpoints]]:
        yield SCANNER, BASE
        for number in (signal.SIGINT, signal.SIGTERM):
            os.kill(os.getpid(), number)

    monkeypatch.setattr(rehearsal, "agents", interrupted)
    monkeypatch.setattr(rehearsal, "run_mission", lambda *_: "its summary")
    plan = tmp_path / "plan.yaml"
    plan.write_text(yaml.safe_dump(ONE_ROOM))
    assert rehearse(Rehearsal(str(plan)), tmp_path / "runs") == "its summary"
