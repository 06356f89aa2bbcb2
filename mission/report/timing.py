"""Where the time of a mission went: scanning, driving, thinking; by stage, and by cycle."""

from collections import defaultdict
from datetime import datetime
from statistics import median
from typing import Any

from mission.report.run import Record, Run

Row = dict[str, Any]

_TAKING = "take the scan"
_DRIVES = "drive "
"""How the names of all leaves that drive begin."""


def times(run: Run) -> Row:
    """Seconds: scanning and driving by the mission's clock, thinking (of the machine) by stage and by cycle."""
    stages: dict[str, list[float]] = defaultdict(list)
    for event in run.events_of("stage"):
        stages[str(event.get("name"))].append(_seconds(event))
    rows = [
        {
            "stage": name.replace("_", " "),
            "count": len(s),
            "seconds": sum(s),
            "median": median(s),
            "mean": sum(s) / len(s),
            "worst": max(s),
        }
        for name, s in stages.items()
    ]
    return {
        "scanning": _running_seconds(run, _TAKING),
        "driving": sum(_seconds(event) for event in run.events_of("drive")),
        "thinking": sum(row["seconds"] for row in rows),
        "stages": sorted(rows, key=lambda row: -row["seconds"]),
        "cycles": cycles(run),
        "simulated_s": run.state.get("simulated_s"),
        "wall_s": run.state.get("wall_s"),
    }


def cycles(run: Run) -> list[Row]:
    """For each scan that came home: the seconds its stages took, and those of the wall until a goal was sent.

    ``wall`` is None where no goal followed before the next scan, as when a scan was taken again on the spot.
    """
    rows: list[Row] = []
    received: datetime | None = None
    for event in run.events_of("scan", "stage", "node"):
        if event["kind"] == "scan":
            rows.append({"scan": event.get("scan_id"), "thinking": 0.0, "wall": None})
            received = _moment(event)
        elif received is None:
            continue
        elif event["kind"] == "stage":
            rows[-1]["thinking"] += _seconds(event)
        elif str(event.get("node")).startswith(_DRIVES) and status(event) == "RUNNING":
            sent = _moment(event)
            rows[-1]["wall"] = (sent - received).total_seconds() if sent else None
            received = None
    return rows


def status(event: Record) -> str:
    """What a node of the tree became, in capitals."""
    return str(event.get("after") or "").upper()


def _seconds(event: Record) -> float:
    return float(event.get("seconds") or 0.0)


def _moment(event: Record) -> datetime | None:
    """The wall's time of an event; None where it cannot be read."""
    try:
        return datetime.fromisoformat(str(event.get("utc")))
    except ValueError:
        return None


def _running_seconds(run: Run, node: str) -> float:
    """Mission seconds for which a node of the tree was running."""
    total, since = 0.0, None
    for event in run.events_of("node"):
        if event.get("node") == node:
            now, running = float(event.get("t") or 0.0), status(event) == "RUNNING"
            total += now - since if since is not None else 0.0
            since = now if running else None
    return total
