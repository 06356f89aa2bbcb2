"""What a disk says no with: want of room passes when somebody makes room, everything else is an error of the disk."""

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perception.failure import FailureError

_NO_ROOM = frozenset({errno.ENOSPC, errno.EDQUOT})


def is_full(error: OSError) -> bool:
    """Whether there was no room, on the disk or in this user's share of it."""
    return error.errno in _NO_ROOM


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Raises ``DISK_FULL`` or ``IO_ERROR``, naming the file, for what the disk does not take inside."""
    try:
        yield
    except OSError as error:
        code = "DISK_FULL" if is_full(error) else "IO_ERROR"
        raise FailureError(code, f"{path} cannot be written: {error.strerror or error}", file=str(path)) from error


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """The arrays of an ``.npz``; nothing in it is ever executed.

    Raises:
        OSError: it cannot be read, as its message says.
        ValueError: it is no archive of plain arrays, or a damaged one.
    """
    with path.open("rb") as stream:
        try:
            with np.lib.npyio.NpzFile(stream, allow_pickle=False) as archive:  # np.load would take a lone array as well
                return {name: archive[name] for name in archive.files}
        except OSError:
            raise
        except Exception as error:  # bytes that changed make its readers raise zlib's and tokenize's own, and more
            raise ValueError(f"expected an archive of plain arrays, found none that is whole: {error}") from error
