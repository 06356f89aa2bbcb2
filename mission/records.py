"""How the ledger's records lie in its file, and what they tell: one chain of hashes, from the first to the last.

A record is the mission's name, the begin of a job, its end, a file that it made, or an event. None is ever changed;
what is known of a job is what its records say. Each has the hash of itself and of all before it, so that one that was
altered, taken out or put in is found, and only an end that is missing as a whole is not: see :mod:`mission.fsck`.
"""

import hashlib
import json
import sqlite3
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

FORMAT = 2
FIRST = "0" * 64
"""What the first record's hash follows."""

TABLES = (
    "CREATE TABLE about (name TEXT PRIMARY KEY, value TEXT NOT NULL)",
    "CREATE TABLE record "
    "(seq INTEGER PRIMARY KEY, sort TEXT NOT NULL, job INTEGER, body TEXT NOT NULL, hash TEXT NOT NULL)",
)
NAME, BEGIN, END, FILE, EVENT = "name", "begin", "end", "file", "event"


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


@dataclass(frozen=True)
class KeptFile:
    """A file of the run folder as a job left it; ``path`` is relative to the folder."""

    path: str
    size: int
    sha256: str


def chained(previous: str, seq: int, sort: str, job: int | None, body: str) -> str:
    """The hash of a record that follows the one with hash ``previous``."""
    return hashlib.sha256(f"{previous}\n{seq} {sort} {job}\n{body}".encode()).hexdigest()


def format_in(db: sqlite3.Connection) -> str | None:
    """The format that a file says it has; None of one that nothing was ever written to."""
    if not db.execute("SELECT 1 FROM sqlite_master WHERE name = 'about'").fetchone():
        return None
    found = db.execute("SELECT value FROM about WHERE name = 'format'").fetchone()
    return str(found[0]) if found else "none"


def name_in(db: sqlite3.Connection) -> str | None:
    """What the agents know the mission by; None where they were told nothing yet."""
    found = db.execute("SELECT body FROM record WHERE sort = ?", (NAME,)).fetchone()
    return str(found[0]) if found else None


def jobs_in(db: sqlite3.Connection) -> list[JobRow]:
    """All jobs in their order."""
    jobs: dict[int, JobRow] = {}
    for job, sort, body in db.execute("SELECT job, sort, body FROM record WHERE job IS NOT NULL ORDER BY seq"):
        if sort == BEGIN:
            jobs[job] = JobRow(job, *json.loads(body))
        elif sort == END:
            how, outcome, ended = json.loads(body)
            jobs[job] = replace(jobs[job], ended=ended, how=how, outcome=outcome)
    return list(jobs.values())


def files_in(db: sqlite3.Connection) -> dict[str, tuple[int, KeptFile]]:
    """By its path, each file as it was written last, with the number of the job that wrote it."""
    rows = db.execute("SELECT job, body FROM record WHERE sort = ? ORDER BY seq", (FILE,))
    files = ((job, KeptFile(*json.loads(body))) for job, body in rows)
    return {file.path: (job, file) for job, file in files}


def events_in(db: sqlite3.Connection) -> Iterator[dict[str, Any]]:
    """All events in their order."""
    for (body,) in db.execute("SELECT body FROM record WHERE sort = ? ORDER BY seq", (EVENT,)):
        yield json.loads(body)


def damage_in(db: sqlite3.Connection) -> list[str]:
    """What is wrong with a ledger's file, in words; nothing when it is whole. A damaged one raises nothing."""
    try:
        found = format_in(db)
        if found != str(FORMAT):
            return [f"expected format {FORMAT}, found {found or 'no ledger'}"]
        laid_out = tuple(sql for (sql,) in db.execute("SELECT sql FROM sqlite_master WHERE sql IS NOT NULL"))
        if laid_out != TABLES:
            return [f"expected the tables of format {FORMAT}, found others"]
        pages = [str(row[0]) for row in db.execute("PRAGMA integrity_check") if row[0] != "ok"]
        return [*pages, *_breaks_in_the_chain(db)]
    except (sqlite3.Error, ValueError, OverflowError, MemoryError) as error:
        return [f"expected a whole ledger, found one that cannot be read: {error}"]


def _breaks_in_the_chain(db: sqlite3.Connection) -> list[str]:
    last = FIRST
    rows = db.execute("SELECT seq, sort, job, body, hash FROM record ORDER BY seq")
    for place, (seq, sort, job, body, has) in enumerate(rows, 1):
        last = chained(last, place, sort, job, body)
        if (seq, has) != (place, last):
            return [f"record {place} is not what was written"]
    return []
