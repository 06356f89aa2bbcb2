"""What is delivered when a mission has ended: E57, the map for others' planners, and the report."""

from mission.attempt import attempt
from mission.export.e57 import write_e57
from mission.export.ros_map import write_ros_map
from mission.report import write_report
from mission.report.run import EVALUATION, Run, read_run
from mission.store import RunFolder

_CLOUD, _MAP = "building.e57", "maps/building"


def finish(folder: RunFolder) -> bool:
    """Write every delivery of a run; one that fails is logged and does not keep the others from being written.

    A rehearsal is compared with its world first, for the report tells what came of that.

    Returns:
        Whether all were written.
    """
    written = [
        attempt(f"{_CLOUD} was not written", lambda: write_e57(folder.path)),
        attempt("the robot map was not written", lambda: _export_map(folder)),
        not folder.rehearsal.exists() or attempt("the mission was not evaluated", lambda: _evaluate(folder)),
        attempt("the report was not written", lambda: write_report(folder.path)),
    ]
    return all(written)


def report_again(folder: RunFolder) -> bool:
    """The report anew; where a mission has ended and something kept it from delivering, all that it delivers.

    Raises:
        FailureError: ``RUN_UNREADABLE`` if the folder holds no run, ``DISK_FULL``, ``IO_ERROR``.
    """
    run = read_run(folder.path)
    if run.state.get("outcome") and run.scans and not _is_delivered(folder, run):
        return finish(folder)
    write_report(folder.path)
    return True


def _is_delivered(folder: RunFolder, run: Run) -> bool:
    """Whether the cloud, the map and the evaluation that belong to a run are there, and not of an earlier end of it."""
    due = [folder.path / _CLOUD]
    if run.state.get("map_id"):
        due.append(folder.path / f"{_MAP}.yaml")
    if folder.rehearsal.exists():
        due.append(folder.path / EVALUATION)
    ended = folder.state.stat().st_mtime
    return all(file.exists() and file.stat().st_mtime >= ended for file in due)


def _evaluate(folder: RunFolder) -> None:
    from mission.evaluation import evaluate_run

    evaluate_run(folder.path)


def _export_map(folder: RunFolder) -> None:
    if map_id := read_run(folder.path).state.get("map_id"):
        write_ros_map(folder.robot_map(map_id), folder.path / _MAP)
