"""What is delivered when a mission has ended: E57, the map for others' planners, and the report."""

import logging
from collections.abc import Callable
from pathlib import Path

from mission.export.e57 import write_e57
from mission.export.ros_map import write_ros_map
from mission.report import write_report
from mission.report.run import read_run
from mission.store import RunFolder
from perception.failure import FailureError


def finish(folder: RunFolder) -> Path:
    """Write every delivery of a run; one that fails is logged and does not keep the others from being written."""
    _attempt("building.e57", lambda: write_e57(folder.path))
    _attempt("the robot map", lambda: _export_map(folder))
    return write_report(folder.path)


def _export_map(folder: RunFolder) -> None:
    map_id = read_run(folder.path).state.get("map_id")
    if map_id:
        write_ros_map(folder.robot_map(map_id), folder.path / "maps" / "building")


def _attempt(what: str, deliver: Callable[[], object]) -> None:
    log = logging.getLogger("mission")
    try:
        deliver()
    except FailureError as error:
        log.warning("%s was not written: %s", what, error)
    except Exception:
        log.exception("%s was not written", what)
