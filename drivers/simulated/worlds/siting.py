"""Where a mission can start in a building that nobody planned for robots, and how far its floor reaches."""

import cv2
import numpy as np
import shapely
from numpy.typing import NDArray

from drivers.simulated.world import Surface
from drivers.simulated.worlds.free_space import ROBOT_BAND, ROBOT_RADIUS, clearance, clearest, mask_of, occupancy_of
from perception.failure import FailureError
from perception.grids import Grid

RESOLUTION = 0.05
ON_FLOOR = (-0.06, 0.06)
MOSTLY_ROOFED = 0.5


def open_floor(corners: NDArray[np.floating], surface: NDArray[np.uint8], rooms: list[shapely.Polygon]) -> Grid:
    """Grid of bool: the largest connected floor where a robot's disc fits.

    Floor is what lies in one of the rooms; without any, what has a floor and, where most of it has one, a ceiling.

    Args:
        corners: ``(K, 3, 3)`` triangles, metres, floor at z = 0.
        surface: ``(K,)`` of :class:`Surface`.
        rooms: floor outlines where they are known.

    Raises:
        FailureError: ``WORLD_NO_FLOOR``.
    """
    # One frame for all: everything from the floor up marks the extent.
    whole = occupancy_of(corners, (-0.5, 10.0), RESOLUTION, 0.5)
    occupied = _marked(corners, ROBOT_BAND, whole)
    walkable = _inside(rooms, whole) if rooms else _floor_under_ceiling(corners, surface, whole)
    fits = (clearance(whole.with_data(occupied)).data >= ROBOT_RADIUS) & walkable
    _, labels, stats, _ = cv2.connectedComponentsWithStats(fits.astype(np.uint8), connectivity=4)
    if len(stats) < 2:
        raise FailureError("WORLD_NO_FLOOR", "there is no floor on which the robot could stand")
    return whole.with_data(labels == 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA])))


def start_on(region: Grid, start: tuple[float, ...] | None) -> tuple[float, float, float]:
    """The start asked for as (x, y) or (x, y, yaw), else the clearest place of the region."""
    if start is None:
        return (*clearest(region), 0.0)
    return start[0], start[1], start[2] if len(start) > 2 else 0.0


def outline_of(region: Grid, corners: NDArray[np.floating]) -> NDArray[np.float64]:
    """Outline ``(N, 2)`` of the floor around a region of robot positions, out to the walls, holes filled."""
    free = np.logical_not(_marked(corners, ROBOT_BAND, region)).astype(np.uint8)
    grown, around = region.data.astype(np.uint8), np.ones((3, 3), np.uint8)
    # Into the corners of the rooms, which are farther from the robot than its radius, but not through walls.
    for _ in range(round(1.5 * ROBOT_RADIUS / region.resolution)):
        grown = np.asarray(cv2.dilate(grown, around) * free, np.uint8)
    grown = np.asarray(cv2.dilate(grown, around), np.uint8)
    contours, _ = cv2.findContours(grown, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    longest = max(contours, key=cv2.contourArea)[:, 0, ::-1]
    polygon = shapely.Polygon(region.centres_of(longest)).buffer(region.resolution / 2, join_style="mitre")
    simple = shapely.orient_polygons(shapely.Polygon(polygon.exterior).simplify(region.resolution))
    return np.array(simple.exterior.coords[:-1])


def _marked(corners: NDArray[np.floating], band: tuple[float, float], frame: Grid) -> NDArray[np.bool_]:
    """What :func:`occupancy_of` finds between two heights, in the frame of another grid."""
    found = occupancy_of(corners, band, frame.resolution, 0.5)
    marked = np.zeros(frame.shape, bool)
    row, column = frame.cells_of(np.asarray(found.origin) + 0.5 * frame.resolution)
    rows, columns = found.shape
    marked[row : row + rows, column : column + columns] = found.data[: frame.shape[0] - row, : frame.shape[1] - column]
    return marked


def _inside(rooms: list[shapely.Polygon], frame: Grid) -> NDArray[np.bool_]:
    """Cells within the rooms and the doorways between them."""
    grown = shapely.union_all([room.buffer(0.4, join_style="mitre") for room in rooms])
    parts = grown.geoms if isinstance(grown, shapely.MultiPolygon) else [grown]
    return np.logical_or.reduce([mask_of(np.array(part.exterior.coords[:-1]), frame) for part in parts])


def _floor_under_ceiling(corners: NDArray[np.floating], surface: NDArray[np.uint8], frame: Grid) -> NDArray[np.bool_]:
    floor = _marked(corners[surface == Surface.FLOOR], ON_FLOOR, frame)
    ceilings = corners[(surface == Surface.CEILING) & (corners[:, :, 2].min(axis=1) > ROBOT_BAND[1])]
    if not len(ceilings):
        return floor
    roofed = floor & _marked(ceilings, (ROBOT_BAND[1], np.inf), frame)
    return roofed if roofed.sum() > MOSTLY_ROOFED * floor.sum() else floor
