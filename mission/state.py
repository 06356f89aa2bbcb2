"""The survey as plain data: what ``state.json`` holds, for the report, the evaluation and whoever asks."""

from collections.abc import Mapping
from typing import Any

from behaviours.survey import Cycle, ScanRecord, Survey


def describe(survey: Survey) -> dict[str, Any]:
    """Rooms with their cycles, doors, scans with their poses; JSON-ready but for arrays."""
    building = survey.building.to_dict()
    return {
        "rooms": [_room(survey, room) for room in building["rooms"]],
        "doors": building["doors"],
        "scans": [_scan(scan) for scan in survey.scans],
        "scans_without_place": [scan.scan_id for scan in survey.set_aside],
        "track": [list(pose) for pose in survey.track],
        "map_id": survey.map_id,
    }


def reason_of(state: Mapping[str, Any]) -> str:
    """What went wrong at the end of a mission, code and words, by its ``state.json``; empty if nothing did."""
    code, message = state.get("code") or "", state.get("message") or ""
    return f"{code}: {message}" if message else code


def _room(survey: Survey, room: Mapping[str, Any]) -> dict[str, Any]:
    room_id = room["id"]
    shape = survey.shapes.get(room_id)
    books: dict[str, Any] = {
        **room,
        "reason_ended": room["reason"],
        "scans": [scan.scan_id for scan in survey.room_scans(room_id)],
        "cycles": [_cycle(cycle) for cycle in survey.cycles.get(room_id, ())],
    }
    if shape is not None:
        books |= {
            "contour": shape.contour.tolist(),
            "walls": shape.walls.tolist(),
            "floor_z": shape.floor_z,
            "ceiling_z": shape.ceiling_z,
            "area": shape.area,
        }
    return books


def _cycle(cycle: Cycle) -> dict[str, Any]:
    counts, decision = cycle.counts, cycle.decision
    return {
        "scan_id": cycle.scan_id,
        "occupied": counts.occupied,
        "empty": counts.empty,
        "occluded": counts.occluded,
        "growing_rate": decision.growing_rate,
        "occluded_decrease_rate": decision.occluded_decrease_rate,
        "predicted_rate": decision.predicted_rate,
        "decision": decision.reason,
    }


def _scan(scan: ScanRecord) -> dict[str, Any]:
    found = scan.registration
    return {
        "scan_id": scan.scan_id,
        "room_id": scan.room_id,
        "file": f"scans/{scan.scan_id}.scan",
        "points": scan.points,
        "sha256": scan.receipt.sha256,
        "started": scan.receipt.started,
        "ended": scan.receipt.ended,
        "map_from_scanner": scan.map_from_scanner.tolist(),
        "map_from_base": scan.map_from_base.tolist(),
        "alignment": {
            "roll": scan.alignment.roll,
            "pitch": scan.alignment.pitch,
            "scanner_height": scan.alignment.scanner_height,
            "ceiling_z": scan.alignment.ceiling_z,
        },
        "residual": scan.residual,
        "moved_m": scan.moved_m,
        "movement": scan.movement,
        "registration": {
            "fitness": found.fitness,
            "rmse": found.rmse,
            "overlap": found.overlap,
            "min_eigenvalue": found.min_eigenvalue,
            "correction_m": found.correction_m,
            "correction_rad": found.correction_rad,
            "method": found.method,
        },
    }
