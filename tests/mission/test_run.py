"""Before and around a mission: agents that are asked, signals that are heard, and figures that are summed up."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.interfaces import BaseInfo, ScannerInfo
from drivers.jobs import Running
from mission import run
from mission.run import UnreachableError, operator_command, preflight, summarise, wait_for
from mission.store import RunFolder
from perception.failure import Failure
from tests.behaviours.bench import HandJob, standing


def done(value: object) -> HandJob:
    job = HandJob()
    job.done(value)
    return job


def failed(code: str) -> HandJob:
    job = HandJob()
    job.failed(code)
    return job


SCANNER, BASE = ScannerInfo("vz-400", "S1", 1), BaseInfo("guardian", "B1", 1, (0.9, 0.6))


class Notes:
    def __init__(self) -> None:
        self.events: list[dict[str, Any]] = []

    def record(self, kind: str, /, **figures: object) -> None:
        self.events.append({"kind": kind, **figures})


def look(scanner: HandJob, base: HandJob, state: object = None) -> list[dict[str, Any]]:
    notes = Notes()
    devices = SimpleNamespace(info=lambda: scanner), SimpleNamespace(info=lambda: base, state=lambda: state)
    preflight(*devices, notes)  # type: ignore[arg-type]
    return notes.events


def test_both_agents_are_on_record_before_anything_moves() -> None:
    events = look(done(SCANNER), done(BASE), standing())
    assert [(event["name"], event["model"], event["serial"]) for event in events] == [
        ("scanner", "vz-400", "S1"),
        ("base", "guardian", "B1"),
    ]


def test_everybody_who_does_not_answer_is_named() -> None:
    with pytest.raises(UnreachableError, match=r"scanner: AGENT_UNREACHABLE.*; base: PROTOCOL_MISMATCH"):
        look(failed("AGENT_UNREACHABLE"), failed("PROTOCOL_MISMATCH"))


def test_a_base_that_answers_but_tells_nothing_is_unreachable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(run, "_PREFLIGHT_S", 0.1)
    with pytest.raises(UnreachableError, match="base: no telemetry"):
        look(done(SCANNER), done(BASE), None)


def test_two_silent_agents_cost_no_more_patience_than_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """Both are asked before either is waited for."""
    asked: list[str] = []

    class Silent(HandJob):
        def poll(self) -> Running:
            assert asked == ["scanner", "base"]
            return Running()

    def ask(name: str) -> Silent:
        asked.append(name)
        return Silent()

    monkeypatch.setattr(run, "_PREFLIGHT_S", 0.1)
    devices = SimpleNamespace(info=lambda: ask("scanner")), SimpleNamespace(info=lambda: ask("base"))
    with pytest.raises(UnreachableError):
        preflight(*devices, Notes())  # type: ignore[arg-type]


def test_a_job_that_never_ends_is_cancelled_in_the_end() -> None:
    job = HandJob()
    began = time.monotonic()
    answer = wait_for(job, 0.1)
    assert isinstance(answer, Failure)
    assert answer.code == "AGENT_UNREACHABLE"
    assert job.cancelled == 1
    assert time.monotonic() - began < 5


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_signal_is_the_operators_word_and_only_while_it_is_listened_to(number: signal.Signals) -> None:
    before = signal.getsignal(number)
    with operator_command() as command:
        assert command() == "run"
        os.kill(os.getpid(), number)
        assert command() == "abort"
        os.kill(os.getpid(), number)
        assert command() == "abort", "an impatient operator does no harm"
    assert signal.getsignal(number) is before


def test_the_summary_has_the_last_rates_of_each_room(tmp_path: Path) -> None:
    cycles = [
        {"growing_rate": 1.0, "occluded_decrease_rate": 0.8},
        {"growing_rate": 0.1, "occluded_decrease_rate": 0.2},
    ]
    rooms = [
        {"id": "R1", "scans": ["S01", "S02"], "reason_ended": "lambda_mu", "cycles": cycles},
        {"id": "R2", "scans": [], "reason_ended": "REG_DIVERGED", "cycles": []},
    ]
    state = {"outcome": "incomplete", "rooms": rooms, "scans": [{}, {}], "wall_s": 3.0, "simulated_s": 30.0}
    summary = summarise(RunFolder(tmp_path), state)
    assert (summary.run, summary.scans, summary.outcome) == (str(tmp_path), 2, "incomplete")
    assert [room["growing_rate"] for room in summary.rooms] == [0.1, None]
    assert [room["scans"] for room in summary.rooms] == [2, 0]


def test_the_process_that_ticks_loads_neither_open3d_nor_numba() -> None:
    code = "import sys, mission.run, mission.rehearsal; print([m for m in ('open3d', 'numba') if m in sys.modules])"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert said.strip() == "[]"
