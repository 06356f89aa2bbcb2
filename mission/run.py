"""One mission from a configuration to its report: connect, tick to the end, write down what came of it."""

import signal
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, TypeVar

from behaviours.services import Services
from drivers.interfaces import Base, Scanner
from drivers.jobs import Done, Failed, Job
from drivers.wire.base_client import BaseClient
from drivers.wire.scanner_client import ScannerClient
from mission.clock import MissionClock
from mission.config import SiteConfig, dump_config
from mission.executive import Executive
from mission.journal import JsonLines
from mission.state import describe
from mission.store import RunFolder, write_text
from mission.worker import PerceptionWorker
from perception.failure import Failure
from trees.building import create_root

T = TypeVar("T")

_PREFLIGHT_S = 30.0
_STOP_SIGNALS = (signal.SIGINT, signal.SIGTERM)


class UnreachableError(Exception):
    """An agent did not answer before the mission began."""


@dataclass(frozen=True)
class Summary:
    """How a mission ended, as ``--json`` prints it."""

    run: str
    outcome: str
    rooms: list[dict[str, Any]]
    scans: int
    wall_s: float
    simulated_s: float


Display = Callable[[Executive, dict[str, Any]], None]
"""Shows progress after each tick: the executive, and the newest event of each kind."""


def run_mission(config: SiteConfig, folder: RunFolder, display: Display | None = None) -> Summary:
    """Run a mission with agents that are up, and leave a run folder with its state.

    Raises:
        UnreachableError: when an agent does not answer; nothing has moved then.
    """
    write_text(folder.config, dump_config(config))
    clock = MissionClock(config.clock_rate)
    newest: dict[str, Any] = {}
    began, started = time.monotonic(), _utc()
    with ExitStack() as stack:
        journal = JsonLines(folder.events, clock, watch=lambda event: newest.update({event["kind"]: event}))
        stack.callback(journal.close)
        scanner = ScannerClient(config.scanner)
        base = BaseClient(config.base)
        stack.callback(base.close)
        preflight(scanner, base, journal)
        worker = PerceptionWorker(folder.path, journal)
        stack.callback(worker.close)
        worker.submit("warm_up")
        command = stack.enter_context(operator_command())
        services = Services(scanner, base, worker, clock, journal, folder, config.settings)
        root = create_root(config.settings)

        def after_tick(ticks: int) -> None:
            if executive.changed:
                folder.write_state(describe(executive.survey))
            if display is not None:
                display(executive, newest)

        executive = Executive(root, services, clock.sleep, command, after_tick)
        journal.record("mission_started", site=config.site)
        outcome = executive.run()
        ended = {
            "outcome": outcome,
            "started": started,
            "ended": _utc(),
            "wall_s": round(time.monotonic() - began, 2),
            "simulated_s": round(clock.now(), 1),
        }
        journal.record("mission_ended", outcome=outcome)
        state = describe(executive.survey) | ended
        folder.write_state(state)
    return summarise(folder, state)


def summarise(folder: RunFolder, state: dict[str, Any]) -> Summary:
    """The few figures of a mission's state that its caller wants to know at once."""
    return Summary(
        run=str(folder.path),
        outcome=state["outcome"],
        rooms=[_room_summary(room) for room in state["rooms"]],
        scans=len(state["scans"]),
        wall_s=state["wall_s"],
        simulated_s=state["simulated_s"],
    )


def preflight(scanner: Scanner, base: Base, journal: JsonLines) -> None:
    """Ask both agents who they are and wait for the base's telemetry; all must be there before anything moves."""
    # Both are asked before either is waited for: two silent agents cost no more patience than one.
    scanner_says, base_says = scanner.info(), base.info()
    answers = {"scanner": wait_for(scanner_says, _PREFLIGHT_S), "base": wait_for(base_says, _PREFLIGHT_S)}
    silent = [f"{name}: {answer}" for name, answer in answers.items() if isinstance(answer, Failure)]
    if silent:
        raise UnreachableError("; ".join(silent))
    until = time.monotonic() + _PREFLIGHT_S
    while base.state() is None:
        if time.monotonic() > until:
            raise UnreachableError(f"base: no telemetry within {_PREFLIGHT_S:.0f} s")
        time.sleep(0.02)
    for name, answer in answers.items():
        assert not isinstance(answer, Failure)
        journal.record("agent", name=name, model=answer.model, serial=answer.serial, protocol=answer.protocol)


def wait_for(job: Job[T], seconds: float) -> T | Failure:
    """Block until a job has ended; only for use outside of the tick."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        outcome = job.poll()
        if isinstance(outcome, Done):
            return outcome.value
        if isinstance(outcome, Failed):
            return outcome.failure
        time.sleep(0.02)
    job.cancel()
    return Failure("AGENT_UNREACHABLE", f"no answer within {seconds:.0f} s")


@contextmanager
def operator_command() -> Iterator[Callable[[], str]]:
    """The operator's word from the signals: Ctrl-C or SIGTERM ends the mission safely, whatever it is doing."""
    ordered: list[int] = []
    before = {number: signal.signal(number, lambda got, _: ordered.append(got)) for number in _STOP_SIGNALS}
    try:
        yield lambda: "abort" if ordered else "run"
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _room_summary(room: dict[str, Any]) -> dict[str, Any]:
    last = room["cycles"][-1] if room["cycles"] else {}
    return {
        "id": room["id"],
        "scans": len(room["scans"]),
        "reason_ended": room["reason_ended"],
        "growing_rate": last.get("growing_rate"),
        "occluded_decrease_rate": last.get("occluded_decrease_rate"),
    }


def _utc() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
