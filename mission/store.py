"""The run folder: where each file of a mission is, and how it is written so that no half of one is ever seen."""

import itertools
import json
import os
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import yaml
from numpy.typing import NDArray

from drivers import disk
from drivers.disk import writing
from drivers.wire.spool import sync_folder
from mission.journal import plain
from perception.failure import FailureError
from perception.grids import Grid, VoxelSpace

_FOLDERS = ("scans", "maps", "voxels", "evidence", "pictures")


@dataclass(frozen=True)
class RunFolder:
    """``runs/<time>_<site>/``; all names inside are made here and nowhere else."""

    path: Path

    @classmethod
    def create(cls, parent: Path, site: str) -> "RunFolder":
        """A new folder named by the time and the site; missions of the same second are numbered.

        Raises:
            FailureError: ``DISK_FULL``, ``IO_ERROR`` where there can be none.
        """
        stamp = datetime.now(UTC).strftime("%Y-%m-%dT%H-%M-%S")
        with writing(parent):
            parent.mkdir(parents=True, exist_ok=True)
            for number in itertools.count(1):
                path = parent / (f"{stamp}_{site}" if number == 1 else f"{stamp}_{site}_{number}")
                with suppress(FileExistsError):
                    path.mkdir()
                    break
            return cls.at(path)

    @classmethod
    def at(cls, path: Path) -> "RunFolder":
        """The folder of this very name, made if absent."""
        for name in _FOLDERS:
            (path / name).mkdir(parents=True, exist_ok=True)
        return cls(path)

    @property
    def events(self) -> Path:
        return self.path / "events.jsonl"

    @property
    def ledger(self) -> Path:
        """The mission's durable memory."""
        return self.path / "mission.db"

    @property
    def config(self) -> Path:
        return self.path / "config.yaml"

    @property
    def state(self) -> Path:
        return self.path / "state.json"

    @property
    def simulation(self) -> Path:
        """Where simulated agents keep their truth; only the evaluation reads it."""
        return self.path / "simulation"

    @property
    def rehearsal(self) -> Path:
        """What was simulated: world, seed, options."""
        return self.simulation / "rehearsal.json"

    @property
    def world(self) -> Path:
        """The building that was simulated."""
        return self.simulation / "world.npz"

    @property
    def agents(self) -> Path:
        """The process ids of a rehearsal's agents."""
        return self.simulation / "agents.json"

    @property
    def report(self) -> Path:
        return self.path / "report.html"

    @property
    def comparisons(self) -> Path:
        """What the pose graph found of each pair of scans that it compared."""
        return self.path / "evidence" / "comparisons.json"

    def scan_file(self, scan_id: str) -> Path:
        return self.path / "scans" / f"{scan_id}.scan"

    def robot_map(self, map_id: str) -> Grid:
        return load_grid(self.path / "maps" / f"{map_id}.npz")

    def free_gb(self) -> float:
        return shutil.disk_usage(self.path).free / 1e9

    def map_file(self, map_id: str) -> Path:
        return self.path / "maps" / f"{map_id}.npz"

    def map_evidence_file(self, map_id: str) -> Path:
        return self.path / "maps" / f"{map_id}_evidence.npz"

    def voxel_file(self, room_id: str, cycle: int) -> Path:
        return self.path / "voxels" / f"{room_id}_{cycle:02d}.npz"

    def evidence_file(self, room_id: str, cycle: int, name: str) -> Path:
        return self.path / "evidence" / f"{room_id}_{cycle:02d}_{name}.npz"

    def write_state(self, state: Mapping[str, Any]) -> None:
        # Often, and made of what the ledger has: a power cut may cost the last one.
        write_text(self.state, json.dumps(state, default=plain), durably=False)


def write_text(path: Path, text: str, durably: bool = True) -> None:
    """Write a whole text file or none of it. Raises ``DISK_FULL``, ``IO_ERROR``."""
    with _whole(path, durably) as stream:
        stream.write(text.encode("utf-8"))


def read_mapping(path: Path, parse: Callable[[str], Any] = json.loads) -> dict[str, Any]:
    """What a file of names and values says.

    Raises:
        FailureError: ``RUN_UNREADABLE`` where there is no such file, or one that says something else.
    """
    try:
        found = parse(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, yaml.YAMLError) as error:
        raise FailureError("RUN_UNREADABLE", f"{path} cannot be read: {error}") from error
    if not isinstance(found, dict):
        raise FailureError("RUN_UNREADABLE", f"{path}: expected names and values, found {found!r:.40}")
    return found


def write_arrays(path: Path, **arrays: object) -> None:
    """Write an ``.npz`` of plain arrays, whole or not at all. Raises ``DISK_FULL``, ``IO_ERROR``."""
    values: dict[str, Any] = {name: np.asarray(value) for name, value in arrays.items()}
    with _whole(path, durably=True) as stream:
        np.savez_compressed(stream, **values)


@contextmanager
def _whole(path: Path, durably: bool) -> Iterator[BinaryIO]:
    """A file that is seen under its name when it is whole, and on the disk then if ``durably``.

    Raises:
        FailureError: ``DISK_FULL``, ``IO_ERROR``; nothing is left then but what had the name before.
    """
    with whole_file(path) as partial, partial.open("wb") as stream:
        yield stream
        stream.flush()
        if durably:
            os.fsync(stream.fileno())
    if durably:
        with writing(path):
            sync_folder(path.parent)  # without it the name may be gone after a power cut though the bytes are there


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """The name to write a file under that is seen as ``path`` when the block has ended well.

    Raises:
        FailureError: ``DISK_FULL``, ``IO_ERROR``.
    """
    # Of its own, for the worker of an executive that was killed may write the same file for a moment more.
    partial = path.with_name(f"{path.stem}.{os.getpid()}.partial{path.suffix}")
    try:
        with writing(path):
            yield partial
            partial.replace(path)
    except BaseException:
        with suppress(OSError):
            partial.unlink(missing_ok=True)
        raise


def read_arrays(path: Path) -> dict[str, NDArray[Any]]:
    """Arrays of an ``.npz`` of a run. Raises ``RUN_LOSSY``, naming the file, if it is missing or damaged."""
    try:
        return disk.read_arrays(path)
    except (OSError, ValueError) as error:
        raise FailureError("RUN_LOSSY", f"{path} cannot be read: {error}", file=str(path)) from error


def save_grid(path: Path, grid: Grid) -> None:
    write_arrays(path, data=grid.data, origin=grid.origin, resolution=grid.resolution)


def load_grid(path: Path) -> Grid:
    arrays = read_arrays(path)
    x, y = arrays["origin"]
    return Grid(arrays["data"], (float(x), float(y)), float(arrays["resolution"]))


def save_space(path: Path, space: VoxelSpace, **more: object) -> None:
    """Write a space, and what else of plain arrays belongs to it."""
    write_arrays(path, labels=space.labels, origin=space.origin, size=space.size, **more)


def load_space(path: Path) -> VoxelSpace:
    arrays = read_arrays(path)
    x, y, z = (float(value) for value in arrays["origin"])
    return VoxelSpace(arrays["labels"], (x, y, z), float(arrays["size"]))
