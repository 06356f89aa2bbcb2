"""The hash by which a scan is known, taken beside the work that the bytes need anyway.

SHA-256, so that anybody's ``sha256sum`` agrees; hashlib lets go of the interpreter meanwhile.
"""

import hashlib
import os
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

_BLOCK = 1 << 20


def sha256_of(path: Path) -> str:
    """Of a whole file, hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


class GrowingHash:
    """SHA-256 of a file whose beginning is there already, taken in a thread of its own. Use as a context manager.

    The file is read, not what was meant to be written to it.
    """

    def __init__(self, handle: int) -> None:
        self._handle = handle
        self._hash = hashlib.sha256()
        self._position = 0
        self._beside = ThreadPoolExecutor(1, "hash")

    def __enter__(self) -> "GrowingHash":
        return self

    def __exit__(self, *exception: object) -> None:
        self._beside.shutdown(cancel_futures=True)

    def reach(self, end: int) -> None:
        """The bytes before ``end`` are in the file."""
        self._beside.submit(self._advance, end)

    def hexdigest(self, end: int) -> str:
        """Of the bytes before ``end``, all of which are there; what was given to :meth:`reach` comes first."""
        self._beside.submit(self._advance, end).result()
        return self._hash.hexdigest()

    def _advance(self, end: int) -> None:
        while self._position < end:
            data = os.pread(self._handle, min(_BLOCK, end - self._position), self._position)
            if not data:
                raise EOFError(f"the file ends before {end}")
            self._hash.update(data)
            self._position += len(data)
