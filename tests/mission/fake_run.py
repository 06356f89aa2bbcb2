"""A small building of two rooms and a run folder as a mission would have left it, for tests without a mission."""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import open3d as o3d
import yaml

from drivers import scan_file
from drivers.simulated.world import DoorState, DoorTruth, RoomTruth, Surface, Truth, World
from mission.store import RunFolder, save_grid, write_arrays
from perception import transforms
from perception.grids import Cell, Grid, Label
from perception.scan import BeamPattern
from tests.synthetic import Scene

HEIGHT = 3.0
MOUNT = transforms.from_euler(0, 0, 0, (0, 0, 1.3))
PATTERN = BeamPattern.with_step(np.deg2rad(1.0), (np.deg2rad(-40), np.deg2rad(60)), (0.5, 120.0))
WEST, EAST = (0.0, 0.0, 6.0, 4.0), (6.2, 0.0, 10.2, 4.0)
DOOR = (1.5, 2.5)
"""The door in the wall between x = 6.0 and 6.2, from y to y."""

WORLD_FROM_MAP = transforms.planar(3.0, 2.0, np.deg2rad(30))
STATIONS = {"S01": (3.0, 2.0, 0.4), "S02": (6.1, 2.0, 0.1), "S03": (8.2, 2.2, -0.7)}


def quad(*corners: tuple[float, float, float]) -> np.ndarray:
    a, b, c, d = (np.array(corner, np.float32) for corner in corners)
    return np.stack([np.stack([a, b, c]), np.stack([a, c, d])])


def upright(x0: float, y0: float, x1: float, y1: float, low: float = 0.0, high: float = HEIGHT) -> np.ndarray:
    """A wall that looks to the left of its way from the first to the second point."""
    return quad((x1, y1, low), (x0, y0, low), (x0, y0, high), (x1, y1, high))


def room_triangles(rectangle: tuple, door_x: float) -> list[tuple[np.ndarray, Surface]]:
    x0, y0, x1, y1 = rectangle
    corners = ((x0, y0), (x1, y0), (x1, y1), (x0, y1))
    far_x, (below, above) = (x0, DOOR) if door_x == x1 else (x1, DOOR[::-1])
    start, end = (y0, y1) if door_x == x1 else (y1, y0)
    return [
        (quad(*((x, y, 0.0) for x, y in corners)), Surface.FLOOR),
        (quad(*((x, y, HEIGHT) for x, y in reversed(corners))), Surface.CEILING),
        (upright(x0, y0, x1, y0), Surface.WALL),
        (upright(x1, y1, x0, y1), Surface.WALL),
        (upright(far_x, end, far_x, start), Surface.WALL),
        (upright(door_x, start, door_x, below), Surface.WALL),
        (upright(door_x, above, door_x, end), Surface.WALL),
        (upright(door_x, below, door_x, above, 2.1, HEIGHT), Surface.WALL),
    ]


def two_rooms(board: np.ndarray | None = None) -> World:
    """A west room of 6 x 4 m and an east one of 4 x 4 m, joined by an open door 1 m wide; one table in the west.

    ``board`` adds four corners ``(4, 3)`` of a piece of furniture.
    """
    (x0, x1), (y0, y1) = (WEST[2], EAST[0]), DOOR
    table = quad((1.0, 0.5, 0.75), (2.5, 0.5, 0.75), (2.5, 1.5, 0.75), (1.0, 1.5, 0.75))
    parts = [
        *room_triangles(WEST, WEST[2]),
        *room_triangles(EAST, EAST[0]),
        (quad((x0, y0, 0), (x1, y0, 0), (x1, y1, 0), (x0, y1, 0)), Surface.OTHER),
        (quad((x0, y0, 2.1), (x1, y0, 2.1), (x1, y1, 2.1), (x0, y1, 2.1)), Surface.OTHER),
        (upright(x0, y0, x1, y0, 0, 2.1), Surface.OTHER),
        (upright(x0, y1, x1, y1, 0, 2.1), Surface.OTHER),
        (table, Surface.FURNITURE),
    ]
    parts += [] if board is None else [(quad(*(tuple(corner) for corner in board)), Surface.FURNITURE)]
    corners = np.concatenate([triangles for triangles, _ in parts])
    surface = np.concatenate([np.full(len(triangles), kind, np.uint8) for triangles, kind in parts])
    rooms = tuple(
        RoomTruth(name, np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)]), 0.0, HEIGHT)
        for name, (x0, y0, x1, y1) in (("west", WEST), ("east", EAST))
    )
    door = DoorTruth(
        "D1", 6.1, 2.0, (1.0, 0.0), 1.0, 1.0, 1.0, 2.1, 0.2, ("west", "east"), DoorState.OPEN, passable=True
    )
    return World(
        "two rooms",
        corners.reshape(-1, 3),
        np.arange(3 * len(corners), dtype=np.int32).reshape(-1, 3),
        surface,
        (3.0, 2.0, 0.0),
        Truth(rooms, (door,)),
    )


@dataclass(frozen=True)
class FakeRun:
    """The folder and what it was made from; ``world_from_scanner`` by scan is the truth."""

    folder: Path
    world: World
    world_from_scanner: dict[str, np.ndarray]


def write_run(
    parent: Path, pose_errors: dict[str, np.ndarray] | None = None, board: np.ndarray | None = None
) -> FakeRun:
    """Three scans through two rooms; ``pose_errors`` are added to the mission's poses, in the scanner's frame."""
    world = two_rooms(board)
    folder = RunFolder.at(parent / "2026-01-02T03-04-05_two-rooms")
    scene = Scene(_mesh(world))
    true_poses = {
        name: transforms.planar(x, y, yaw) @ transforms.from_euler(0.01, -0.005, 0) @ MOUNT
        for name, (x, y, yaw) in STATIONS.items()
    }
    points = {}
    for name, pose in true_poses.items():
        scan = replace(scene.take(pose, PATTERN, scan_id=name), base_from_scanner=MOUNT)
        scan_file.write(folder.scan_file(name), scan)
        points[name] = len(scan.points)
    errors = pose_errors or {}
    poses = {
        name: transforms.inverse(WORLD_FROM_MAP) @ pose @ errors.get(name, np.eye(4))
        for name, pose in true_poses.items()
    }
    _write_truth(folder.simulation, true_poses)
    folder.config.write_text(yaml.safe_dump({"site": "two-rooms", "scan": {"step_deg": 1.0}}))
    folder.write_state(_state(poses))
    _write_events(folder.events, points)
    _write_arrays(folder)
    return FakeRun(folder.path, world, true_poses)


def _mesh(world: World) -> o3d.t.geometry.TriangleMesh:
    return o3d.t.geometry.TriangleMesh(
        o3d.core.Tensor(world.vertices), o3d.core.Tensor(world.triangles.astype(np.int32))
    )


def _write_truth(folder: Path, poses: dict[str, np.ndarray]) -> None:
    folder.mkdir()
    lines = [
        {"event": "scan", "time": 50.0 * n, "scan_id": name, "world_from_scanner": pose.tolist(), "moving": False}
        for n, (name, pose) in enumerate(poses.items(), 1)
    ]
    (folder / "truth.jsonl").write_text("".join(json.dumps(line) + "\n" for line in lines))


def to_map(points: np.ndarray) -> np.ndarray:
    padded = np.column_stack([points, np.zeros(len(points))])
    return transforms.apply(transforms.inverse(WORLD_FROM_MAP), padded)[:, :2].astype(float)


def _contour(rectangle: tuple) -> list[list[float]]:
    x0, y0, x1, y1 = rectangle
    return to_map(np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])).tolist()


def _cycle(scan: str, occupied: int, empty: int, occluded: int, rates: tuple) -> dict:
    names = ("growing_rate", "occluded_decrease_rate", "predicted_rate")
    counts = {"scan_id": scan, "occupied": occupied, "empty": empty, "occluded": occluded}
    return counts | dict(zip(names, rates, strict=True))


def _state(poses: dict[str, np.ndarray]) -> dict:
    normal = WORLD_FROM_MAP[:2, :2].T @ np.array([1.0, 0.0])
    x, y = to_map(np.array([(6.1, 2.0)]))[0]
    door = {
        "id": "D1", "x": x, "y": y, "normal": normal.tolist(), "width": 1.0, "net_width": 0.98, "height": 2.1,
        "confidence": 0.97, "rooms": ["R01", "R02"], "state": "passed",
    }  # fmt: skip
    figures = {"fitness": 0.93, "rmse": 0.006, "overlap": 0.71, "min_eigenvalue": 0.21, "correction_m": 0.11,
               "correction_rad": 0.02, "method": "icp"}  # fmt: skip
    weak = figures | {"overlap": 0.31, "min_eigenvalue": 0.004, "method": "global"}
    registrations = {"S01": figures | {"method": "anchor"}, "S02": figures, "S03": weak}
    rooms = {"S01": "R01", "S02": "R02", "S03": "R02"}
    return {
        "rooms": [
            {
                "id": "R01", "status": "complete", "reason_ended": "no_candidate", "scans": ["S01"],
                "contour": _contour(WEST), "floor_z": 0.0, "ceiling_z": HEIGHT,
                "cycles": [_cycle("S01", 5200, 61000, 5800, (1.0, 0.0, 0.02))],
            },
            {
                "id": "R02", "status": "partial", "reason_ended": "REG_DEGENERATE",
                "scans": ["S02", "S03"], "contour": _contour(EAST), "floor_z": 0.0, "ceiling_z": HEIGHT,
                "cycles": [
                    _cycle("S02", 3100, 36000, 8900, (1.0, 0.0, 0.15)),
                    _cycle("S03", 4300, 41500, 2200, (0.146, 0.14, 0.01)),
                ],
            },
        ],
        "doors": [door],
        "scans": [
            {
                "scan_id": name, "room_id": rooms[name], "map_from_scanner": pose.tolist(),
                "file": f"scans/{name}.scan", "registration": registrations[name],
                "started": f"2026-01-02T03:0{n}:00Z", "ended": f"2026-01-02T03:0{n}:45Z",
            }
            for n, (name, pose) in enumerate(poses.items(), 5)
        ],
        "outcome": "incomplete", "started": "2026-01-02T03:04:05Z", "ended": "2026-01-02T03:09:05Z",
        "wall_s": 61.0, "simulated_s": 300.0,
    }  # fmt: skip


def _write_events(path: Path, points: dict[str, int]) -> None:
    door = {"x": 1.0, "y": 2.0, "width": 0.5, "net_width": 0.5, "height": 1.2, "confidence": 0.9, "gate": "too_low"}
    failure = {"code": "REG_DEGENERATE", "message": "the smallest eigenvalue is 0.004", "evidence": {"value": 0.004}}
    events: list[tuple[float, dict]] = [
        (0.0, {"kind": "agent", "name": "scanner", "model": "vz-400", "serial": "S1234", "protocol": 1}),
        (0.0, {"kind": "mission_started", "site": "two-rooms"}),
    ]
    for number, (name, count) in enumerate(points.items()):
        t = 80.0 * number
        goal = {"goal_id": f"G{number}", "x": 0.0, "y": 0.5, "distance": 3.1, "seconds": 9}
        events += [
            (t, _node("take the scan", "INVALID", "RUNNING")),
            (t + 45, _node("take the scan", "RUNNING", "SUCCESS")),
            (t + 46, {"kind": "scan", "scan_id": name, "points": count}),
            (t + 47, {"kind": "stage", "name": "register", "scan_id": name, "seconds": 0.8}),
            (t + 49, {"kind": "stage", "name": "next_best_view", "scan_id": name, "seconds": 1.5 * (number + 1)}),
            (t + 60, {"kind": "drive", "result": "arrived" if number else "NAV_BLOCKED", **goal}),
        ]
    events += [
        (290.0, {"kind": "failure", **failure}),
        (291.0, _node("bridge", "RUNNING", "SUCCESS")),
        (292.0, {"kind": "doors", "room_id": "R01", "found": [], "refused": [door]}),
        (300.0, {"kind": "mission_ended", "outcome": "incomplete"}),
    ]
    lines = [json.dumps({"t": t, "utc": "2026-01-02T03:04:05Z", **event}) for t, event in events]
    path.write_text("\n".join(lines) + '\n{"t": 999, "kind": "no')


def _node(name: str, before: str, after: str) -> dict:
    return {"kind": "node", "node": name, "path": f"/mission/{name}", "before": before, "after": after, "feedback": ""}


def _write_arrays(folder: RunFolder) -> None:
    size, rows, columns = 0.1, 60, 110
    origin = (-4.5, -3.5)
    y, x = np.mgrid[0:rows, 0:columns]
    cells = np.full((rows, columns), Cell.UNKNOWN, np.uint8)
    cells[5:45, 5:100] = Cell.FREE
    cells[20:25, 40:55] = Cell.OBSTACLE
    grid = Grid(cells, origin, size)
    save_grid(folder.map_file("robot_map_S02"), grid)
    save_grid(folder.map_file("robot_map_S10"), grid.with_data(np.where(cells == Cell.OBSTACLE, Cell.FREE, cells)))
    write_arrays(folder.map_evidence_file("robot_map_S10"), cells=cells)
    labels = np.where(cells == Cell.UNKNOWN, Label.OUTSIDE, Label.EMPTY)
    labels[15:30, 60:80] = Label.OCCLUDED
    labels[cells == Cell.OBSTACLE] = Label.OCCUPIED
    free = np.argwhere(labels == Label.EMPTY)[::7]
    xy = grid.centres_of(free)
    gains = np.maximum(0, 3000 - 600 * np.hypot(xy[:, 0] - 1.5, xy[:, 1]))
    write_arrays(
        folder.evidence_file("R01", 1, "view"),
        data=labels, origin=origin, resolution=size, station=(0.0, 0.0),
        candidates=np.column_stack([xy, gains, gains > 1000]), best=[(1.5, 0.0, 2990, 1.5), (1.2, 0.0, 2800, 1.2)],
    )  # fmt: skip
    write_arrays(
        folder.evidence_file("R01", 1, "ceiling"),
        data=(np.hypot(x - 50, y - 25) < 30).astype(np.uint8), origin=origin, resolution=size,
        contour=np.array(_contour(WEST)),
    )  # fmt: skip
    save_grid(folder.evidence_file("R01", 1, "flatness"), grid)
