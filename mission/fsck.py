"""Whether a run folder is what the mission wrote: its ledger whole to its end, every file there and unchanged.

The ledger's records hold each other (:mod:`mission.records`), all but the last ones: of those nothing in the file says
that they were ever there, and what a power cut may take of them, since the last act, is not missed. An act is: it is
written down durably before it is ordered. So the end is held by what lies beside it, the scans, and the event log, in
which every act stands as soon as it is written down.
"""

import json
import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from zipfile import ZipFile

from drivers.interfaces import ScanReceipt
from drivers.wire.hashing import sha256_of
from mission.config import ConfigError, load_config
from mission.products import is_only_shown, may_write_the_same
from mission.records import JobRow, KeptFile, damage_in, events_in, files_in, jobs_in
from mission.snapshot import copied, holder_of
from mission.store import RunFolder
from mission.values import from_json
from perception.failure import FailureError

_MAGIC = b"SQLite format 3\0"


@dataclass(frozen=True)
class Verdict:
    """What :func:`check` found.

    Args:
        unusable: why nobody can go by the ledger; empty if it is what the mission wrote.
        lost: what is missing or changed, and a resumed mission needs.
        only_shown: what is missing or changed, and only the report would show.
        log: what is wrong with the event log; a resumed mission writes it anew from the ledger.
        left_over: files of writes that never ended; harmless, and never deleted without being asked.
        scans, files: how many scans, and how many other files of the ledger, were looked at.
    """

    unusable: tuple[str, ...] = ()
    lost: tuple[str, ...] = ()
    only_shown: tuple[str, ...] = ()
    log: tuple[str, ...] = ()
    left_over: tuple[str, ...] = ()
    scans: int = 0
    files: int = 0

    @property
    def exit_code(self) -> int:
        """0 clean, 3 lossy but usable, 1 unusable."""
        return 1 if self.unusable else 3 if self.lost or self.only_shown or self.log else 0

    @property
    def next_step(self) -> str:
        """What to do about it; empty when there is nothing."""
        if self.unusable:
            return (
                "restore the whole folder from a backup; `mission resume` refuses this one. "
                "Scans that are whole can still be put through `mission process`"
            )
        if self.lost:
            return (
                "restore these files from a backup and look again; `mission resume` refuses until then. "
                "`mission report` tells of what is left"
            )
        if self.exit_code:
            return "`mission resume` can go on without it; restore it from a backup if the report should show it"
        return ""


@dataclass(frozen=True)
class _Told:
    """What the ledger says of the run folder."""

    jobs: list[JobRow]
    files: dict[str, tuple[int, KeptFile]]
    events: int


def check(run: RunFolder) -> Verdict:
    """Look at all of it; nothing is changed.

    Raises:
        FailureError: ``LEDGER_IN_USE`` while the mission runs, ``DISK_FULL`` when there is no room to look.
    """
    holder = holder_of(run.ledger)
    if holder is not None:
        raise FailureError("LEDGER_IN_USE", f"{run.path}: it is running: process {holder}; look when it has ended")
    try:
        told = _told_by(run.ledger)
        receipts = receipts_of(told.jobs)
    except OSError as error:
        return Verdict(unusable=(f"{run.ledger}: expected the mission's ledger, found {error.strerror or error}",))
    except ValueError as error:
        return Verdict(unusable=(f"{run.ledger}: {error}",))
    log = _Log.read(run.events)
    unusable = tuple(f"{run.ledger}: {words}" for words in (*_scans_unheard_of(run, told), *log.acts_beyond(told.jobs)))
    scans = tuple(_faults((run.scan_file(one.scan_id), one.size, one.sha256) for one in receipts))
    needed, shown = _files_lost(run, told)
    return Verdict(
        unusable,
        (*scans, *needed, *_set_up_lost(run)),
        shown,
        tuple(f"{run.events}: {words}" for words in log.faults(told)),
        tuple(str(path) for path in sorted(run.path.rglob("*.part*"))),
        len(receipts),
        len(told.files),
    )


def receipts_of(jobs: list[JobRow]) -> list[ScanReceipt]:
    """The receipts of all scans that were brought home, in their order. Raises ValueError for what is none."""
    taken: dict[str, ScanReceipt] = {}
    fetched = []
    for row in jobs:
        if row.how != "done" or row.outcome is None:
            continue
        if row.kind == "take":
            taken[row.name] = _receipt(row)
        elif row.kind == "fetch" and row.name in taken:
            fetched.append(taken[row.name])
    return fetched


def _receipt(row: JobRow) -> ScanReceipt:
    try:
        receipt = from_json(json.loads(row.outcome or "null"))
    except (ValueError, TypeError) as error:
        raise ValueError(f"expected the receipt of {row.name}, found {error}") from error
    if not isinstance(receipt, ScanReceipt):
        raise ValueError(f"expected the receipt of {row.name}, found a {type(receipt).__name__}")
    return receipt


# --- the ledger and its end -------------------------------------------------------------------------------------------


def _told_by(ledger: Path) -> _Told:
    """All that is in a whole ledger. Raises OSError, or ValueError with what is wrong with it."""
    with ledger.open("rb") as file:
        begins = file.read(len(_MAGIC))
    if begins != _MAGIC:  # one that is empty would be made anew, in silence
        raise ValueError(f"expected the mission's ledger, found {'another' if begins else 'an empty'} file")
    with copied(ledger) as db:
        damage = _not_kept_apart(db) or damage_in(db)
        if damage:
            raise ValueError("; ".join(damage[:5]))
        if not db.execute("SELECT 1 FROM record").fetchone():
            raise ValueError("expected the records of a mission, found none: nothing was done, or all of it is lost")
        return _Told(jobs_in(db), files_in(db), sum(1 for _ in events_in(db)))


def _not_kept_apart(db: sqlite3.Connection) -> list[str]:
    """A ledger whose header denies its write-ahead log is read without it, as if that had never been."""
    try:
        (mode,) = db.execute("PRAGMA journal_mode").fetchone()
    except sqlite3.Error as error:
        return [f"expected a whole ledger, found one that cannot be read: {error}"]
    return [] if mode == "wal" else [f"expected a write-ahead log, found the mode '{mode}'"]


def _scans_unheard_of(run: RunFolder, told: _Told) -> Iterator[str]:
    taken = {job.name for job in told.jobs if job.kind == "take"}
    for path in sorted((run.path / "scans").glob("*.scan")):
        if path.stem not in taken:
            yield f"its end is lost: expected the order of {path.stem}, whose scan is there, found none"


@dataclass(frozen=True)
class _Log:
    """What the event log says, as far as it can be read.

    Args:
        lines: how many there are.
        acts: number, kind and name of each job that was ordered, in their order.
        fault: why it cannot be read to its end; empty if it can.
    """

    lines: int
    acts: tuple[tuple[int, str, str], ...]
    fault: str

    @classmethod
    def read(cls, path: Path) -> "_Log":
        try:
            lines = path.read_bytes().split(b"\n")[:-1]  # a line that a power cut broke off was never whole
        except OSError as error:
            return cls(0, (), f"expected the event log, found {error.strerror or error}")
        acts, fault = [], ""
        for number, line in enumerate(lines, 1):
            try:
                event = json.loads(line.decode())
                if event["kind"] == "ordered":
                    acts.append((int(event["job"]), str(event["what"]), str(event["name"])))
            except (ValueError, TypeError, LookupError, RecursionError) as error:
                fault = fault or f"expected an event in line {number}, found {error}"
        return cls(len(lines), tuple(acts), fault)

    def acts_beyond(self, jobs: list[JobRow]) -> Iterator[str]:
        """Acts that the ledger would have if it had its end: where it has the last one, it has them all."""
        if self.acts and self.acts[-1][0] > len(jobs):
            number, what, name = self.acts[-1]
            yield f"its end is lost: expected job {number}, {what} {name}, as in the event log, found {len(jobs)} jobs"

    def faults(self, told: _Told) -> Iterator[str]:
        if self.fault:
            yield self.fault
        elif told.events and not self.lines:
            yield f"expected {told.events} events, found none"
        for number, what, name in self.acts:
            row = told.jobs[number - 1] if 0 < number <= len(told.jobs) else None
            if row is not None and (row.kind, row.name) != (what, name):
                yield f"expected job {number} to be {row.kind} {row.name}, as in the ledger, found {what} {name}"


# --- the files --------------------------------------------------------------------------------------------------------


def _files_lost(run: RunFolder, told: _Told) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """What is wrong with the files that stages made: those that are needed, and those that are only shown."""
    needed: list[str] = []
    shown: list[str] = []
    for path, (number, file) in told.files.items():
        words = _fault(run.path / path, file.size, file.sha256)
        if words and _is_being_rewritten(told.jobs, number):
            words = _fault_of_archive(run.path / path) if path.endswith(".npz") else _fault_of_json(run.path / path)
        if words:
            (shown if is_only_shown(path) else needed).append(words)
    return tuple(needed), tuple(shown)


def _is_being_rewritten(jobs: list[JobRow], number: int) -> bool:
    """Whether a later job may have left another file in its place, and not lived to tell."""
    return any(later.how != "done" and may_write_the_same(later, jobs[number - 1]) for later in jobs[number:])


def _set_up_lost(run: RunFolder) -> Iterator[str]:
    """What is wrong with what the mission was given: its configuration, and its building if that is simulated."""
    try:
        load_config(run.config)
    except ConfigError as error:
        yield str(error)
    if run.simulation.exists():
        yield from filter(None, (_fault_of_json(run.rehearsal), _fault_of_archive(run.world)))


def _faults(files: Iterator[tuple[Path, int, str]]) -> Iterator[str]:
    return (words for file in files if (words := _fault(*file)))


def _fault(path: Path, size: int, sha256: str) -> str:
    """What is wrong with a file, in words; empty if nothing."""
    try:
        has = path.stat().st_size
        if has != size:
            return f"{path}: expected {size} bytes, found {has}"
        found = sha256_of(path)
    except OSError as error:
        return f"{path}: {error.strerror or error}"
    return "" if found == sha256 else f"{path}: expected SHA-256 {sha256}, found {found}"


def _fault_of_archive(path: Path) -> str:
    try:
        with ZipFile(path) as archive:
            bad = archive.testzip()
    except OSError as error:
        return f"{path}: {error.strerror or error}"
    except Exception as error:  # a damaged archive raises whatever its damage leads to
        return f"{path}: expected arrays, found {error}"
    return f"{path}: expected arrays, found {bad} damaged" if bad else ""


def _fault_of_json(path: Path) -> str:
    try:
        json.loads(path.read_bytes())
    except OSError as error:
        return f"{path}: {error.strerror or error}"
    except (ValueError, RecursionError) as error:
        return f"{path}: expected JSON, found {error}"
    return ""
