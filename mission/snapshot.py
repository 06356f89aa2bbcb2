"""A ledger looked at without touching it: also one on read-only media, or one that another process has open."""

import fcntl
import os
import shutil
import sqlite3
import struct
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from drivers.disk import is_full
from perception.failure import FailureError

_FLOCK = "hhqqi0q"
"""``struct flock`` of Linux: type, whence, start, length, process."""
_LOCKS = (1 << 30, 512)
"""Where SQLite puts its locks on a file, whatever its size, and how many there are."""


def holder_of(path: Path) -> int | None:
    """The process that has a ledger open, if one does; this one does not count."""
    try:
        handle = os.open(path, os.O_RDONLY)
    except OSError:
        return None
    try:
        asked = struct.pack(_FLOCK, fcntl.F_WRLCK, os.SEEK_SET, *_LOCKS, 0)
        kind, *_, process = struct.unpack(_FLOCK, fcntl.fcntl(handle, fcntl.F_GETLK, asked))
    except OSError:  # a file system without locks, which no second process could be kept out of either
        return None
    finally:
        os.close(handle)
    return None if kind == fcntl.F_UNLCK else process


@contextmanager
def copied(path: Path) -> Iterator[sqlite3.Connection]:
    """A private copy of a database with its write-ahead log: reading one in its place would change both.

    Raises:
        FailureError: ``DISK_FULL`` when there is no room for the copy.
        OSError: when the files cannot be read.
    """
    with TemporaryDirectory() as folder:
        copy = Path(folder) / path.name
        try:
            for ending in ("", "-wal"):
                source = path.with_name(path.name + ending)
                if not ending or source.exists():
                    shutil.copyfile(source, copy.with_name(copy.name + ending))
        except OSError as error:
            if not is_full(error):
                raise
            raise FailureError("DISK_FULL", f"{folder}: no room for a copy of {path}", file=str(folder)) from error
        with closing(sqlite3.connect(copy, isolation_level=None)) as db:
            yield db
