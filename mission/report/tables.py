"""The figures of the report, computed from the run alone and ready for JSON."""

from collections import Counter, defaultdict
from typing import Any

from mission.report.run import Record, Run

Row = dict[str, Any]

LIMITS: dict[str, tuple[float, float]] = {
    "fitness": (0.6, 0.4),
    "rmse": (0.015, 0.03),
    "overlap": (0.4, 0.25),
    "min_eigenvalue": (0.03, 0.01),
}
"""For each registration figure the value that passes and the one that still gets a warning; beyond it, it fails."""

_SMALLER_IS_BETTER = {"rmse"}

_DOOR_WORDS = {
    "unexplored": "not entered",
    "passed": "passed",
    "entered": "passed",
    "explored": "passed",
    "too_narrow": "narrower than the robot",
    "narrow": "narrower than the robot",
    "blocked": "could not be reached",
    "failed": "could not be passed",
    "closed": "shut",
}

def outcome(run: Run) -> Row:
    """How the mission ended, and the totals."""
    ended = run.events_of("mission_ended")
    last = ended[-1] if ended else {}
    return {
        "run": run.name,
        "outcome": run.state.get("outcome") or last.get("outcome") or "unfinished",
        "reason": run.state.get("reason") or last.get("reason") or "",
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
            "reason": words(room.get("reason_ended")) or "the mission ended first",
            "height_m": _height(room),
            "area_m2": polygon_area(room.get("contour") or ()),
        }
        for room in run.rooms
    ]


def words(code: Any) -> str:
    """A code such as ``NO_CANDIDATE`` or ``stop_criteria`` as plain words; sentences stay as they are."""
    text = str(code or "")
    return text if " " in text else text.replace("_", " ").lower()


def _height(room: Record) -> float | None:
    floor, ceiling = room.get("floor_z"), room.get("ceiling_z")
    return None if floor is None or ceiling is None else float(ceiling) - float(floor)


def registrations(run: Run) -> list[Row]:
    """Each scan's registration with a verdict a figure and the worst of them for the scan."""
    rows = []
    for scan in run.scans:
        figures = scan.get("registration") or {}
        row: Row = {"scan": scan["scan_id"], "room": scan.get("room_id"), "method": figures.get("method", "")}
        row |= {key: figures.get(key) for key in ("correction_m", "correction_rad", *LIMITS)}
        anchor = row["method"] == "anchor"
        row["verdicts"] = {} if anchor else {k: verdict(k, row[k]) for k in LIMITS if row[k] is not None}
        row["verdict"] = "reference" if anchor else _worst(row["verdicts"].values())
        rows.append(row)
    return rows


def verdict(figure: str, value: float) -> str:
    """``pass``, ``warn`` or ``fail`` by :data:`LIMITS`."""
    sign = -1 if figure in _SMALLER_IS_BETTER else 1
    good, fair = LIMITS[figure]
    if sign * value >= sign * good:
        return "pass"
    return "warn" if sign * value >= sign * fair else "fail"


def _worst(verdicts: Any) -> str:
    present = set(verdicts)
    return next((word for word in ("fail", "warn", "pass") if word in present), "")


def doors(run: Run) -> list[Row]:
    """Doors found, what they join, and what became of them."""
    names = run.room_names
    return [
        {
            "id": door.get("id"),
            "x": door.get("x"),
            "y": door.get("y"),
            "width": door.get("width"),
            "net_width": door.get("net_width"),
            "height": door.get("height"),
            "confidence": door.get("confidence"),
            "state": door.get("state") or "",
            "reason": door_reason(door),
            "rooms": [names.get(room, room) if room else None for room in door.get("rooms") or ()],
        }
        for door in run.doors
    ]


def door_reason(door: Record) -> str:
    """What became of a door, in words; its own reason where it has one."""
    state = str(door.get("state") or "")
    said = words(door.get("reason"))
    known = _DOOR_WORDS.get(state, words(state))
    return f"{known}: {said}" if said and known else said or known


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


def times(run: Run) -> Row:
    """Where the time went, seconds: scanning and driving by the mission's clock, thinking (of the machine) by stage."""
    stages: dict[str, list[float]] = defaultdict(list)
    for event in run.events_of("stage"):
        stages[str(event.get("name"))].append(float(event.get("seconds") or 0.0))
    rows = [
        {"stage": words(name), "count": len(s), "seconds": sum(s), "mean": sum(s) / len(s), "worst": max(s)}
        for name, s in stages.items()
    ]
    return {
        "scanning": _sum_seconds(run.events_of("scan")),
        "driving": _sum_seconds(run.events_of("drive")),
        "thinking": sum(row["seconds"] for row in rows),
        "stages": sorted(rows, key=lambda row: -row["seconds"]),
        "simulated_s": run.state.get("simulated_s"),
        "wall_s": run.state.get("wall_s"),
    }


def _sum_seconds(events: list[Record]) -> float:
    return sum(float(event.get("seconds") or 0.0) for event in events)


def failures(run: Run) -> list[Row]:
    """Every failure in its order."""
    return [
        {"t": e.get("t"), "code": e.get("code"), "message": e.get("message"), "evidence": e.get("evidence") or {}}
        for e in run.events_of("failure")
    ]


def recoveries(run: Run) -> list[Row]:
    """Recovery branches of the tree that ran: how often, and how often they helped."""
    tried: Counter[str] = Counter()
    helped: Counter[str] = Counter()
    for event in run.events_of("node"):
        name, ended = str(event.get("node") or ""), str(event.get("to") or "").rsplit(".", 1)[-1].upper()
        if "recover" in f"{event.get('path') or ''}/{name}".lower() and ended in ("SUCCESS", "FAILURE"):
            tried[name] += 1
            helped[name] += ended == "SUCCESS"
    return [{"branch": words(name), "tried": n, "helped": helped[name]} for name, n in tried.most_common()]
