"""The figures of the report, computed from the run alone and ready for JSON."""

from collections import Counter
from typing import Any

from mission.report.run import Record, Run
from mission.report.timing import status
from mission.state import reason_of

Row = dict[str, Any]

LIMITS: dict[str, tuple[float, float]] = {
    "agreement": (0.85, 0.75),
    "rmse": (0.010, 0.012),
    "overlap": (0.30, 0.15),
    "min_eigenvalue": (0.04, 0.02),
}
"""For each registration figure the value that passes, and the one beyond which it fails: a scan is refused there."""

_SMALLER_IS_BETTER = {"rmse"}

_WORDS = {
    "lambda_mu": "λ and μ fell below their thresholds: the last scan added next to nothing",
    "predicted_gain": "no view promised enough that is new",
    "no_candidate": "no place is left from which more could be seen",
    "max_scans": "the most scans that a room may have were taken",
    "views_blocked": "the ways to all remaining views were blocked",
}
"""The codes that end a room, for the surveyor."""

_DOOR_WORDS = {
    "unexplored": "not entered before the mission ended",
    "passed": "passed",
    "linked": "leads to a room that was entered by another door",
    "deferred": "left for later, and not tried again",
    "refused": "could not be passed",
    "forbidden": "leads out of the fence",
}

_RECOVERIES = {
    "move nearby": "the scan was taken again from a spot nearby",
    "register by features": "a scan was registered by features instead of from odometry",
    "when they have gone": "somebody was in a scan, and another was taken when they had gone",
    "bridge": "a scan between was taken to find the place of another",
    "register the scan set aside": "a scan that had been set aside found its place",
    "next best instead": "a view that could not be reached gave way to the next best",
    "another door": "a door that could not be passed was left for later",
    "order it anew": "a drive that was broken off from outside was ordered anew",
    "ask for help": "the operator was asked about a room that could not be finished",
    "ask for open doors": "the operator was asked to open doors that could not be passed",
    "charge": "the robot went home to charge, and back to work",
}
"""Names of the tree's recovery branches."""

_ORDERLY_ENDS = {"NO_DOOR_LEFT"}
"""Codes by which the tree ends a loop as it should; nothing went wrong there."""


def outcome(run: Run) -> Row:
    """How the mission ended, and the totals."""
    ended = run.events_of("mission_ended")
    last = ended[-1] if ended else {}
    return {
        "run": run.name,
        "outcome": run.state.get("outcome") or last.get("outcome") or "unfinished",
        "reason": reason_of(run.state),
        "started": run.state.get("started"),
        "ended": run.state.get("ended"),
        "wall_s": run.state.get("wall_s"),
        "simulated_s": run.state.get("simulated_s"),
        "rooms": len(run.rooms),
        "rooms_complete": sum(room.get("status") == "complete" for room in run.rooms),
        "scans": len(run.scans),
        "points": sum(_points(run).values()),
        "doors": len(run.doors),
        "area_m2": sum(polygon_area(room.get("contour") or ()) for room in run.rooms),
        "driven_m": sum(float(event.get("distance") or 0.0) for event in run.events_of("drive")),
    }


def polygon_area(contour: Any) -> float:
    """Area inside a closed contour of (x, y), square metres."""
    pairs = zip(contour, [*contour[1:], *contour[:1]], strict=True)
    return abs(sum(a[0] * b[1] - b[0] * a[1] for a, b in pairs)) / 2


def table_1(run: Run) -> list[Row]:
    """The paper's Table 1, one row a room: N, P, V_s, lambda, O, E, O_c, their shares of V, and mu."""
    points = _points(run)
    return [_table_1_row(room, points) for room in run.rooms]


def _points(run: Run) -> dict[str, int]:
    return {str(event.get("scan_id")): int(event.get("points") or 0) for event in run.events_of("scan")}


def _table_1_row(room: Record, points: dict[str, int]) -> Row:
    scans = list(room.get("scans") or ())
    row: Row = {
        "room": room["id"],
        "name": room.get("name") or room["id"],
        "N": len(scans),
        "P": sum(points.get(scan, 0) for scan in scans),
        "area_m2": polygon_area(room.get("contour") or ()),
    }
    cycles = [cycle for cycle in room.get("cycles") or () if cycle.get("occupied") is not None]
    if not cycles:
        return row
    last = cycles[-1]
    occupied, empty, occluded = (int(last[key]) for key in ("occupied", "empty", "occluded"))
    total = max(1, occupied + empty + occluded)
    return row | {
        "V": total,
        "V_s": occupied + empty,
        "growing_rate": last.get("growing_rate"),
        "O": occupied,
        "E": empty,
        "O_c": occluded,
        "O/V": occupied / total,
        "E/V": empty / total,
        "O_c/V": occluded / total,
        "occluded_decrease_rate": last.get("occluded_decrease_rate"),
        "predicted_rate": last.get("predicted_rate"),
        "cycles": [dict(cycle) for cycle in cycles],
    }


def rooms(run: Run) -> list[Row]:
    """Each room with its state and why it ended, in words."""
    return [
        {
            "id": room["id"],
            "name": room.get("name") or room["id"],
            "status": room.get("status") or "unknown",
            "scans": list(room.get("scans") or ()),
            "reason_ended": room.get("reason_ended"),
            "reason": _why_ended(run, room),
            "height_m": _height(room),
            "area_m2": polygon_area(room.get("contour") or ()),
        }
        for room in run.rooms
    ]


def _why_ended(run: Run, room: Record) -> str:
    """The reason in words; for the code of a failure, the last words that were said with it in this room."""
    code = room.get("reason_ended")
    if not code:
        return "the mission ended first"
    said = ""
    for event in run.events_of("failure", "room_ended"):
        if event["kind"] == "failure" and event.get("code") == code:
            said = str(event.get("message") or "")
        elif event.get("room_id") == room["id"]:
            break
    return f"{words(code)}: {said}" if said else words(code)


def words(code: Any) -> str:
    """A code in plain words; one of a failure, and a sentence, stay as they are."""
    text = str(code or "")
    return _WORDS.get(text) or (text if " " in text or text.isupper() else text.replace("_", " "))


def _height(room: Record) -> float | None:
    floor, ceiling = room.get("floor_z"), room.get("ceiling_z")
    return None if floor is None or ceiling is None else float(ceiling) - float(floor)


def registrations(run: Run) -> list[Row]:
    """Each scan's registration with a verdict a figure, and the worst of them for the scan.

    ``agreement`` is the part of the overlap that fits within the last correspondence distance.
    """
    return [_registration(scan) for scan in run.scans]


def _registration(scan: Record) -> Row:
    figures = scan.get("registration") or {}
    keys = ("method", "fitness", "rmse", "overlap", "min_eigenvalue", "correction_m", "correction_rad")
    row: Row = {"scan": scan["scan_id"], "room": scan.get("room_id")} | {key: figures.get(key) for key in keys}
    row |= {key: scan.get(key) for key in ("residual", "moved_m", "movement")}
    fitness, overlap = row["fitness"], row["overlap"]
    row["agreement"] = fitness / overlap if fitness is not None and overlap else None
    if row["method"] == "anchor":
        return row | {"verdicts": {}, "verdict": "reference"}
    verdicts = {key: verdict(key, row[key]) for key in LIMITS if row[key] is not None}
    worst = next((word for word in ("fail", "warn", "pass") if word in verdicts.values()), "")
    return row | {"verdicts": verdicts, "verdict": worst}


def pose_graph(run: Run) -> Row | None:
    """What came of reconsidering all poses together, the first time to the last; None if it never happened."""
    events = run.events_of("poses_optimised")
    if not events:
        return None
    last = events[-1]
    keys = ("compared", "refused", "disbelieved", "rms_after", "loops", "taken", "reason")
    moved = [float(scan["moved_m"]) for scan in run.scans if scan.get("moved_m") is not None]
    whole = {"rms_before": events[0].get("rms_before"), "moved_m": max(moved, default=0.0), "times": len(events)}
    return {key: last.get(key) for key in keys} | whole


def verdict(figure: str, value: float) -> str:
    """``pass``, ``warn`` or ``fail`` by :data:`LIMITS`."""
    sign = -1 if figure in _SMALLER_IS_BETTER else 1
    good, fair = LIMITS[figure]
    if sign * value >= sign * good:
        return "pass"
    return "warn" if sign * value >= sign * fair else "fail"


def doors(run: Run) -> list[Row]:
    """Doors found, what they join, and what became of them."""
    names = run.room_names
    return [
        {
            "id": door.get("id"),
            **_measures(door),
            "state": door.get("state") or "",
            "reason": door_reason(door),
            "rooms": [names.get(room, room) if room else None for room in door.get("rooms") or ()],
        }
        for door in run.doors
    ]


def door_reason(door: Record) -> str:
    """What became of a door, in words; its own reason where it has one."""
    said = words(door.get("reason"))
    known = _DOOR_WORDS.get(str(door.get("state")), words(door.get("state")))
    return f"{known}: {said}" if said and known else said or known


def openings(run: Run) -> list[Row]:
    """Openings that were looked at and turned down, as the last look from each room judged them."""
    latest = {event.get("room_id"): event for event in run.events_of("doors")}
    names = run.room_names
    return [
        {"room": names.get(str(room), room), "gate": words(opening.get("gate")), **_measures(opening)}
        for room, event in latest.items()
        for opening in event.get("refused") or ()
    ]


def _measures(door: Record) -> Row:
    return {key: door.get(key) for key in ("x", "y", "width", "net_width", "height", "confidence")}


def left_out(run: Run) -> list[Row]:
    """Rooms that were not finished, and doors with no room behind them, each with its named reason."""
    unfinished = [
        {"what": room["name"], "reason": room["reason"]} for room in rooms(run) if room["status"] != "complete"
    ]
    unentered = [
        {"what": f"the room behind door {door.get('id')}", "reason": door_reason(door) or "not entered"}
        for door in run.doors
        if sum(room is not None for room in door.get("rooms") or ()) < 2
    ]
    return unfinished + unentered


def failures(run: Run) -> list[Row]:
    """Every failure in its order."""
    return [
        {"t": e.get("t"), "code": e.get("code"), "message": e.get("message"), "evidence": e.get("evidence") or {}}
        for e in run.events_of("failure")
        if e.get("code") not in _ORDERLY_ENDS
    ]


def recoveries(run: Run) -> list[Row]:
    """Recovery branches of the tree that ran: how often, and how often they did what they are for."""
    nodes = [event for event in run.events_of("node") if str(event.get("node")) in _RECOVERIES]
    ended = [(str(event.get("node")), status(event)) for event in nodes]
    tried = Counter(name for name, status in ended if status in ("SUCCESS", "FAILURE"))
    helped = Counter(name for name, status in ended if status == "SUCCESS")
    return [{"branch": _RECOVERIES[name], "tried": n, "helped": helped[name]} for name, n in tried.most_common()]
