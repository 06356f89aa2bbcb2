"""One mission from a configuration to its report: connect, tick to the end, write down what came of it."""

import time
from contextlib import ExitStack, closing
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from behaviours.services import Journal, Services
from drivers.wire.base_client import BaseClient
from drivers.wire.naming import new_mission
from drivers.wire.scanner_client import ScannerClient
from mission.attempt import attempt
from mission.bulletin import Bulletin, Display
from mission.chronicle import Chronicle, waiting_for_room
from mission.clock import MissionClock
from mission.config import SiteConfig, dump_config
from mission.control import Console, serving
from mission.executive import Executive
from mission.journal import DurableJournal, JsonLines
from mission.keys import sockets_to
from mission.ledger import Ledger
from mission.operator import Desk, Word, signals
from mission.ownership import ownership
from mission.phase import Course, State
from mission.preflight import UnreachableError, preflight
from mission.remembering import heeding, remembering
from mission.state import reason_of
from mission.store import RunFolder, write_text
from mission.worker import PerceptionWorker
from perception.failure import FailureError
from trees.building import create_root


@dataclass(frozen=True)
class Summary:
    """How a mission ended, as ``--json`` prints it; ``reason`` is what went wrong at the end, empty if nothing did."""

    run: str
    outcome: str
    rooms: list[dict[str, Any]]
    scans: int
    wall_s: float
    simulated_s: float
    reason: str


def run_mission(config: SiteConfig, folder: RunFolder, display: Display | None = None, paused: bool = False) -> Summary:
    """Run a mission with agents that are up, and leave a run folder with its state.

    A folder whose mission was interrupted is taken up where that one was.

    Args:
        paused: whether nothing moves before the operator says so.

    Raises:
        UnreachableError: when an agent does not answer; nothing has moved then.
        NoGoError: when anything else speaks against a start.
        FailureError: ``LEDGER_IN_USE`` when the mission is being run already, ``LEDGER_BAD``.
    """
    newest: dict[str, Any] = {}
    began, started = time.monotonic(), _utc()
    # Signals are given back last: how the mission ended stands by then, and there is nothing left to abort.
    with ExitStack() as at_the_end, ExitStack() as stack:
        ledger = stack.enter_context(closing(Ledger(folder.ledger)))
        write_text(folder.config, dump_config(config))
        clock = MissionClock(config.clock_rate, begin=ledger.newest_time())
        chronicle = Chronicle(ledger, clock)
        lines = JsonLines(folder.events, clock, watch=lambda event: newest.update({event["kind"]: event}))
        stack.callback(lines.close)
        journal = DurableJournal(ledger, lines, clock)
        stack.callback(attempt, "the last events are not in the ledger", journal.commit)
        word, desk = Word(paused), Desk(clock, journal, config.settings.operator.ask)
        console = Console(word, desk)
        stack.enter_context(serving(console, folder.path))
        name = ledger.name(new_mission())
        scanner = ScannerClient(config.scanner, sockets=sockets_to(config, config.scanner), mission=name)
        base = BaseClient(config.base, sockets=sockets_to(config, config.base), mission=name)
        stack.callback(base.close)
        preflight(config, scanner, base, journal, folder.path, chronicle.scans_taken)
        try:
            lease = stack.enter_context(ownership(base))
        except FailureError as error:
            raise UnreachableError(f"base: {error}") from error
        worker = PerceptionWorker(folder.path, journal, config.settings.worker)
        stack.callback(worker.close)
        worker.submit("warm_up")
        at_the_end.enter_context(signals(word))
        services = Services(scanner, base, worker, clock, journal, folder, config.settings, desk, owner=lease.owner)
        services = remembering(services, chronicle)
        bulletin = Bulletin(folder, console, desk, newest, clock.now, display)
        stack.callback(bulletin.close)

        def after_tick(tick: int) -> None:
            worker.watch()
            commit(journal)
            bulletin.tell(executive, tick)

        executive = Executive(
            create_root(config.settings),
            services,
            clock,
            heeding(word, chronicle),
            after_tick,
            Course(lambda before, after: record_phase(journal, before, after)),
            f"`mission resume {folder.path}` goes on, Ctrl-C again aborts",
            chronicle.tell,
        )
        journal.record("mission_resumed" if chronicle.telling else "mission_started", site=config.site, mission=name)
        outcome = executive.run()
        ended = {
            "outcome": outcome,
            "started": started,
            "ended": _utc(),
            "wall_s": round(time.monotonic() - began, 2),
            "simulated_s": round(clock.now(), 1),
        }
        journal.record("mission_ended", outcome=outcome, tick_ms=executive.tick_ms())
        state = bulletin.state(executive) | ended
        attempt("state.json does not tell the end", lambda: folder.write_state(state))
    return summarise(folder, state)


def commit(journal: DurableJournal) -> None:
    """Bring the events of a tick to the disk; a full disk gets them later, when there is room again."""
    with waiting_for_room():
        journal.commit()


def record_phase(journal: Journal, before: State, after: State) -> None:
    """One row for each change of phase."""
    journal.record("phase", before=before.phase.value, after=after.phase.value, code=after.code, message=after.message)


def summarise(folder: RunFolder, state: dict[str, Any]) -> Summary:
    """The few figures of a mission's state that its caller wants to know at once."""
    return Summary(
        run=str(folder.path),
        outcome=state["outcome"],
        rooms=[_room_summary(room) for room in state["rooms"]],
        scans=len(state["scans"]),
        wall_s=state["wall_s"],
        simulated_s=state["simulated_s"],
        reason=reason_of(state),
    )


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
