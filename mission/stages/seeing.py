"""Stages about what was seen and from where more would be: voxel space, labelled map, next best view."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal
from weakref import WeakKeyDictionary

import numpy as np
import shapely

from mission.stages import selection
from mission.stages.scan_library import Library, PlacedScans, matrix
from mission.store import load_space, read_arrays, save_space, write_arrays
from perception import labelled_map, next_best_view, voxels
from perception.findings import LabelCounts, RoomShape, ViewChoice
from perception.grids import Grid, Label, VoxelSpace
from perception.labelled_map import Pose, Robot
from perception.next_best_view import NOT_EVALUATED, Ranking
from perception.rays.visibility import Sight
from perception.sensor import Sensor

_MOVED = 0.002
"""Poses that differ by less (metres, entries of a rotation) are the same to a voxel."""

_sights: WeakKeyDictionary[Library, tuple[str, Sight | None]] = WeakKeyDictionary()
"""What was in sight in the room that a library was last asked about: the next cycle is the faster for it."""


def label_space(
    library: Library,
    room_id: str,
    cycle: int,
    shape: RoomShape,
    scans: PlacedScans,
    voxel: float,
    labeller: Literal["range", "paper"],
) -> LabelCounts:
    """Label with what a scan shows of all voxels, once; later only of those by which the room has grown."""
    file = library.run.voxel_file(room_id, cycle - 1)
    before, known = _labelled_before(file, scans) if file.exists() else (None, set())
    space = voxels.room_space(shape, voxel, before)
    grown = None if before is None else voxels.added(space, before)
    room = shapely.Polygon(shape.contour)
    looked_at = {name for name, _ in selection.of_room(scans, room)}
    unknown = (looked_at | selection.taken_in(scans, room)) - known
    for name, pose in scans:
        if name == scans[-1][0]:
            space = voxels.label(space, library.scan(name), matrix(pose), labeller)
        elif name in unknown:
            space = voxels.label(space, library.coarse(name), matrix(pose), labeller)
        elif name in looked_at and grown is not None and grown.any():
            space = voxels.label(space, library.coarse(name), matrix(pose), labeller, within=grown)
    _save_labelled(library.run.voxel_file(room_id, cycle), space, scans)
    return voxels.counts(space)


def _labelled_before(file: Path, scans: PlacedScans) -> tuple[VoxelSpace, set[str]]:
    """The space of an earlier cycle and the scans in it; without labels if one of those has been moved since."""
    space, arrays = load_space(file), read_arrays(file)
    poses = dict(zip(arrays["scans"].tolist(), arrays["poses"], strict=True))
    moved = [name for name, pose in scans if name in poses and not np.allclose(poses[name], pose, atol=_MOVED)]
    if not moved:
        return space, set(poses)
    unseen = np.where(space.labels == Label.OUTSIDE, space.labels, np.uint8(Label.OCCLUDED))
    return VoxelSpace(unseen, space.origin, space.size), set()


def _save_labelled(file: Path, space: VoxelSpace, scans: PlacedScans) -> None:
    names, poses = [name for name, _ in scans], [pose for _, pose in scans]
    save_space(file, space, scans=names, poses=poses)


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
    room_before, sight = _sights.get(library, (room_id, None))
    ranking = next_best_view.rank_views(
        space,
        field,
        sensor,
        shape.floor_z,
        weight=gain,
        avoid=avoid,
        earlier=sight if room_before == room_id else None,
    )
    _sights[library] = (room_id, ranking.sight)
    _keep_view(library, room_id, cycle, labelled_map.labelled_map(space, height, shape.floor_z), ranking, pose)
    return ranking.choice


def _keep_view(library: Library, room_id: str, cycle: int, labels: Grid, ranking: Ranking, pose: Pose) -> None:
    """The evidence of a choice: the labelled map, and every candidate with its score and whether that was counted."""
    cells = np.argwhere(ranking.estimates.data > NOT_EVALUATED)
    of_cells = tuple(cells.T)
    counted = ranking.gains.data[of_cells] > NOT_EVALUATED
    scored = np.column_stack([ranking.estimates.centres_of(cells), ranking.estimates.data[of_cells], counted])
    write_arrays(
        library.run.evidence_file(room_id, cycle, "view"),
        data=labels.data,
        origin=labels.origin,
        resolution=labels.resolution,
        candidates=scored,
        station=pose,
        best=[(best.x, best.y, best.gain, best.path_length) for best in ranking.choice.best],
    )
