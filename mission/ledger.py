"""The mission's durable memory: every event, and every job from before it was begun to its outcome, in one SQLite file.

What moves the world is on the disk before it is done, and with it all that was written before. So whatever instant
the executive dies at, the ledger tells which acts may have happened, and :mod:`mission.chronicle` asks for them again
by the same names. All else is written at once, which outlives a process that is killed, but not waited for: what a
power cut takes of it, since the last act, is found out or computed again.
"""

import hashlib
import json
import sqlite3
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from perception.failure import FailureError

FORMAT = 1
_FIRST = "0" * 64

_TABLES = """
CREATE TABLE about (name TEXT PRIMARY KEY, value TEXT NOT NULL);
CREATE TABLE job (seq INTEGER PRIMARY KEY, kind TEXT NOT NULL, name TEXT NOT NULL, world TEXT NOT NULL,
                  begun REAL NOT NULL, ended REAL, how TEXT, outcome TEXT);
CREATE TABLE event (seq INTEGER PRIMARY KEY, body TEXT NOT NULL, hash TEXT NOT NULL);
"""


@dataclass(frozen=True)
class JobRow:
    """One job that a leaf began.

    Args:
        seq: its place in the order of the mission, from 1.
        kind: what was asked of whom, such as ``take`` or a stage of the paper.
        name: of what, stable over restarts: a scan's, a goal's, a room's.
        world: JSON, what the base said when it was begun.
        begun, ended: mission seconds; ``ended`` is None while it is not known how it ended.
        how: ``done``, ``failed`` or ``cancelled``.
        outcome: JSON (:mod:`mission.values`).
    """

    seq: int
    kind: str
    name: str
    world: str
    begun: float
    ended: float | None = None
    how: str | None = None
    outcome: str | None = None


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
        self._last_hash = _FIRST
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
        if not self._db.execute("SELECT 1 FROM sqlite_master WHERE name = 'about'").fetchone():
            for statement in _TABLES.split(";"):
                self._db.execute(statement)
            self._db.execute("INSERT INTO about VALUES ('format', ?)", (str(FORMAT),))
        self._db.execute("COMMIT")
        (found,) = self._db.execute("SELECT value FROM about WHERE name = 'format'").fetchone()
        if found != str(FORMAT):
            raise FailureError("LEDGER_BAD", f"{self.path}: expected format {FORMAT}, found {found}")
        last = self._db.execute("SELECT hash FROM event ORDER BY seq DESC LIMIT 1").fetchone()
        self._last_hash = last[0] if last else _FIRST

    def close(self) -> None:
        """Close the file. Harmless when closed."""
        with self._lock:
            self._db.close()

    # --- jobs ---------------------------------------------------------------------------------------------------------

    def begin(self, kind: str, name: str, world: str, at: float, acts: bool = True) -> int:
        """Note that a job is about to be begun, durably if it ``acts`` on the world; its number."""
        with self._written(durably=acts):
            cursor = self._db.execute(
                "INSERT INTO job (kind, name, world, begun) VALUES (?, ?, ?, ?)", (kind, name, world, at)
            )
        assert cursor.lastrowid is not None
        return cursor.lastrowid

    def end(self, seq: int, how: str, outcome: str, at: float) -> None:
        """Note how a job ended; a job ends once."""
        with self._written():
            self._db.execute(
                "UPDATE job SET ended = ?, how = ?, outcome = ? WHERE seq = ? AND ended IS NULL",
                (at, how, outcome, seq),
            )

    def jobs(self) -> list[JobRow]:
        """All of them in their order."""
        rows = self._db.execute("SELECT seq, kind, name, world, begun, ended, how, outcome FROM job ORDER BY seq")
        return [JobRow(*row) for row in rows]

    def newest_time(self) -> float:
        """Mission seconds of the last thing that is known of a job; 0 of a mission that begins."""
        (newest,) = self._db.execute("SELECT max(coalesce(ended, begun)) FROM job").fetchone()
        return newest or 0.0

    # --- what does not change -----------------------------------------------------------------------------------------

    def about(self, name: str) -> str | None:
        """A fact about the mission by its name."""
        found = self._db.execute("SELECT value FROM about WHERE name = ?", (name,)).fetchone()
        return found[0] if found else None

    def note(self, name: str, value: str) -> None:
        """Keep a fact durably, instead of what it was before."""
        with self._written(durably=True):
            self._db.execute("INSERT OR REPLACE INTO about VALUES (?, ?)", (name, value))

    # --- events -------------------------------------------------------------------------------------------------------

    def append(self, events: Sequence[str]) -> None:
        """Add events, JSON, each chained to the one before by its hash."""
        if not events:
            return
        last = self._last_hash
        with self._written():
            for body in events:
                last = chained(last, body)
                self._db.execute("INSERT INTO event (body, hash) VALUES (?, ?)", (body, last))
        self._last_hash = last

    def events(self) -> Iterator[dict[str, Any]]:
        for (body,) in self._db.execute("SELECT body FROM event ORDER BY seq"):
            yield json.loads(body)

    def damage(self) -> list[str]:
        """What is wrong with the file, in words; nothing when it is whole."""
        found = [str(row[0]) for row in self._db.execute("PRAGMA integrity_check") if row[0] != "ok"]
        last = _FIRST
        for seq, body, has in self._db.execute("SELECT seq, body, hash FROM event ORDER BY seq"):
            last = chained(last, body)
            if last != has:
                return [*found, f"event {seq} is not what was written"]
        return found

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
            try:
                self._db.execute(f"PRAGMA synchronous={'FULL' if durably else 'NORMAL'}")
                self._db.execute("BEGIN IMMEDIATE")
                yield
                self._db.execute("COMMIT")
            except sqlite3.OperationalError as error:
                self._roll_back()
                failure = _failure(self.path, error, otherwise="IO_ERROR")
                if failure.failure.code != "DISK_FULL":
                    self._broken = failure
                raise failure from error
            except BaseException:
                self._roll_back()
                raise

    def _roll_back(self) -> None:
        if self._db.in_transaction:
            self._db.execute("ROLLBACK")


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


def chained(previous: str, body: str) -> str:
    """The hash of an event that follows the one with hash ``previous``."""
    return hashlib.sha256(f"{previous}\n{body}".encode()).hexdigest()
