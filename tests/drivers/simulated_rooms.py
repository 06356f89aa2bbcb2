"""Small worlds of boxes for the tests of the simulation, and the robot map that a perfect perception would draw."""

from collections.abc import Sequence

import numpy as np
import trimesh

from drivers.interfaces import DriveGoal
from drivers.jobs import Running
from drivers.simulated.base import SimulatedBase
from drivers.simulated.obstruction import Obstruction
from drivers.simulated.world import Surface, Truth, World
from perception import transforms
from perception.grids import Cell, Grid

Box = tuple[Sequence[float], Sequence[float], Surface]
HEIGHT = 3.0
MARGIN = 0.5


def world_of(boxes: Sequence[Box], start: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> World:
    """A world of closed axis-aligned boxes (lower corner, upper corner, class)."""
    parts = [(trimesh.creation.box(bounds=(lower, upper)), kind) for lower, upper, kind in boxes]
    mesh = trimesh.util.concatenate([part for part, _ in parts])
    surface = np.repeat([kind for _, kind in parts], [len(part.faces) for part, _ in parts]).astype(np.uint8)
    return World("boxes", mesh.vertices.astype(np.float32), mesh.faces.astype(np.int32), surface, start, Truth())


def shell(x0: float, y0: float, x1: float, y1: float) -> list[Box]:
    """Floor, ceiling and four walls of 0.2 m round a room."""
    return [
        ((x0, y0, -0.2), (x1, y1, 0.0), Surface.FLOOR),
        ((x0, y0, HEIGHT), (x1, y1, HEIGHT + 0.2), Surface.CEILING),
        ((x0 - 0.2, y0 - 0.2, -0.2), (x0, y1 + 0.2, HEIGHT), Surface.WALL),
        ((x1, y0 - 0.2, -0.2), (x1 + 0.2, y1 + 0.2, HEIGHT), Surface.WALL),
        ((x0, y0 - 0.2, -0.2), (x1, y0, HEIGHT), Surface.WALL),
        ((x0, y1, -0.2), (x1, y1 + 0.2, HEIGHT), Surface.WALL),
    ]


def two_rooms(door: float = 0.9, start: tuple[float, float, float] = (1.5, 1.5, 0.0)) -> World:
    """Two rooms of 4 x 4 m, side by side along x, with a door ``door`` metres wide at (4.1, 2.0), and a table."""
    left, right = 2.0 - door / 2, 2.0 + door / 2
    return world_of(
        [
            *shell(0.0, 0.0, 8.2, 4.0),
            ((4.0, 0.0, 0.0), (4.2, left, HEIGHT), Surface.WALL),
            ((4.0, right, 0.0), (4.2, 4.0, HEIGHT), Surface.WALL),
            ((4.0, left, 2.1), (4.2, right, HEIGHT), Surface.WALL),
            ((6.0, 0.6, 0.0), (6.8, 1.2, 0.75), Surface.FURNITURE),
        ],
        start,
    )


def perfect_map(world: World, resolution: float = 0.05) -> Grid:
    """Obstacles wherever the robot's height is not clear, free elsewhere."""
    obstruction = Obstruction(world, (0.9, 0.6))
    fine = 5
    # The odd pad shifts the cells against the walls, as no real wall lies on a cell's edge.
    raster = np.pad(obstruction.raster, int(MARGIN * 100) + 2)
    raster = raster[: raster.shape[0] // fine * fine, : raster.shape[1] // fine * fine]
    blocks = raster.reshape(raster.shape[0] // fine, fine, raster.shape[1] // fine, fine).max(axis=(1, 3))
    data = np.where(blocks, np.uint8(Cell.OBSTACLE), np.uint8(Cell.FREE))
    x, y = obstruction.origin - (int(MARGIN * 100) + 2) * 0.01
    return Grid(data, (float(x), float(y)), resolution)


def goal(
    robot_map: Grid,
    place: tuple[float, float, float | None],
    known: tuple[float, float, float] | None,
    name: str = "g1",
) -> DriveGoal:
    """An order to drive; ``known`` is where registration found the base."""
    pose = None if known is None else transforms.planar(*known)
    return DriveGoal(name, robot_map, "M1", pose, *place)


def run(base: SimulatedBase, seconds: float, until: str = "g1", dt: float = 0.05) -> float:
    """Advance until the goal has an outcome or the time is over; the simulated seconds that took."""
    for step in range(int(seconds / dt)):
        base.step(dt)
        if not isinstance(base.drive_status(until), Running):
            return (step + 1) * dt
    return seconds
