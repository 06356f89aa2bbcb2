"""Which files of a folder are scans, and which reader takes them."""

from collections.abc import Callable
from pathlib import Path

from drivers.recorded import e57, las, pcd, ply, ptx, text, threedtk
from drivers.recorded.raw import RawScan, broken
from perception.failure import FailureError

_READERS: dict[str, Callable[[Path], list[RawScan]]] = {
    suffix: module.read for module in (threedtk, e57, ply, pcd, ptx, las, text) for suffix in module.SUFFIXES
}
SUFFIXES = tuple(_READERS)


def files_of(folder: Path) -> list[Path]:
    """The scan files of a folder in the order of their names.

    Raises:
        FailureError: ``RECORDED_NONE`` when there is none.
    """
    files = sorted(path for path in folder.iterdir() if path.suffix.lower() in SUFFIXES and path.is_file())
    if not files:
        raise FailureError("RECORDED_NONE", f"{folder}: expected files {', '.join(SUFFIXES)}, found none")
    return files


def read_file(path: Path) -> list[RawScan]:
    """Every set-up of a file.

    Raises:
        FailureError: ``RECORDED_BROKEN``, naming the file, what was expected and what was found;
            ``RECORDED_NEEDS_EXTRA`` when what reads the format is not installed.
    """
    try:
        return _READERS[path.suffix.lower()](path)
    except OSError as error:
        broken(path, "file", "one that can be read", error.strerror or str(error))
