"""Poses, rooms and doors of a run against the truth."""

from collections.abc import Collection, Iterable, Mapping
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from drivers.simulated.world import DoorState, World
from drivers.wire.naming import full_name, own_name
from mission.report.run import Run
from perception import transforms
from perception.transforms import Matrix


def true_poses(run: Run, events: Iterable[Mapping[str, Any]]) -> dict[str, Matrix]:
    """``world_from_scanner`` of each scan of the run in the truth log, which may have those of other missions too."""
    mission = next((str(event["mission"]) for event in run.events if "mission" in event), "")
    taken = {str(event["scan_id"]): event for event in events if event["event"] == "scan"}
    return {
        name: np.asarray(event["world_from_scanner"], float)
        for full, event in taken.items()
        if full == full_name(mission, name := own_name(full))
    }


def world_from_map(run: Run, truth: Mapping[str, Matrix]) -> Matrix:
    """Where the map lies, by the first scan whose true pose is known; the identity without any."""
    for scan in run.scans:
        if scan["scan_id"] in truth:
            return truth[scan["scan_id"]] @ transforms.inverse(np.asarray(scan["map_from_scanner"], float))
    return np.eye(4)


def pose_errors(run: Run, world_from_map: Matrix, truth: Mapping[str, Matrix]) -> list[dict[str, Any]]:
    """Error of each accepted scan in metres and degrees; that of the first is zero by definition."""
    errors = []
    for scan in run.scans:
        if scan["scan_id"] in truth:
            found = world_from_map @ np.asarray(scan["map_from_scanner"], float)
            metres, radians = transforms.difference(truth[scan["scan_id"]], found)
            errors.append({"scan": scan["scan_id"], "error_m": metres, "error_deg": float(np.rad2deg(radians))})
    return errors


def finished_rooms(run: Run, world_from_map: Matrix, world: World, rooms: Collection[str], share: float) -> set[str]:
    """Which of the true rooms the contour of a finished room covers, by at least this share."""
    contours = [
        shapely.Polygon(in_world(world_from_map, room["contour"])).buffer(0)
        for room in run.rooms
        if room.get("status") == "complete" and len(room.get("contour") or ()) >= 3
    ]
    outlines = {name: shapely.Polygon(world.truth.room(name).polygon).buffer(0) for name in rooms}
    return {
        name
        for name, outline in outlines.items()
        if any(contour.intersection(outline).area >= share * outline.area for contour in contours)
    }


def match_doors(
    run: Run, world_from_map: Matrix, world: World, rooms: Collection[str], distance: float
) -> dict[str, list[str]]:
    """Doors by id: ``found``, those of them that are ``right``, ``expected`` and ``missed``; each counts once.

    Right is any door that stands open, however narrow and wherever it leads; expected are those that the robot could
    have passed, between two rooms of which it could reach one.
    """
    from scipy.optimize import linear_sum_assignment

    found = [door for door in run.doors if door.get("x") is not None]
    open_doors = [door for door in world.truth.doors if door.state != DoorState.SHUT]
    expected = [
        door.door_id
        for door in open_doors
        if door.passable and None not in door.rooms and not set(rooms).isdisjoint(door.rooms)
    ]
    places = in_world(world_from_map, [(door["x"], door["y"]) for door in found])
    truth = np.array([(door.x, door.y) for door in open_doors], float).reshape(-1, 2)
    apart = np.linalg.norm(places[:, None] - truth[None], axis=2)
    # Too far apart costs more than any number of good pairs, so the assignment gives up none of those for it.
    pairs = zip(*linear_sum_assignment(np.where(apart <= distance, apart, 1e6)), strict=True)
    matched = [(a, b) for a, b in pairs if apart[a, b] <= distance]
    known = {open_doors[b].door_id for _, b in matched}
    return {
        "found": [str(door.get("id")) for door in found],
        "right": [str(found[a].get("id")) for a, _ in matched],
        "expected": expected,
        "missed": [name for name in expected if name not in known],
    }


def in_world(world_from_map: Matrix, xy: Any) -> NDArray[np.float64]:
    """Positions ``(N, 2)`` on the floor of the map, in the world."""
    flat = np.asarray(xy, float).reshape(-1, 2)
    return flat @ world_from_map[:2, :2].T + world_from_map[:2, 3]
