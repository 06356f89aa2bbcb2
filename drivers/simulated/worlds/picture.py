"""A top view of a world to look at: walls, furniture, doors, rooms and the start."""

from pathlib import Path

import numpy as np

from drivers.simulated.world import DoorState, Surface, World
from drivers.simulated.worlds.free_space import flood

_COLOURS = {
    Surface.OTHER: "#cfcfcf",
    Surface.FURNITURE: "#c9a227",
    Surface.WALL: "#222222",
    Surface.GLASS: "#2aa7df",
    Surface.DOOR_LEAF: "#b5482a",
    Surface.MIRROR: "#c026d3",
}
_STATES = {DoorState.OPEN: "#16a34a", DoorState.HALF: "#ea8a0c", DoorState.SHUT: "#dc2626"}


def draw_world(world: World, path: Path, margin: float = 3.0) -> None:
    """Write a PNG of the world from above, cut below the ceiling; what a robot can reach is shaded green."""
    from matplotlib.collections import PolyCollection
    from matplotlib.figure import Figure

    figure = Figure(figsize=(14, 10))
    axes = figure.add_subplot()
    region = flood(world)
    (x0, y0), (rows, columns) = region.origin, region.shape
    extent = (x0, x0 + columns * region.resolution, y0, y0 + rows * region.resolution)
    axes.imshow(np.where(region.data, 1.0, np.nan), origin="lower", extent=extent, cmap="Greens", vmin=0, vmax=4)
    for surface, colour in _COLOURS.items():
        corners = world.corners([surface])
        low = corners[corners[:, :, 2].min(axis=1) < 2.2][:, :, :2]
        axes.add_collection(PolyCollection(low, facecolors=colour, edgecolors=colour, linewidths=0.5, alpha=0.6))
    for room in world.truth.rooms:
        closed = np.vstack([room.polygon, room.polygon[:1]])
        axes.plot(closed[:, 0], closed[:, 1], color="#2563eb", linewidth=0.8)
        x, y = room.polygon.mean(axis=0)
        axes.text(x, y, f"{room.room_id}\n{room.area:.2f} m²", ha="center", va="center", fontsize=8)
    for door in world.truth.doors:
        axes.plot(door.x, door.y, "o", color=_STATES[door.state], markersize=5)
        axes.annotate(f"{door.width:.2f}/{door.net_width:.2f}", (door.x, door.y), fontsize=7)
    x, y, yaw = world.start
    axes.arrow(x, y, np.cos(yaw), np.sin(yaw), width=0.08, color="#16a34a")
    outlines = [room.polygon for room in world.truth.rooms]
    points = np.concatenate(outlines) if outlines else world.vertices[:, :2]
    axes.set_xlim(points[:, 0].min() - margin, points[:, 0].max() + margin)
    axes.set_ylim(points[:, 1].min() - margin, points[:, 1].max() + margin)
    axes.set_aspect("equal")
    axes.set_title(world.name)
    figure.savefig(path, dpi=80, bbox_inches="tight")
