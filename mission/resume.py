"""Taking up a mission whose executive died: with the agents it had, or with those of its rehearsal."""

import json
import os
import signal
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from mission.bulletin import Display
from mission.config import load_config
from mission.finish import finish
from mission.fsck import check
from mission.run import Summary, run_mission
from mission.store import RunFolder
from perception.failure import FailureError

_FINISHED = ("complete", "incomplete")
_PATIENCE_S = 10.0


def resume_run(path: Path, display: Display | None = None, go_on_at_once: bool = False) -> Summary:
    """Go on with an interrupted mission, from its ledger.

    It comes back paused, and moves nothing until the operator says to go on, unless ``go_on_at_once``.

    Raises:
        FailureError: ``RUN_UNREADABLE`` when the folder holds no mission that can go on, ``RUN_LOSSY`` when scans of it
            are lost, ``MISSION_ENDED`` when there is nothing to go on with, ``RESUME_DIVERGED``.
        ConfigError, UnreachableError, NoGoError: as when a mission begins.
    """
    folder = RunFolder(path)
    found = check(folder)
    if found.unusable:
        raise FailureError("RUN_UNREADABLE", "; ".join(found.unusable))
    if found.lost:
        raise FailureError("RUN_LOSSY", "; ".join(found.lost))
    outcome = _outcome(folder)
    if outcome in _FINISHED:
        raise FailureError("MISSION_ENDED", f"{path}: this mission has ended: {outcome}")
    with orphans_ended(folder):
        summary = run_mission(load_config(folder.config), folder, display, go_on_at_once)
    if folder.simulation.exists():
        from mission.evaluation import evaluate_run

        evaluate_run(path)
    finish(folder)
    return summary


def _outcome(folder: RunFolder) -> str | None:
    with suppress(OSError, ValueError):
        outcome = json.loads(folder.state.read_text(encoding="utf-8")).get("outcome")
        return None if outcome is None else str(outcome)
    return None


@contextmanager
def orphans_ended(folder: RunFolder) -> Iterator[None]:
    """A rehearsal's agents outlive an executive that was killed; they end with the mission that takes them up."""
    try:
        yield
    finally:
        with suppress(OSError, ValueError):
            for pid in json.loads(folder.agents.read_text(encoding="utf-8")):
                _end(int(pid), str(folder.simulation.resolve()))


def _end(pid: int, marked: str) -> None:
    """End a process, if it is still the agent whose command line names this rehearsal."""
    command = Path(f"/proc/{pid}/cmdline")
    until = time.monotonic() + _PATIENCE_S
    while command.exists() and marked in command.read_text(encoding="utf-8", errors="replace"):
        os.kill(pid, signal.SIGTERM if time.monotonic() < until else signal.SIGKILL)
        time.sleep(0.2)
