"""The event log: one JSON object a line, in the order things happened, readable while the mission runs."""

import json
import os
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from behaviours.services import Clock
from drivers.disk import writing
from mission.ledger import Ledger


class JsonLines:
    """Appends events to ``events.jsonl``; each line is on its way to the disk before the next tick.

    Nobody waits for it: what the disk does not take now is written, in its order, with a later event. There is never
    half a line before a whole one.

    Args:
        path: the file, made if absent.
        clock: gives ``t`` in mission seconds.
        watch: also called with each event, for a display.

    Raises:
        FailureError: ``DISK_FULL``, ``IO_ERROR`` when there is no file to begin with.
    """

    def __init__(self, path: Path, clock: Clock, watch: Callable[[dict[str, Any]], None] | None = None) -> None:
        self._clock = clock
        self._watch = watch
        self._lock = threading.Lock()
        self._waiting = b""
        with writing(path):
            self._file = os.open(path, os.O_RDWR | os.O_CREAT | os.O_APPEND, 0o644)
            # A line that a power cut broke off would swallow the next one.
            self._size = path.read_bytes().rfind(b"\n") + 1
            os.ftruncate(self._file, self._size)

    def record(self, kind: str, /, **figures: object) -> None:
        self.write(stamped(self._clock, kind, figures))

    def write(self, event: dict[str, Any]) -> None:
        """Append an event that has its time already."""
        line = json.dumps(event, default=plain)
        with self._lock:
            self._waiting += f"{line}\n".encode()
            self._write_out()
        if self._watch is not None:
            self._watch(event)

    def close(self) -> None:
        with self._lock:
            self._write_out()
            os.close(self._file)

    def _write_out(self) -> None:
        """All lines that wait, or none of them."""
        left = memoryview(self._waiting)
        try:
            while left:
                left = left[os.write(self._file, left) :]
        except OSError:
            os.ftruncate(self._file, self._size)
        else:
            self._size += len(self._waiting)
            self._waiting = b""


class DurableJournal:
    """Events into the ledger, all of one tick in one go, and at the same time into the log that people read.

    Args:
        ledger: the truth.
        mirror: lines of the same events, which nobody waits for.
        clock: mission time.
    """

    def __init__(self, ledger: Ledger, mirror: JsonLines, clock: Clock) -> None:
        self._ledger = ledger
        self._mirror = mirror
        self._clock = clock
        self._waiting: list[str] = []
        self._lock = threading.Lock()

    def record(self, kind: str, /, **figures: object) -> None:
        event = stamped(self._clock, kind, figures)
        with self._lock:
            self._waiting.append(json.dumps(event, default=plain))
        self._mirror.write(event)

    def commit(self) -> None:
        """All events so far are on the disk when this returns; those of a full disk wait for the next time.

        Raises:
            FailureError: as :meth:`mission.ledger.Ledger.append`.
        """
        with self._lock:
            waiting = list(self._waiting)
        self._ledger.append(waiting)
        with self._lock:
            del self._waiting[: len(waiting)]


def stamped(clock: Clock, kind: str, figures: Mapping[str, object]) -> dict[str, Any]:
    """An event: when, what, and its figures."""
    return {
        "t": round(clock.now(), 3),
        "utc": datetime.now(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z"),
        "kind": kind,
        **figures,
    }


def plain(value: Any) -> Any:
    """JSON for the few types that figures come in."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, Path):
        return str(value)
    if isinstance(value, tuple | set | frozenset):
        return list(value)
    raise TypeError(f"a figure of type {type(value).__name__} has no place in the event log")


def read_events(path: Path) -> list[dict[str, Any]]:
    """All whole lines of an event log; one that was cut off or damaged is left out (the ledger has them all)."""
    events = []
    for line in path.read_bytes().splitlines() if path.exists() else ():
        with suppress(ValueError):  # of its encoding or of its JSON
            event = json.loads(line.decode("utf-8"))
            events += [event] if isinstance(event, dict) else []
    return events
