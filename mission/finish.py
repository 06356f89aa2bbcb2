"""What is delivered when a mission has ended: E57, the map for others' planners, and the report."""

from pathlib import Path

from mission.attempt import attempt
from mission.export.e57 import write_e57
from mission.export.ros_map import write_ros_map
from mission.report import write_report
from mission.report.run import read_run
from mission.store import RunFolder


def finish(folder: RunFolder) -> Path:
    """Write every delivery of a run; one that fails is logged and does not keep the others from being written.

    Returns:
        Where the report is.
    """
    attempt("building.e57 was not written", lambda: write_e57(folder.path))
    attempt("the robot map was not written", lambda: _export_map(folder))
    attempt("the report was not written", lambda: write_report(folder.path))
    return folder.report


def _export_map(folder: RunFolder) -> None:
    map_id = read_run(folder.path).state.get("map_id")
    if map_id:
        write_ros_map(folder.robot_map(map_id), folder.path / "maps" / "building")
