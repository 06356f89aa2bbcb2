"""Stages about what was seen and from where more would be: voxel space, labelled map, next best view."""

from collections.abc import Sequence
from typing import Literal

import numpy as np

from mission.stages.scan_library import Library, PlacedScans, matrix
from mission.store import load_space, save_space, write_arrays
from perception import labelled_map, next_best_view, voxels
from perception.findings import LabelCounts, RoomShape, ViewChoice
from perception.grids import Grid
from perception.labelled_map import Pose, Robot
from perception.sensor import Sensor


def label_space(
    library: Library,
    room_id: str,
    cycle: int,
    shape: RoomShape,
    scans: PlacedScans,
    voxel: float,
    labeller: Literal["range", "paper"],
) -> LabelCounts:
    before = library.run.voxel_file(room_id, cycle - 1)
    space = voxels.room_space(shape, voxel, load_space(before) if before.exists() else None)
    for name, pose in scans:
        space = voxels.label(space, library.scan(name), matrix(pose), labeller)
    save_space(library.run.voxel_file(room_id, cycle), space)
    return voxels.counts(space)


def choose_view(
    library: Library,
    room_id: str,
    cycle: int,
    shape: RoomShape,
    scan_id: str,
    pose: Pose,
    stations: PlacedScans,
    track: Sequence[Pose],
    map_id: str,
    avoid: Sequence[tuple[float, float, float]],
    rule: Literal["graded", "paper"],
    gain: Literal["all", "surface"],
    path_clearance: float,
    goal_clearance: float,
) -> ViewChoice:
    space = load_space(library.run.voxel_file(room_id, cycle))
    scan = library.scan(scan_id)
    height = float(matrix(stations[-1][1])[2, 3]) - shape.floor_z
    sensor = Sensor.of(scan.pattern, height)
    field = labelled_map.candidates(
        space,
        pose,
        sensor,
        shape.floor_z,
        rule=rule,
        stations=[matrix(station)[:2, 3] for _, station in stations],
        driven=track,
        robot_map=library.run.robot_map(map_id),
        robot=Robot(security_goal=goal_clearance, security_path=path_clearance),
    )
    choice, gains = next_best_view.next_best_view(space, field, sensor, shape.floor_z, weight=gain, avoid=avoid)
    _keep_view(library, room_id, cycle, labelled_map.labelled_map(space, height, shape.floor_z), gains, pose, choice)
    return choice


def _keep_view(
    library: Library, room_id: str, cycle: int, labels: Grid, gains: Grid, pose: Pose, choice: ViewChoice
) -> None:
    """The evidence of a choice: the labelled map, and every candidate with its score."""
    cells = np.argwhere(gains.data > next_best_view.NOT_EVALUATED)
    scored = np.column_stack([gains.centres_of(cells), gains.data[tuple(cells.T)]])
    write_arrays(
        library.run.evidence_file(room_id, cycle, "view"),
        data=labels.data,
        origin=labels.origin,
        resolution=labels.resolution,
        candidates=scored,
        station=pose,
        best=[(best.x, best.y, best.gain, best.path_length) for best in choice.best],
    )
