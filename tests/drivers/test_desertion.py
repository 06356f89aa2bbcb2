"""Agents that a mission started for itself end when nobody runs it any more, and not before."""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from drivers.processes import birth_of
from drivers.simulated.desertion import GRACE_S, deserted


def serve(file: Path, pid: int) -> None:
    file.write_text(json.dumps({"endpoint": "ipc://somewhere", "pid": pid, "birth": birth_of(pid)}))


def gone() -> int:
    """The id of a process that has ended."""
    process = subprocess.Popen([sys.executable, "-c", ""])
    process.wait()
    return process.pid


class Watch:
    """A clock that advances when it is waited by, and what befalls at which second of it."""

    def __init__(self, befalls: dict[float, Callable[[], None]]) -> None:
        self.seconds = 0.0
        self._befalls = dict(befalls)

    def now(self) -> float:
        return self.seconds

    def wait(self, seconds: float) -> None:
        self.seconds += seconds
        for due in [at for at in self._befalls if at <= self.seconds]:
            self._befalls.pop(due)()


def deserted_after(file: Path, befalls: dict[float, Callable[[], None]]) -> float:
    """Seconds after which the agent ends."""
    watch = Watch(befalls)
    assert deserted(file, GRACE_S, watch.now, watch.wait).wait(20.0)
    return watch.seconds


def test_an_agent_ends_when_its_mission_was_left_for_long_enough(tmp_path: Path) -> None:
    file = tmp_path / "control.json"
    serve(file, gone())
    assert deserted_after(file, {}) == pytest.approx(GRACE_S, abs=1.0)


def test_an_agent_stays_with_whoever_runs_its_mission(tmp_path: Path) -> None:
    """One runs it for long, then nobody; another takes it up in time, and leaves it for good."""
    file, nobody = tmp_path / "control.json", gone()
    serve(file, os.getpid())
    befalls: dict[float, Callable[[], None]] = {
        2 * GRACE_S: lambda: serve(file, nobody),
        2.9 * GRACE_S: lambda: serve(file, os.getpid()),
        5 * GRACE_S: file.unlink,
    }
    assert deserted_after(file, befalls) == pytest.approx(6 * GRACE_S, abs=2.0)
