"""Taking up a mission whose executive died: with the agents it had, or with those of its rehearsal."""

import json
import os
import signal
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from pathlib import Path

from drivers.disk import writing
from mission.bulletin import Display
from mission.config import SiteConfig, load_config
from mission.fsck import check
from mission.ledger import Ledger
from mission.operator import deaf
from mission.run import Summary, run_mission
from mission.store import RunFolder, read_mapping, write_text
from perception.failure import FailureError

_FINISHED = ("complete", "incomplete")
_PATIENCE_S = 10.0
_AGENTS = 2


def resume_run(path: Path, display: Display | None = None, go_on_at_once: bool = False) -> Summary:
    """Go on with an interrupted mission, from its ledger.

    It comes back paused, and moves nothing until the operator says to go on, unless ``go_on_at_once``.

    Raises:
        FailureError: ``RUN_UNREADABLE`` when the folder holds no mission that can go on, ``RUN_LOSSY`` when files that
            it needs are lost, ``MISSION_ENDED`` when there is nothing to go on with, ``LEDGER_IN_USE``,
            ``RESUME_DIVERGED``.
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
        why = f"{path}: this mission has ended: {outcome}; `mission report` writes what it delivers"
        raise FailureError("MISSION_ENDED", why)
    if found.log:
        rewrite_log(folder)
    with agents_met(folder) as config:
        summary = run_mission(config, folder, display, paused=not go_on_at_once)
        deaf()  # its agents, where it is a rehearsal, are still to be ended
        return summary


def _outcome(folder: RunFolder) -> str | None:
    with suppress(FailureError):  # a state that tells nothing ends no mission: it is made again
        outcome = read_mapping(folder.state).get("outcome")
        return None if outcome is None else str(outcome)
    return None


def rewrite_log(folder: RunFolder) -> None:
    """Write the event log anew from the ledger; what was there in its place is put aside, not away."""
    with writing(folder.events), suppress(FileNotFoundError):
        folder.events.replace(folder.events.with_suffix(".damaged"))
    with closing(Ledger(folder.ledger)) as ledger:
        write_text(folder.events, "".join(f"{json.dumps(event)}\n" for event in ledger.events()))


@contextmanager
def agents_met(folder: RunFolder) -> Iterator[SiteConfig]:
    """The mission's configuration, with its agents up.

    Those of a rehearsal outlive an executive that was killed, for a while, and end with the mission that takes them up.
    Where one of them is gone, both are started anew: the simulated robot stands where it stood.
    """
    config = load_config(folder.config)
    if not folder.rehearsal.exists():
        yield config
    elif len(_agents_left(folder)) == _AGENTS:
        with orphans_ended(folder):
            yield config
    else:
        from mission.rehearsal import agents, plan_of

        with orphans_ended(folder):
            """One of them is of no use without the other."""
        with agents(plan_of(folder), folder) as (scanner, base):
            yield config.model_copy(update={"scanner": scanner, "base": base})


@contextmanager
def orphans_ended(folder: RunFolder) -> Iterator[None]:
    """End the agents that a rehearsal left behind, on the way out."""
    try:
        yield
    finally:
        for pid in _agents_left(folder):
            _end(pid, _mark(folder))


def _agents_left(folder: RunFolder) -> list[int]:
    with suppress(OSError, ValueError):
        pids = map(int, json.loads(folder.agents.read_text(encoding="utf-8")))
        return [pid for pid in pids if _is_agent(pid, _mark(folder))]
    return []


def _mark(folder: RunFolder) -> str:
    return str(folder.simulation.resolve())


def _is_agent(pid: int, marked: str) -> bool:
    """Whether a process is still the agent whose command line names this rehearsal."""
    with suppress(OSError):
        return marked in Path(f"/proc/{pid}/cmdline").read_text(encoding="utf-8", errors="replace")
    return False


def _end(pid: int, marked: str) -> None:
    until = time.monotonic() + _PATIENCE_S
    while _is_agent(pid, marked):
        os.kill(pid, signal.SIGTERM if time.monotonic() < until else signal.SIGKILL)
        time.sleep(0.2)
