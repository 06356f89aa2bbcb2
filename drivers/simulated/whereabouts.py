"""Where the simulated robot stands, kept in a file: a body does not vanish with the process that moves it."""

import mmap
import struct
from pathlib import Path

from drivers.simulated.planner import Pose

_FORM = struct.Struct("<?ddd")
_NAME = "stands_at"


class Whereabouts:
    """One pose in ``<folder>/stands_at``. Written at every step, in memory that outlives a process that is killed."""

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        with (folder / _NAME).open("a+b") as file:
            file.truncate(_FORM.size)
            self._memory = mmap.mmap(file.fileno(), _FORM.size)

    def read(self) -> Pose | None:
        """Where it was last; None where it never was anywhere."""
        known, x, y, yaw = _FORM.unpack(self._memory[:])
        return (x, y, yaw) if known else None

    def write(self, pose: Pose) -> None:
        self._memory[:] = _FORM.pack(True, *pose)
