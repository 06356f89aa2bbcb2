"""What a disk says no with: want of room passes when somebody makes room, everything else is an error of the disk."""

import errno
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

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
