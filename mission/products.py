"""The files that each stage leaves in the run folder, for later stages and for the report, as the ledger keeps them.

They are read back in the process that ticks: a robot map or a room's voxels are some hundred kilobytes at most.
"""

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from drivers.wire.hashing import sha256_of
from mission.records import JobRow, KeptFile
from mission.store import RunFolder
from perception.failure import FailureError


def made_by(run: RunFolder, stage: str, arguments: Mapping[str, Any], value: Any) -> list[KeptFile]:
    """What a stage made that came to ``value``.

    Raises:
        FailureError: ``IO_ERROR`` when a file of it cannot be read back.
    """
    return [_kept(run, path) for path in _written_by(run, stage, arguments, value) if path.exists()]


def may_write_the_same(one: JobRow, other: JobRow) -> bool:
    """Whether two jobs are the same stage about the same room and cycle: what one has written, the other may have."""
    return one.kind == other.kind and one.name.split()[-2:] == other.name.split()[-2:]


def is_only_shown(path: str) -> bool:
    """Whether nothing but the report ever reads a file: a resumed mission can do without it."""
    return path.startswith("evidence/") and path.endswith(".npz")


def _written_by(run: RunFolder, stage: str, arguments: Mapping[str, Any], value: Any) -> Iterator[Path]:
    if stage == "optimise_poses":
        yield run.comparisons
    elif stage == "build_map":
        yield from (run.map_file(value.map_id), run.map_evidence_file(value.map_id))
        yield _evidence(run, arguments, "flatness")
    elif stage == "segment_room":
        yield _evidence(run, arguments, "ceiling")
    elif stage == "label_space":
        yield run.voxel_file(arguments["room_id"], arguments["cycle"])
    elif stage == "choose_view":
        yield _evidence(run, arguments, "view")


def _evidence(run: RunFolder, arguments: Mapping[str, Any], name: str) -> Path:
    return run.evidence_file(arguments["room_id"], arguments["cycle"], name)


def _kept(run: RunFolder, path: Path) -> KeptFile:
    try:
        return KeptFile(path.relative_to(run.path).as_posix(), path.stat().st_size, sha256_of(path))
    except OSError as error:
        words = f"{path} cannot be read back: {error.strerror or error}"
        raise FailureError("IO_ERROR", words, file=str(path)) from error
