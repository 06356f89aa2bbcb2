"""A disk that fails at its n-th operation below one folder, whoever asks: descriptors, streams and SQLite.

Operations are to make a folder, to open a file for writing, to write, to make room for it, to cut it short, to bring it
to the disk, to rename it, to remove it, and SQLite's rows and ends of transactions.
"""

import errno
import io
import os
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from enum import Enum
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

_GIVES_ROOM = frozenset({"ftruncate", "truncate", "unlink"})


class Way(Enum):
    """How it fails: full until somebody makes room, an error once, or no more than one byte taken of one write."""

    FULL = "ENOSPC"
    ERROR = "EIO"
    SHORT = "short write"


class BadDisk:
    """Notes what is asked of the disk, and fails at one of it.

    Args:
        folder: whose files lie on it.
        way: how it fails.
        at: the number of the operation, from one; None for a disk that is good. Where that one cannot fail in that way,
            the next that can is meant: only a write falls short, and a full disk refuses nothing that gives it room.
    """

    def __init__(self, folder: Path, way: Way, at: int | None) -> None:
        self.log: list[str] = []
        self.hit = ""
        self.full = False
        self._folder = folder.resolve()
        self._way = way
        self._at = at

    def make_room(self) -> None:
        self.full = False

    def asked(self, what: str, path: object) -> bool:
        """Something is asked of a file; whether no more than a byte of it may be taken. Raises OSError."""
        if not self.holds(path):
            return False
        self.log.append(f"{what} {Path(str(path)).name}")
        fails = self._is_due(what)
        if fails:
            self.hit = self.log[-1]
            self.full = self._way is Way.FULL
            if self._way is Way.ERROR:
                raise OSError(errno.EIO, os.strerror(errno.EIO), str(path))
        if self.full and what not in _GIVES_ROOM:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(path))
        return fails and self._way is Way.SHORT

    def done(self) -> None:
        """What was asked for has been done: the place of one who waits for that."""

    def _is_due(self, what: str) -> bool:
        if self._at is None or self.hit or len(self.log) < self._at:
            return False
        return {Way.SHORT: what == "write", Way.FULL: what not in _GIVES_ROOM, Way.ERROR: True}[self._way]

    def holds(self, path: object) -> bool:
        return Path(str(path)).is_relative_to(self._folder)

    @contextmanager
    def mounted(self) -> Iterator["BadDisk"]:
        """Every write below the folder goes to this disk inside."""
        with ExitStack() as stack:
            for name, by in (("write", self._write), ("pwrite", self._write)):
                stack.enter_context(patch.object(os, name, partial(by, getattr(os, name))))
            for name in ("mkdir", "fsync", "posix_fallocate", "ftruncate", "truncate", "replace", "unlink"):
                stack.enter_context(patch.object(os, name, partial(self._call, name, getattr(os, name))))
            stack.enter_context(patch.object(os, "open", partial(self._open, os.open)))
            stack.enter_context(patch.object(Path, "open", _opening(self, Path.open)))
            connect = partial(sqlite3.connect, factory=self._connection())
            stack.enter_context(patch("mission.ledger.sqlite3.connect", connect))
            yield self

    def _call(self, name: str, real: Callable[..., Any], target: Any, *rest: Any, **options: Any) -> Any:
        self.asked(name, self._path(target))
        try:
            return real(target, *rest, **options)
        finally:  # a folder that is there already, a file that is not, are refused by a good disk too
            self.done()

    def _open(self, real: Callable[..., int], path: Any, flags: int, *rest: Any, **options: Any) -> int:
        writes = bool(flags & (os.O_WRONLY | os.O_RDWR))
        if writes:
            self.asked("open", path)
        handle = real(path, flags, *rest, **options)
        if writes:
            self.done()
        return handle

    def _write(self, real: Callable[..., int], handle: int, data: Any, *rest: Any) -> int:
        short = self.asked("write", self._path(handle))
        written = real(handle, memoryview(data)[:1] if short else data, *rest)
        self.done()
        return written

    def _path(self, target: Any) -> object:
        return Path(f"/proc/self/fd/{target}").readlink() if isinstance(target, int) else target

    def _connection(self) -> type[sqlite3.Connection]:
        disk = self

        class Connection(sqlite3.Connection):
            """Writes where SQLite would: at each row, and at the end of a transaction."""

            def execute(self, sql: str, *values: Any) -> sqlite3.Cursor:
                if not sql.startswith(("INSERT", "UPDATE", "COMMIT")):
                    return super().execute(sql, *values)
                try:
                    disk.asked(sql.partition(" ")[0].lower(), disk._folder / "mission.db")
                except OSError as error:
                    words = "database or disk is full" if error.errno == errno.ENOSPC else "disk I/O error"
                    raise sqlite3.OperationalError(words) from error
                cursor = super().execute(sql, *values)
                disk.done()
                return cursor

        return Connection


class _Raw(io.FileIO):
    """A file on a bad disk."""

    def __init__(self, disk: BadDisk, path: Path, mode: str) -> None:
        disk.asked("open", path)
        super().__init__(path, mode)
        self._disk = disk
        self._path = path
        disk.done()

    def write(self, data: Any) -> int:
        short = self._disk.asked("write", self._path)
        written = super().write(memoryview(data)[:1] if short else data)
        self._disk.done()
        return written


def _opening(disk: BadDisk, real: Callable[..., Any]) -> Callable[..., Any]:
    def opened(path: Path, mode: str = "r", *rest: Any, **options: Any) -> Any:
        if mode == "wb" and disk.holds(path):
            return io.BufferedWriter(_Raw(disk, path, mode))
        return real(path, mode, *rest, **options)

    return opened
