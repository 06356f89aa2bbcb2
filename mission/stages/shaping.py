"""Stages that find the shape of the room and of what can be driven over: contour, robot map, doors."""

from collections.abc import Sequence

import numpy as np
import shapely

from mission.stages import selection
from mission.stages.scan_library import Library, PlacedScans, matrix
from mission.store import read_arrays, save_grid, write_arrays
from mission.summaries import MapSummary
from perception import contour, robot_map, segmentation
from perception import doors as door_finding
from perception.findings import Door, DoorFindings, Polygon, RoomShape
from perception.grids import Cell
from perception.rays import sightlines
from perception.robot_map import MapEvidence

_HALF_WIDTH = 0.30
_IMAGE_CELL = 0.05


def segment_room(
    library: Library,
    room_id: str,
    cycle: int,
    seed: tuple[float, float],
    scans: PlacedScans,
    doors: Sequence[Door],
    others: Sequence[Polygon],
    previous: RoomShape | None,
) -> RoomShape:
    place = shapely.Point(seed) if previous is None else shapely.Polygon(previous.contour)
    points, stations, station_of = library.cloud(selection.of_room(scans, place))
    levels = segmentation.floor_and_ceiling(points)
    shape = contour.room_shape(points, levels, seed, stations, station_of, doors, others, previous)
    _keep_ceiling(library, room_id, cycle, points, shape)
    return shape


def build_map(
    library: Library,
    scan_id: str,
    pose: Sequence[Sequence[float]],
    shape: RoomShape,
    doors: Sequence[Door],
    previous: str | None,
    track: Sequence[tuple[float, float, float]],
    room_id: str,
    cycle: int,
    fence: Polygon | None = None,
) -> MapSummary:
    map_from_scanner = matrix(pose)
    scan = library.scan(scan_id)
    station = map_from_scanner[:3, 3]
    points = robot_map.below(scan.points, map_from_scanner, shape.floor_z + robot_map.ROBOT_HEIGHT)
    points = points[sightlines.believable(points, station, shape.contour, doors, shape.floor_z)]
    partial = robot_map.partial_map(points, station, azimuth_step=2 * scan.pattern.azimuth_step)
    evidence = robot_map.couple(_load_evidence(library, previous), partial.evidence)
    grid = robot_map.mark_free(evidence.to_grid(), track, _HALF_WIDTH)
    grid = robot_map.mark_free(grid, track[-1:], _HALF_WIDTH, over_obstacles=True)
    if fence is not None:
        grid = robot_map.fenced(grid, fence)
    map_id = f"robot_map_{scan_id}"
    save_grid(library.run.map_file(map_id), grid)
    write_arrays(library.run.map_evidence_file(map_id), **vars(evidence))
    flat = partial.flatness.cells
    write_arrays(
        library.run.evidence_file(room_id, cycle, "flatness"),
        data=flat.data,
        origin=flat.origin,
        resolution=flat.resolution,
        angle=partial.flatness.angle.data,
        gradient=partial.flatness.gradient.data,
    )
    area = grid.resolution**2
    free, obstacles = (int(np.count_nonzero(grid.data == state)) for state in (Cell.FREE, Cell.OBSTACLE))
    return MapSummary(map_id, free * area, obstacles * area)


def find_doors(library: Library, room_id: str, shape: RoomShape, scans: PlacedScans) -> DoorFindings:
    return door_finding.find_doors(shape, library.placed(scans))


def _load_evidence(library: Library, map_id: str | None) -> MapEvidence | None:
    if map_id is None:
        return None
    arrays = read_arrays(library.run.map_evidence_file(map_id))
    x, y = arrays.pop("origin")
    resolution = float(arrays.pop("resolution"))
    return MapEvidence(**arrays, origin=(float(x), float(y)), resolution=resolution)


def _keep_ceiling(library: Library, room_id: str, cycle: int, points: np.ndarray, shape: RoomShape) -> None:
    """The image of Fig. 2c for the report: ceiling points from above, and H."""
    high = points[np.abs(points[:, 2] - shape.ceiling_z) < 0.10, :2]
    low = shape.contour.min(axis=0) - 1.0
    columns, rows = np.ceil((shape.contour.max(axis=0) + 1.0 - low) / _IMAGE_CELL).astype(int)
    cells = np.floor((high - low) / _IMAGE_CELL).astype(int)
    cells = cells[np.all((cells >= 0) & (cells < (columns, rows)), axis=1)]
    image = np.zeros((rows, columns), np.uint8)
    image[cells[:, 1], cells[:, 0]] = 1
    path = library.run.evidence_file(room_id, cycle, "ceiling")
    write_arrays(path, data=image, origin=low, resolution=_IMAGE_CELL, contour=shape.contour)
