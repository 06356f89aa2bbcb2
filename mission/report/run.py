"""A run folder read back: nothing here writes, and what a broken-off run lacks is simply empty."""

import contextlib
import json
import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from drivers import scan_file
from mission.journal import read_events
from mission.store import RunFolder, read_arrays, read_mapping
from perception.failure import FailureError
from perception.grids import Grid
from perception.scan import Scan
from perception.transforms import Matrix

Record = Mapping[str, Any]

EVALUATION = "evaluation.json"


@dataclass(frozen=True)
class Run:
    """What a mission left behind.

    Args:
        folder: the run folder.
        config: the resolved configuration.
        state: the survey as it stood at the end (``rooms``, ``doors``, ``scans``, ``outcome`` ...).
        events: the event log in its order.
        evaluation: the comparison with a known building, or None without one.
    """

    folder: Path
    config: Record
    state: Record
    events: tuple[Record, ...]
    evaluation: Record | None

    @property
    def name(self) -> str:
        return self.folder.name

    @property
    def rooms(self) -> list[Record]:
        return list(self.state.get("rooms") or ())

    @property
    def doors(self) -> list[Record]:
        return list(self.state.get("doors") or ())

    @property
    def scans(self) -> list[Record]:
        """Scans in the order in which they were taken; each has a pose."""
        return [scan for scan in self.state.get("scans") or () if scan.get("map_from_scanner") is not None]

    @property
    def room_names(self) -> dict[str, str]:
        return {room["id"]: room.get("name") or room["id"] for room in self.rooms}

    def events_of(self, *kinds: str) -> list[Record]:
        return [event for event in self.events if event.get("kind") in kinds]

    def clouds(self) -> Iterator[tuple[Record, Matrix, Scan]]:
        """Each registered scan whose file is there: its record, ``map_from_scanner`` and the scan, one at a time."""
        for record in self.scans:
            path = self.folder / (record.get("file") or f"scans/{record['scan_id']}.scan")
            if path.is_file():
                yield record, np.asarray(record["map_from_scanner"], float), scan_file.read(path)

    def arrays(self, pattern: str) -> list[tuple[Path, dict[str, NDArray]]]:
        """The ``.npz`` files of the folder that match a pattern, oldest first; unreadable ones are left out."""
        found = []
        for path in sorted(self.folder.glob(pattern), key=_natural):
            # A run that was killed may leave a file cut short.
            with contextlib.suppress(FailureError):
                found.append((path, read_arrays(path)))
        return found


def _natural(path: Path) -> list[tuple[int, str]]:
    """Order of names in which M10 follows M2."""
    return [(int(part or 0), text) for text, part in re.findall(r"(\D*)(\d*)", path.name)]


def grid_of(arrays: Mapping[str, NDArray], key: str = "data") -> Grid | None:
    """The grid stored as ``data`` (or another key), ``origin`` and ``resolution``; None if one is missing."""
    if not {key, "origin", "resolution"} <= set(arrays):
        return None
    x, y = (float(value) for value in arrays["origin"][:2])
    return Grid(arrays[key], (x, y), float(arrays["resolution"]))


def read_run(folder: Path) -> Run:
    """Read a run folder.

    Raises:
        FailureError: ``RUN_UNREADABLE`` if it holds neither a survey nor an event log, or a file that is none.
    """
    run = RunFolder(Path(folder))
    if not run.state.is_file() and not run.events.is_file():
        raise FailureError("RUN_UNREADABLE", f"{folder} is no run folder: no {run.state.name}, no {run.events.name}")
    evaluation = run.path / EVALUATION
    return Run(
        run.path,
        _mapping(run.config, yaml.safe_load) or {},
        _mapping(run.state) or {},
        tuple(read_events(run.events)),
        _mapping(evaluation),
    )


def _mapping(path: Path, parse: Callable[[str], Any] = json.loads) -> dict[str, Any] | None:
    """What a file of names and values says; None where there is no such file."""
    return read_mapping(path, parse) if path.is_file() else None
