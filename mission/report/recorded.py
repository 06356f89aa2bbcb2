"""What the report says of scans that somebody else took: each by itself, and against the poses that came with it."""

import math

from mission.report.run import Record, Run
from mission.report.tables import Row


def recorded(run: Run) -> list[Row]:
    """A row a set-up that was read, or a file that was not; none for a mission of our own."""
    return [_row(scan) for scan in run.state.get("recorded") or ()]


def _row(scan: Record) -> Row:
    alignment, alone = scan.get("alignment") or {}, scan.get("alone") or {}
    error, registration = scan.get("from_given_pose") or {}, scan.get("registration") or {}
    floor, ceiling = alone.get("floor_z"), alone.get("ceiling_z")
    return {
        "scan": scan.get("scan_id"),
        "source": scan.get("source"),
        "points": scan.get("points"),
        "beams": scan.get("beams"),
        "origin": scan.get("origin"),
        "roll_deg": _degrees(alignment.get("roll")),
        "pitch_deg": _degrees(alignment.get("pitch")),
        "scanner_height": alignment.get("scanner_height"),
        "ceiling_z": alignment.get("ceiling_z"),
        "height_m": None if floor is None or ceiling is None else ceiling - floor,
        "area_m2": alone.get("area"),
        "doors": len(alone.get("doors") or ()),
        "alone_refused": alone.get("contour_refused") or alone.get("doors_refused"),
        "registered_to": registration.get("reference"),
        "error_cm": None if error.get("distance_m") is None else 100 * error["distance_m"],
        "error_deg": error.get("angle_deg"),
        "seconds": dict(scan.get("seconds") or {}),
        "refused": scan.get("refused"),
    }


def _degrees(angle: float | None) -> float | None:
    return None if angle is None else math.degrees(angle)
