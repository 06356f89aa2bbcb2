"""The labelled map and the positions where the next scan may be taken (paper section 4.2, three requirements)."""

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from perception.grids import Cell, Grid, Label, VoxelSpace
from perception.sensor import Sensor

Rule = Literal["graded", "paper"]
Pose = tuple[float, float, float]
Mask = NDArray[np.bool_]

FLOOR_CLEARANCE = 0.03
"""A layer whose lower face is not this far above the floor holds floor points: tilt and noise, metres."""


SWALLOWED = 3
"""Unseen voxels above the blind cone that make a pixel within the minimum range of a station an obstacle."""


@dataclass(frozen=True)
class Robot:
    """How much room the robot needs, metres.

    Args:
        footprint: length and width.
        security_goal: distance from a position for a scan to any obstacle; the robot must be able to turn there.
        security_path: the same for the way to it.
    """

    footprint: tuple[float, float] = (0.9, 0.6)
    security_goal: float = 0.55
    security_path: float = 0.35


@dataclass(frozen=True)
class CandidateField:
    """Where the next scan may be taken.

    Args:
        mask: bool :class:`Grid`, pixels of the voxel space that meet the three requirements.
        path_length: metres from the current position along pixels that may be driven, inf where there is no way.
    """

    mask: Grid
    path_length: Grid


def labelled_map(space: VoxelSpace, scanner_height: float, floor_z: float) -> Grid:
    """Top projection of the labels below the scanner: occupied before occluded before empty.

    Layers of the floor are left out, as they would veto every pixel; the ceiling is above the scanner.

    Args:
        scanner_height: of the optical centre above the floor, metres.
        floor_z: of the floor in the map frame, metres.
    """
    body = _body_layers(space, scanner_height, floor_z)
    # Labels grow with their priority.
    return _grid(space, space.labels[:, :, body].max(axis=2).T)


def candidates(
    space: VoxelSpace,
    pose: Pose,
    sensor: Sensor,
    floor_z: float,
    *,
    rule: Rule = "graded",
    stations: ArrayLike = (),
    driven: ArrayLike = (),
    robot_map: Grid | None = None,
    robot: Robot = Robot(),
) -> CandidateField:
    """The pixels that meet the label, security and path requirements.

    Label requirement, ``paper``: the pixel is empty. ``graded``: nothing in it is occupied, most of its voxels are
    known to be empty, and the floor was seen in it or beside it. Under both, what lies in the blind cone of a
    station counts as empty where the rest of the pixel was seen, and the robot's footprint at ``pose`` and along
    ``driven`` is free whatever the labels say: otherwise nothing around the robot is legal and no path starts. What
    stays unseen within the minimum range of a station, above its cone, is an obstacle: it let no beam through.

    Args:
        pose: (x, y, yaw) of the robot now, map frame; may lie in a doorway just outside the space.
        stations: ``(S, 2)`` or wider: x, y of the scans behind the labels; the current position is always one.
        driven: ``(K, 3)`` poses x, y, yaw the robot has driven over.
        robot_map: :class:`Cell` grid of any resolution; its obstacles are obstacles here.
    """
    poses = np.vstack([np.asarray(driven, float).reshape(-1, 3), np.asarray(pose, float)])
    places = np.vstack([_planar(stations), poses[-1:, :2]])
    pad = _padding(space, poses[-1, :2])
    labels = np.pad(space.labels, (pad[0], pad[1], (0, 0)))  # OUTSIDE
    corner = (space.origin[0] - pad[0][0] * space.size, space.origin[1] - pad[1][0] * space.size)
    room = labels.max(axis=2).T != Label.OUTSIDE
    frame = Grid(room, corner, space.size)
    seed = _footprints(frame, poses, robot.footprint)
    free, occupied = _columns(labels, space, frame, sensor, floor_z, places, rule)
    if robot_map is not None:
        occupied |= _obstacles_on(frame, robot_map)
    # Outside the contour is a wall, seen or not (it may be glass), but not around the doorway the robot stands in.
    wall = ~room & (_distance(seed, frame) > robot.security_goal)
    clearance = _distance((occupied | wall) & ~seed, frame)
    passable = (free & (clearance >= robot.security_path)) | seed
    length = _path_lengths(passable, tuple(frame.cells_of(poses[-1])), frame.resolution)
    mask = room & (free | seed) & (clearance >= robot.security_goal) & np.isfinite(length)
    inner = (slice(pad[1][0], mask.shape[0] - pad[1][1]), slice(pad[0][0], mask.shape[1] - pad[0][1]))
    return CandidateField(_grid(space, mask[inner]), _grid(space, length[inner]))


def _grid(space: VoxelSpace, data: NDArray) -> Grid:
    return Grid(np.ascontiguousarray(data), space.origin[:2], space.size)


def _planar(places: ArrayLike) -> NDArray[np.float64]:
    array = np.asarray(places, np.float64)
    return array[:, :2] if array.size else np.empty((0, 2))


def _layer_floors(space: VoxelSpace, floor_z: float) -> NDArray[np.float64]:
    """Height of each layer's lower face above the floor, metres."""
    return np.arange(space.labels.shape[2], dtype=np.float64) * space.size + (space.origin[2] - floor_z)


def _body_layers(space: VoxelSpace, scanner_height: float, floor_z: float) -> Mask:
    """The layers between the floor and the scanner."""
    height = _layer_floors(space, floor_z)
    return (height >= FLOOR_CLEARANCE) & (height < scanner_height)


def _padding(space: VoxelSpace, position: NDArray[np.float64]) -> tuple[tuple[int, int], tuple[int, int]]:
    """Pixels to add (before, after) along x and y so that the robot and its surroundings are on the grid."""
    surroundings = 1.0
    nx, ny, _ = space.labels.shape
    low = np.floor((position - surroundings - space.origin[:2]) / space.size).astype(int)
    high = np.ceil((position + surroundings - space.origin[:2]) / space.size).astype(int)
    before, after = np.maximum(-low, 1), np.maximum(high - (nx, ny), 1)
    return (int(before[0]), int(after[0])), (int(before[1]), int(after[1]))


def _columns(
    labels: NDArray[np.uint8],
    space: VoxelSpace,
    frame: Grid,
    sensor: Sensor,
    floor_z: float,
    stations: NDArray[np.float64],
    rule: Rule,
) -> tuple[Mask, Mask]:
    """Pixels that meet the label requirement, and pixels with something occupied, ``[row, column]``."""
    heights = _layer_floors(space, floor_z)
    body = _body_layers(space, sensor.height, floor_z)
    away = _distance_to(frame, stations).T
    column = labels[:, :, body]
    in_cone = away[:, :, None] < np.array([sensor.blind_radius(h) for h in heights[body]])
    column = np.where(in_cone & (column == Label.OCCLUDED), np.uint8(Label.EMPTY), column)
    unseen = np.count_nonzero(column == Label.OCCLUDED, axis=2)
    # Beams that should have gone through here from so near met something nearer than the scanner can measure.
    swallowed = (away < sensor.range_min) & (unseen >= SWALLOWED)
    occupied = np.any(column == Label.OCCUPIED, axis=2) | swallowed
    seen = column.max(axis=2) == Label.EMPTY
    if rule == "graded":
        beside_station = away < sensor.blind_radius(0.0)
        mostly_seen = np.count_nonzero(column == Label.EMPTY, axis=2) > unseen
        seen |= mostly_seen & ~occupied & ~beside_station
        floor = np.any(labels[:, :, heights < FLOOR_CLEARANCE] == Label.OCCUPIED, axis=2).astype(np.uint8)
        seen &= beside_station | (cv2.dilate(floor, np.ones((3, 3), np.uint8)) > 0)
    return seen.T, occupied.T


def _distance_to(frame: Grid, places: NDArray[np.float64]) -> NDArray[np.float64]:
    """Distance from each pixel to the nearest of the places, metres."""
    x, y = np.moveaxis(frame.centres_of(np.moveaxis(np.indices(frame.shape), 0, -1)), -1, 0)
    return np.min([np.hypot(x - px, y - py) for px, py in places], axis=0)


def _footprints(frame: Grid, poses: NDArray[np.float64], footprint: tuple[float, float]) -> Mask:
    """Pixels that the robot covers at any of the poses."""
    corners = 0.5 * np.array([[1, 1], [-1, 1], [-1, -1], [1, -1]]) * footprint
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    rotation = np.stack([np.stack([cos, sin], -1), np.stack([-sin, cos], -1)], axis=1)
    outline = (corners @ rotation + poses[:, None, :2] - frame.origin) / frame.resolution - 0.5
    mask = np.zeros(frame.shape, np.uint8)
    fraction_bits = 4
    for polygon in np.rint(outline * 2**fraction_bits).astype(np.int32):
        cv2.fillConvexPoly(mask, polygon, 1, shift=fraction_bits)
    return mask.astype(bool)


def _obstacles_on(frame: Grid, robot_map: Grid) -> Mask:
    """The obstacles of another grid on the pixels of this one."""
    cells = frame.cells_of(robot_map.centres_of(np.argwhere(robot_map.data == Cell.OBSTACLE)))
    cells = cells[frame.contains(cells)]
    mask = np.zeros(frame.shape, bool)
    mask[tuple(cells.T)] = True
    return mask


def _distance(mask: Mask, frame: Grid) -> NDArray[np.float32]:
    """Distance from each pixel's centre to the centre of the nearest pixel of the mask, metres; inf if it is empty."""
    if not mask.any():
        return np.full(mask.shape, np.inf, np.float32)
    return cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_PRECISE) * frame.resolution


def _path_lengths(passable: Mask, start: tuple[int, ...], resolution: float) -> NDArray[np.float64]:
    """Shortest way over passable pixels and their 8 neighbours from the start to each pixel, metres."""
    index = np.full(passable.shape, -1)
    index[passable] = np.arange(np.count_nonzero(passable))
    rows, columns = passable.shape
    edges = []
    for dr, dc in ((0, 1), (1, 0), (1, 1), (1, -1)):
        here = index[: rows - dr, max(0, -dc) : columns - max(0, dc)]
        there = index[dr:, max(0, dc) : columns + min(0, dc)]
        both = (here >= 0) & (there >= 0)
        edges.append((here[both], there[both], np.full(np.count_nonzero(both), np.hypot(dr, dc) * resolution)))
    tail, head, length = (np.concatenate(part) for part in zip(*edges, strict=True))
    graph = coo_array((length, (tail, head)), shape=(index.max() + 1,) * 2).tocsr()
    result = np.full(passable.shape, np.inf)
    result[passable] = dijkstra(graph, directed=False, indices=index[start])
    return result
