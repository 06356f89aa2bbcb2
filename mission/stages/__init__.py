"""The stages as the worker runs them: load from the run folder, call the pure function, keep what it made.

Each stage takes ids, poses and figures and returns a small value; arrays stay on disk and in the worker's memory.
"""

from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from typing import Any

from mission.stages import placing, seeing, shaping, warming
from mission.stages.scan_library import Library
from mission.store import RunFolder

STAGES: dict[str, Callable[..., Any]] = {
    "warm_up": warming.warm_up,
    "validate_scan": placing.validate_scan,
    "align_scan": placing.align_scan,
    "anchor_scan": placing.anchor_scan,
    "register_scan": placing.register_scan,
    "register_globally": placing.register_globally,
    "find_movement": placing.find_movement,
    "optimise_poses": placing.optimise_poses,
    "segment_room": shaping.segment_room,
    "build_map": shaping.build_map,
    "label_space": seeing.label_space,
    "choose_view": seeing.choose_view,
    "find_doors": shaping.find_doors,
}


def run(library: Library, stage: str, arguments: Mapping[str, Any]) -> Any:
    """Run a stage on the scans of a run.

    Raises:
        KeyError: for a stage that does not exist.
        FailureError: as the stage says.
    """
    return STAGES[stage](library, **arguments)


@lru_cache(maxsize=1)
def scans_of(folder: Path) -> Library:
    """The library of a run folder, the same one at every call, for a process that serves one mission."""
    return Library(RunFolder(folder))
