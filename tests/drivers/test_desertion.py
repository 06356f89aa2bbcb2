"""Agents that a mission started for itself end when nobody runs it any more, and not before."""

import json
import os
import subprocess
import sys
import time
from pathlib import Path

from drivers.simulated.desertion import deserted
from tests.drivers.wire_fakes import eventually


def serve(file: Path, pid: int) -> None:
    file.write_text(json.dumps({"endpoint": "ipc://somewhere", "pid": pid}))


def gone() -> int:
    """The id of a process that has ended."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


def test_an_agent_ends_when_its_mission_was_left_for_long_enough(tmp_path: Path) -> None:
    file = tmp_path / "control.json"
    serve(file, gone())
    over = deserted(file, grace=0.4)
    assert not over.wait(0.2)
    eventually(over.is_set)


def test_an_agent_stays_with_whoever_runs_its_mission(tmp_path: Path) -> None:
    file = tmp_path / "control.json"
    serve(file, os.getpid())
    over = deserted(file, grace=0.3)
    assert not over.wait(0.9)
    serve(file, gone())
    time.sleep(0.15)
    serve(file, os.getpid())  # somebody else takes it up
    assert not over.wait(0.9)
    file.unlink()
    eventually(over.is_set)
