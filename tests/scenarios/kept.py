"""A whole mission as ``mission run`` flies it, run folder and all, with scripted devices that deliver real files."""

import hashlib
import json
import logging
import os
import signal
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from py_trees.behaviour import Behaviour

from behaviours.services import Services
from drivers.interfaces import Base, Lease, ScanReceipt
from drivers.jobs import Progress
from drivers.messages import PROTOCOL, Body, Open, Read, Reply
from drivers.wire.client import Patience
from drivers.wire.endpoints import Endpoints
from drivers.wire.spool import Spool
from drivers.wire.transfer import fetch
from mission import run
from mission.clock import MissionClock
from mission.config import SiteConfig
from mission.executive import TICK, Executive, TickClock
from mission.journal import JsonLines, plain, read_events
from mission.ledger import Ledger
from mission.remembering import remembering
from mission.run import Summary, run_mission
from mission.store import RunFolder, save_grid, write_arrays
from perception.failure import FailureError
from perception.grids import Cell, Grid
from perception.transforms import Matrix
from tests.drivers.wire_fakes import make_scan
from tests.scenarios.bad_disk import BadDisk, Way
from tests.scenarios.lasting import LastingBase, LastingScanner
from tests.scenarios.monitor import Monitor
from tests.scenarios.play import OWNER, TICK_S
from tests.scenarios.scripted import Script, ScriptedJob, ScriptedPerception
from tests.scenarios.site import Site, row

ROOM_AFTER_TICKS = 12
"""So long after it was full, somebody makes room on the disk."""
_POINTS = 60_000


class _Link:
    """A transfer's link to a spool in the same process."""

    def __init__(self, spool: Spool) -> None:
        self._spool = spool
        self._asked: deque[tuple[str, Read]] = deque()

    def ask(self, body: Open, *_: object) -> Body:
        return self._spool.open(body.scan_id)

    def send(self, body: Read, request_id: str) -> None:
        self._asked.append((request_id, body))

    def receive(self, _seconds: float) -> Reply[Any] | None:
        request_id, read = self._asked.popleft()
        return Reply(PROTOCOL, request_id, self._spool.read(read.scan_id, read.index), "boot", 0.0)


class DeliveringScanner(LastingScanner):
    """Its scans lie in a spool of its own and come home by the real transfer."""

    def __init__(self, base: LastingBase, script: Script, folder: Path) -> None:
        super().__init__(base, script)
        self.spool = Spool(folder)

    def take(self, scan_id: str, settings: Any, odom_from_base: Matrix) -> ScriptedJob:
        job = super().take(scan_id, settings, odom_from_base)
        job.conclude_with(lambda: self._store(scan_id))
        return job

    def fetch(self, receipt: ScanReceipt, destination: Path) -> ScriptedJob:
        def bring() -> Path:
            link: Any = _Link(self.spool)
            return fetch(link, receipt, destination, Patience(), Progress())

        return self._script.job("fetch", bring)

    def _store(self, scan_id: str) -> ScanReceipt:
        stored = self.spool.find(scan_id)
        receipt = stored.receipt if stored else self.spool.store(make_scan(scan_id, _POINTS), "then", "now")
        return receipt.value()


class WritingPerception(ScriptedPerception):
    """Writes the files that the stages write, small ones."""

    def __init__(self, site: Site, scanner: DeliveringScanner, script: Script, folder: RunFolder) -> None:
        super().__init__(site, scanner, script)
        self._folder = folder

    def warm_up(self) -> None:
        """Nothing is cold."""

    def watch(self) -> None:
        """Nothing grows."""

    def build_map(self, scan_id: str, room_id: str, cycle: int, **_: Any) -> Any:
        grid = Grid(np.full((4, 4), Cell.FREE, np.uint8), (-1.0, -1.0), 0.5)
        save_grid(self._folder.map_file(f"map_{scan_id}"), grid)
        write_arrays(self._folder.evidence_file(room_id, cycle, "flatness"), data=grid.data)
        return super().build_map(scan_id)

    def label_space(self, room_id: str, cycle: int, **_: Any) -> Any:
        write_arrays(self._folder.voxel_file(room_id, cycle), labels=np.zeros((3, 3, 3), np.uint8))
        return super().label_space(room_id, cycle)

    def choose_view(self, room_id: str, cycle: int, *rest: Any, **more: Any) -> Any:
        """Of what lies in the folder, whoever labelled it."""
        if self._folder.voxel_file(room_id, cycle).exists():
            self._labelled.add((room_id, cycle))
        return super().choose_view(room_id, cycle, *rest, **more)

    def close(self) -> None:
        """There is no process."""


class Kept:
    """One mission that leaves a run folder, over as many lives as it takes.

    Args:
        folder: for the run and for the scanner's own disk.
    """

    def __init__(self, folder: Path) -> None:
        site = row(1)
        self.script = Script()
        self.run = RunFolder.at(folder / "run")
        self.base = LastingBase(site, self.script, OWNER)
        self.scanner = DeliveringScanner(self.base, self.script, folder / "scanner")
        self.perception = WritingPerception(site, self.scanner, self.script, self.run)
        self.monitor = Monitor()
        self.errors: list[str] = []
        self.recorded: list[dict[str, Any]] = []
        self._at_risk: list[dict[str, Any]] = []
        self.room_after_ticks = ROOM_AFTER_TICKS
        self.abort_when_full = False
        self._full_for = 0

    def fly(self, disk: BadDisk | None = None) -> Summary | FailureError:
        """One life; what it came to, or how it was refused. Whatever else is raised is an error of the program."""
        config = SiteConfig(
            site="kept", scanner=Endpoints("ipc://s", bulk="ipc://s"), base=Endpoints("ipc://b", telemetry="ipc://b")
        )
        self.base.beats.clear()
        with ExitStack() as stack:
            self._play_the_parts(stack, disk)
            if disk is not None:
                stack.enter_context(disk.mounted())
            try:
                summary = run_mission(config, self.run)
            except FailureError as refusal:
                return refusal
        self._assert_promises(summary.outcome)
        return summary

    def _assert_promises(self, outcome: str) -> None:
        """Nothing was done that must not be; what a disk refused of the ledger tells no more how a job ended."""
        self.monitor.assert_kept()
        if outcome in ("complete", "incomplete"):
            with closing(Ledger(self.run.ledger)) as ledger:
                self.monitor.assert_at_rest(ledger.jobs())

    def _play_the_parts(self, stack: ExitStack, disk: BadDisk | None) -> None:
        def tick(seconds: float) -> None:
            self.script.clock.sleep(seconds * TICK_S / TICK)
            self._full_for = self._full_for + 1 if disk is not None and disk.full else 0
            if disk is not None and self._full_for > self.room_after_ticks:
                disk.make_room()
            if self.abort_when_full and self._full_for > 1:
                os.kill(os.getpid(), signal.SIGTERM)

        def clock(rate: float, begin: float) -> MissionClock:
            return MissionClock(rate, self.script.clock.now, tick, begin)

        @contextmanager
        def ownership(_: Base) -> Iterator[Lease]:
            yield Lease(1, 1, OWNER)

        parts: dict[str, Any] = {
            "ScannerClient": lambda *_, **__: self.scanner,
            "BaseClient": lambda *_, **__: _Closing(self.base),
            "PerceptionWorker": lambda *_: self.perception,
            "MissionClock": clock,
            "preflight": lambda *_: None,
            "ownership": ownership,
            "sockets_to": lambda *_: None,
            "new_mission": lambda: "kept",
            "remembering": lambda services, chronicle: remembering(self.monitor.watch(services), chronicle),
            "Executive": self._watched,
        }
        stack.enter_context(patch.multiple(run, **parts))
        stack.enter_context(
            patch.object(RunFolder, "free_gb", lambda _: 0.0 if disk is not None and disk.full else 100.0)
        )
        self._note_events(stack, disk)
        handler = _Errors(self.errors)
        logging.getLogger().addHandler(handler)
        stack.callback(logging.getLogger().removeHandler, handler)

    def _watched(
        self,
        root: Behaviour,
        services: Services,
        clock: TickClock,
        command: Callable[[], str],
        after_tick: Callable[[int], None],
        *rest: Any,
    ) -> Executive:
        def ticked(tick: int) -> None:
            self.monitor.ticked(tick)
            after_tick(tick)

        self.monitor.executive = Executive(root, services, clock, self.monitor.hearing(command), ticked, *rest)
        return self.monitor.executive

    def _note_events(self, stack: ExitStack, disk: BadDisk | None) -> None:
        """What is recorded, whatever becomes of it; all that is recorded while the disk is full may be lost."""
        write = JsonLines.write

        def noted(lines: JsonLines, event: dict[str, Any]) -> None:
            self.recorded.append(json.loads(json.dumps(event, default=plain)))
            write(lines, event)
            self._at_risk += self.recorded[-1:] if disk is not None and disk.full else []

        stack.enter_context(patch.object(JsonLines, "write", noted))

    @property
    def phases(self) -> list[str]:
        return [f"{row['after']}({row['code']})" if row["code"] else row["after"] for row in self.events("phase")]

    def events(self, kind: str) -> list[dict[str, Any]]:
        return [event for event in read_events(self.run.events) if event["kind"] == kind]

    @property
    def told_codes(self) -> set[str]:
        """Codes of every failure in the event log."""
        return {event["code"] for event in self.events("failure")}

    def how(self, summary: Summary) -> str:
        """Outcome, and what held or failed on the way."""
        held = {phase for phase in self.phases if phase.startswith("hold")}
        return ", ".join([summary.outcome, *sorted(held | self.told_codes)])

    def assert_folder_is_whole(self, refused: bool = False) -> None:
        """Nothing half written under any name, each scan as the scanner has it, and the log as the ledger has it.

        Args:
            refused: whether the disk refused some events for good: those are in one of both, in their order, or were
                recorded while it was full.
        """
        left = [path.name for path in self.run.path.rglob("*") if ".part" in path.name]
        assert left == []
        for path in self.run.path.rglob("*.npz"):
            with np.load(path) as archive:
                assert all(archive[name].size for name in archive.files)
        with closing(Ledger(self.run.ledger)) as ledger:
            assert ledger.damage() == []
            rows, events = ledger.jobs(), list(ledger.events())
        assert [job.name for job in rows if job.ended is None] == []
        self._assert_all_is_logged(read_events(self.run.events), events, refused)
        for name in (job.name for job in rows if job.kind == "fetch" and job.how == "done"):
            stored = self.scanner.spool.find(name)
            assert stored is not None
            assert hashlib.sha256(self.run.scan_file(name).read_bytes()).hexdigest() == stored.receipt.sha256

    def _assert_all_is_logged(self, log: list[dict[str, Any]], events: list[dict[str, Any]], refused: bool) -> None:
        if not refused:
            assert log == events == self.recorded
            return
        assert log == [event for event in self.recorded if event in log]
        assert events == [event for event in self.recorded if event in events]
        lost = [event for event in self.recorded if event not in log and event not in events]
        assert [event for event in lost if event not in self._at_risk] == []


class _Errors(logging.Handler):
    """Keeps what was logged with a traceback."""

    def __init__(self, found: list[str]) -> None:
        super().__init__(logging.ERROR)
        self._found = found

    def emit(self, record: logging.LogRecord) -> None:
        if record.exc_info:
            self._found.append(f"{record.getMessage()}: {record.exc_info[1]!r}")


class _Closing:
    def __init__(self, base: LastingBase) -> None:
        self._base = base

    def __getattr__(self, name: str) -> Any:
        return getattr(self._base, name)

    def close(self) -> None:
        """There is no socket."""


def survive(folder: Path, way: Way, at: int, clean: list[str]) -> str:
    """Fly one mission whose disk fails at one operation, resume it if that ended it; what failed, for a table.

    Args:
        clean: the scans of the mission with a good disk.

    Raises:
        AssertionError: where a promise was broken.
    """
    kept = Kept(folder)
    disk = BadDisk(kept.run.path, way, at)
    first = kept.fly(disk)
    if isinstance(first, FailureError):
        assert kept.scanner.taken == {}, "refused, but only after it had begun"
        assert first.failure.code in ("DISK_FULL", "IO_ERROR", "LEDGER_BAD"), str(first)
    elif first.outcome == "fault":
        assert way is Way.ERROR
        assert "IO_ERROR" in kept.told_codes
    else:
        assert first.outcome == "complete", f"{first.outcome}: {first.rooms}"
    assert kept.base.commands[-1:] in ([], ["stop"])
    assert disk.hit or way is Way.SHORT, "the mission ended before the disk failed"
    still_full = disk.full
    disk.make_room()
    if isinstance(first, FailureError) or first.outcome == "fault":
        again = kept.fly()
        assert isinstance(again, Summary), f"not resumed: {again}"
        assert again.outcome == "complete"
    assert list(kept.scanner.taken) == clean
    assert kept.errors == []
    kept.assert_folder_is_whole(refused=way is Way.ERROR or still_full)
    if not disk.hit:
        return "nothing: no write was left that could be cut short"
    return f"{disk.hit}: {first.failure.code if isinstance(first, FailureError) else kept.how(first)}"
