"""The mission's durable memory: every event, and every job from before it was begun to its outcome, in one SQLite file.

What moves the world is on the disk before it is done, and with it all that was written before. So whatever instant
the executive dies at, the ledger tells which acts may have happened, and :mod:`mission.chronicle` asks for them again
by the same names. All else is written at once, which outlives a process that is killed, but not waited for: what a
power cut takes of it, since the last act, is found out or computed again.
"""

import json
import sqlite3
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import astuple, dataclass, replace
from pathlib import Path
from typing import Any

from mission.records import (
    BEGIN,
    END,
    EVENT,
    FILE,
    FIRST,
    FORMAT,
    NAME,
    TABLES,
    JobRow,
    KeptFile,
    chained,
    damage_in,
    events_in,
    files_in,
    format_in,
    jobs_in,
    name_in,
)
from perception.failure import FailureError


@dataclass(frozen=True)
class _Tail:
    """Where the next record goes: after this one, by its number and hash; and which jobs have no end yet."""

    seq: int = 0
    hash: str = FIRST
    jobs: int = 0
    open: frozenset[int] = frozenset()


class Ledger:
    """The file ``mission.db`` of a run folder. One process has it open at a time.

    Args:
        path: the file; made if absent.

    Raises:
        FailureError: ``LEDGER_IN_USE`` when another process has it, ``LEDGER_BAD`` when it is none or is damaged,
            ``DISK_FULL``, ``IO_ERROR``.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._lock = threading.Lock()
        self._tail = _Tail()
        self._has_told = False
        self._broken: FailureError | None = None
        self._db = _connected(path)
        try:
            # Before WAL: an exclusive WAL needs no shared memory, and turns a second executive away at once.
            self._db.execute("PRAGMA locking_mode=EXCLUSIVE")
            self._db.execute("PRAGMA journal_mode=WAL")
            self._open()
        except BaseException as error:
            self._db.close()  # or its lock would keep the next one out
            if isinstance(error, sqlite3.DatabaseError):
                raise _failure(path, error, otherwise="LEDGER_BAD") from error
            raise

    def _open(self) -> None:
        self._db.execute("BEGIN EXCLUSIVE")
        if format_in(self._db) is None:
            for statement in TABLES:
                self._db.execute(statement)
            self._db.execute("INSERT INTO about VALUES ('format', ?)", (str(FORMAT),))
        self._db.execute("COMMIT")
        found = format_in(self._db)
        if found != str(FORMAT):
            raise FailureError("LEDGER_BAD", f"{self.path}: expected format {FORMAT}, found {found}")
        self._tail = _tail_of(self._db)

    def close(self) -> None:
        """Close the file. Harmless when closed."""
        with self._lock:
            self._db.close()

    def name(self, new: str) -> str:
        """What the agents know the mission by, over all its lives: ``new`` from now on where it has no name yet."""
        if name_in(self._db) is None:
            with self._written(durably=True):
                self._add(NAME, None, new)
        return name_in(self._db) or new

    # --- jobs ---------------------------------------------------------------------------------------------------------

    def begin(self, kind: str, name: str, world: str, at: float, acts: bool = True) -> int:
        """Note that a job is about to be begun, durably if it ``acts`` on the world; its number."""
        with self._written(durably=acts):
            job = self._tail.jobs + 1
            self._add(BEGIN, job, json.dumps([kind, name, world, at]))
            self._tail = replace(self._tail, jobs=job, open=self._tail.open | {job})
        return job

    def keep(self, job: int, files: Sequence[KeptFile]) -> None:
        """Note the files that a job made, before it is noted that it ended."""
        with self._written():
            for file in files:
                self._add(FILE, job, json.dumps(astuple(file)))

    def end(self, seq: int, how: str, outcome: str, at: float) -> None:
        """Note how a job ended; a job ends once, unless it is reopened."""
        with self._written():
            if seq in self._tail.open:
                self._add(END, seq, json.dumps([how, outcome, at]))
                self._tail = replace(self._tail, open=self._tail.open - {seq})

    def reopen(self, seq: int) -> None:
        """A job that was given up when its mission was ended is taken up again, and so ends once more."""
        self._tail = replace(self._tail, open=self._tail.open | {seq})

    def jobs(self) -> list[JobRow]:
        """All of them in their order."""
        return jobs_in(self._db)

    def files(self) -> dict[str, tuple[int, KeptFile]]:
        """By its path, each file as it was kept last, with the number of the job that made it."""
        return files_in(self._db)

    def newest_time(self) -> float:
        """Mission seconds of the last thing that is known of a job; 0 of a mission that begins."""
        return max((job.begun if job.ended is None else job.ended for job in self.jobs()), default=0.0)

    # --- events -------------------------------------------------------------------------------------------------------

    def append(self, events: Sequence[str]) -> None:
        """Add events, JSON. The first of a process are waited for: a mission that told anything is in its ledger."""
        if not events:
            return
        with self._written(durably=not self._has_told):
            for body in events:
                self._add(EVENT, None, body)
        self._has_told = True

    def events(self) -> Iterator[dict[str, Any]]:
        return events_in(self._db)

    def damage(self) -> list[str]:
        """What is wrong with the file, in words; nothing when it is whole."""
        return damage_in(self._db)

    def _add(self, sort: str, job: int | None, body: str) -> None:
        seq = self._tail.seq + 1
        has = chained(self._tail.hash, seq, sort, job, body)
        self._db.execute("INSERT INTO record VALUES (?, ?, ?, ?, ?)", (seq, sort, job, body, has))
        self._tail = replace(self._tail, seq=seq, hash=has)

    @contextmanager
    def _written(self, durably: bool = False) -> Iterator[None]:
        """One transaction: all of it is written when the block is left, or none of it ever is.

        Raises:
            FailureError: ``DISK_FULL``, which passes when there is room again; ``IO_ERROR``, which does not: nobody
                knows what the disk has of the file then, so it is not written to any more, nor is it believed to be.
        """
        with self._lock:
            if self._broken is not None:
                raise self._broken
            before = self._tail
            try:
                self._db.execute(f"PRAGMA synchronous={'FULL' if durably else 'NORMAL'}")
                self._db.execute("BEGIN IMMEDIATE")
                yield
                self._db.execute("COMMIT")
            except sqlite3.OperationalError as error:
                self._roll_back(before)
                failure = _failure(self.path, error, otherwise="IO_ERROR")
                if failure.failure.code != "DISK_FULL":
                    self._broken = failure
                raise failure from error
            except BaseException:
                self._roll_back(before)
                raise

    def _roll_back(self, to: _Tail) -> None:
        self._tail = to
        if self._db.in_transaction:
            self._db.execute("ROLLBACK")


def _tail_of(db: sqlite3.Connection) -> _Tail:
    seq, has = db.execute("SELECT seq, hash FROM record ORDER BY seq DESC LIMIT 1").fetchone() or (0, FIRST)
    rows = db.execute("SELECT sort, job FROM record WHERE sort IN (?, ?)", (BEGIN, END)).fetchall()
    begun, ended = (frozenset(job for sort, job in rows if sort == wanted) for wanted in (BEGIN, END))
    return _Tail(seq, has, len(begun), begun - ended)


def _connected(path: Path) -> sqlite3.Connection:
    try:
        return sqlite3.connect(path, isolation_level=None, check_same_thread=False, timeout=0.5)
    except sqlite3.DatabaseError as error:
        raise _failure(path, error, otherwise="LEDGER_BAD") from error


def _failure(path: Path, error: sqlite3.DatabaseError, otherwise: str) -> FailureError:
    """What SQLite's words mean to an operator."""
    words, code = str(error), otherwise
    if "full" in words:
        code = "DISK_FULL"
    elif "disk I/O" in words:
        code = "IO_ERROR"
    elif "locked" in words:
        code = "LEDGER_IN_USE"
    return FailureError(code, f"{path}: {words}", path=str(path))
