"""The pictures of a run, drawn from its folder into ``pictures/``; what the run lacks is not drawn."""

import logging
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mission.report.canvas import (
    ACCENT,
    BAD,
    GOOD,
    INK,
    MUTED,
    PAPER,
    SCANS,
    TINTS,
    canvas,
    crop,
    draw_grid,
    extent_of,
    grid_extent,
    legend,
    rgb,
    with_margins,
)
from mission.report.run import Record, Run, grid_of
from perception import transforms
from perception.failure import FailureError
from perception.grids import Cell, Grid, Label
from perception.scan import Scan

KINDS = ("plan", "robot_map", "cloud", "view", "ceiling", "flatness")

_UNKNOWN, _FLAT = "#dfe4e9", "#bfe0cd"

_CLOUD_CELL = 0.02
"""Cell of the top view, metres."""
_COUNTED, _ESTIMATED = 2.6, 1.2
"""Dots of candidates whose gain was counted, and of those for which a part of the voxels spoke, points across."""


@dataclass(frozen=True)
class Picture:
    """A picture of the report: its file, what it shows, and the room and cycle it belongs to, if any."""

    path: Path
    title: str
    kind: str
    room: str = ""
    cycle: str = ""


def draw_all(run: Run) -> list[Picture]:
    """Draw every picture the run has data for; a damaged file costs its own picture only."""
    steps: tuple[Callable[[Run], list[Picture]], ...] = (_plan, _robot_map, _cloud, _views, _ceilings, _flatness)
    drawn: list[Picture] = []
    for step in steps:
        try:
            drawn += step(run)
        except FailureError as error:
            logging.getLogger("mission.report").warning("a picture is left out: %s", error)
    return drawn


def _target(run: Run, name: str) -> Path:
    return run.folder / "pictures" / f"{name}.png"


# --- the building ---------------------------------------------------------------------------------------------------


def _plan(run: Run) -> list[Picture]:
    contours = [np.asarray(room["contour"], float) for room in run.rooms if room.get("contour")]
    stations = _stations(run)
    if not contours and not len(stations):
        return []
    path = _target(run, "plan")
    with canvas(path, extent_of(np.concatenate([*contours, stations]))) as axes:
        for number, room in enumerate(run.rooms):
            _draw_room(axes, room, TINTS[number % len(TINTS)], stations)
        for door in run.doors:
            _draw_door(axes, door)
        _draw_route(axes, run, stations)
        legend(axes, [(GOOD, "door passed"), (BAD, "door not passed"), (ACCENT, "station and way")])
    return [Picture(path, "Rooms, doors and stations in the order in which they were taken", "plan")]


def _stations(run: Run) -> NDArray[np.float64]:
    """Position (x, y) of each scan, ``(N, 2)``."""
    return np.array([np.asarray(scan["map_from_scanner"], float)[:2, 3] for scan in run.scans]).reshape(-1, 2)


def _surveyed(run: Run, room_id: str | None = None) -> tuple[float, float, float, float] | None:
    """Bounds of one room or of all, with a margin: what beams met far outside through windows is not of interest."""
    contours = [
        np.asarray(room["contour"], float)
        for room in run.rooms
        if room.get("contour") and room_id in (None, room["id"])
    ]
    return extent_of(np.concatenate(contours), 1.0) if contours else None


def _draw_room(axes: Any, room: Record, tint: str, stations: NDArray[np.float64]) -> None:
    contour = np.asarray(room.get("contour") or np.zeros((0, 2)), float)
    if len(contour) < 3:
        return
    complete = room.get("status") == "complete"
    axes.fill(*contour.T, facecolor=tint, edgecolor=INK, linewidth=1.6, zorder=2)
    if not complete:
        axes.fill(*contour.T, facecolor="none", edgecolor=MUTED, linewidth=0, hatch="//", alpha=0.6, zorder=2)
    name = room.get("name") or room["id"]
    x, y = _name_place(contour, stations)
    axes.text(x, y, name, ha="center", va="center", fontsize=11, color=INK, zorder=6, alpha=0.75, weight="bold")


def _name_place(contour: NDArray[np.float64], taken: NDArray[np.float64]) -> tuple[float, float]:
    """Where a room's name stands: inside, away from the walls and from the stations."""
    import shapely

    polygon = shapely.Polygon(contour).buffer(0)
    low, high = contour.min(axis=0), contour.max(axis=0)
    x, y = (axis.ravel() for axis in np.meshgrid(*np.linspace(low, high, 25).T))
    free = shapely.distance(polygon.boundary, shapely.points(x, y))
    free[~shapely.contains_xy(polygon, x, y)] = -1.0
    for station in taken:
        free = np.minimum(free, np.hypot(x - station[0], y - station[1]))
    best = int(np.argmax(free))
    return float(x[best]), float(y[best])


def _draw_door(axes: Any, door: Record) -> None:
    normal = np.asarray(door.get("normal") or (1.0, 0.0), float)
    middle = np.array([door["x"], door["y"]], float)
    half = np.array([-normal[1], normal[0]]) * float(door.get("net_width") or door.get("width") or 0.9) / 2
    passed = sum(room is not None for room in door.get("rooms") or ()) == 2
    ends = np.stack([middle - half, middle + half])
    axes.plot(*ends.T, color=PAPER, linewidth=6, solid_capstyle="butt", zorder=3)
    axes.plot(*ends.T, color=GOOD if passed else BAD, linewidth=3, solid_capstyle="butt", zorder=4)


def _draw_route(axes: Any, run: Run, stations: NDArray[np.float64]) -> None:
    """The way that was driven, stations by number, and goals that were not reached."""
    track = np.asarray(run.state.get("track") or stations, float).reshape(len(run.state.get("track") or stations), -1)
    if len(track) > 1:
        axes.plot(*track[:, :2].T, color=ACCENT, linewidth=1.0, alpha=0.55, zorder=5)
    for event in run.events_of("drive"):
        if event.get("x") is not None and event.get("result") != "arrived":
            axes.plot(event["x"], event["y"], marker="x", color=BAD, markersize=6, zorder=7)
    for number, (x, y) in enumerate(stations, 1):
        axes.plot(x, y, "o", markersize=13, color=ACCENT, markeredgecolor=PAPER, markeredgewidth=1.2, zorder=8)
        axes.annotate(
            str(number), (x, y), (0, -0.5), textcoords="offset points", ha="center", va="center",
            fontsize=7.5, color=PAPER, weight="bold", zorder=9,
        )  # fmt: skip


def _robot_map(run: Run) -> list[Picture]:
    pattern = f"{run.state['map_id']}.npz" if run.state.get("map_id") else "robot_map_*[0-9].npz"
    found = run.arrays(f"maps/{pattern}")
    grid = grid_of(found[-1][1]) if found else None
    if grid is None:
        return []
    path = _target(run, "robot_map")
    with canvas(path, with_margins(_surveyed(run) or grid_extent(grid)), ground=_UNKNOWN) as axes:
        draw_grid(axes, grid, rgb(PAPER, INK, _UNKNOWN))
        _draw_route(axes, run, _stations(run))
        legend(axes, [(PAPER, "free"), (INK, "obstacle"), (_UNKNOWN, "unknown")])
    return [Picture(path, "The robot map M(t) at the end", "robot_map")]


# --- the cloud ------------------------------------------------------------------------------------------------------


def _cloud(run: Run) -> list[Picture]:
    layers = [_top_view_points(run, record, pose, scan) for record, pose, scan in run.clouds()]
    everything = np.concatenate([np.zeros((0, 2), np.float32), *layers])
    if not len(everything):
        return []
    bounds = _surveyed(run) or tuple(np.percentile(everything, [0.2, 99.8], axis=0).ravel())
    low, high = np.array(bounds[:2]), np.array(bounds[2:])
    image = _blend(layers, low, high)
    path = _target(run, "cloud_top")
    with canvas(path, with_margins((low[0], low[1], high[0], high[1]), 0.04)) as axes:
        axes.imshow(image, origin="lower", extent=(low[0], high[0], low[1], high[1]), interpolation="antialiased")
        for number, (x, y) in enumerate(_stations(run)):
            axes.plot(x, y, "o", markersize=7, color=SCANS[number % len(SCANS)], markeredgecolor=INK, zorder=5)
    return [Picture(path, "The cloud P(t) from above without floor and ceiling, one colour a scan", "cloud")]


def _top_view_points(run: Run, record: Record, pose: NDArray[np.float64], scan: Scan) -> NDArray[np.float32]:
    """Positions ``(N, 2)`` of the points between floor and ceiling of the scan's room."""
    points = transforms.apply(pose, scan.points)
    room = next((room for room in run.rooms if room["id"] == record.get("room_id")), {})
    floor = float(room.get("floor_z") or 0.0)
    ceiling = float(room.get("ceiling_z") or floor + 2.6)
    return points[(points[:, 2] > floor + 0.15) & (points[:, 2] < ceiling - 0.25), :2]


def _blend(layers: list[NDArray[np.float32]], low: NDArray, high: NDArray) -> NDArray[np.float64]:
    """Top view ``(rows, columns, 3)``: colours of the scans mixed by their points, darker where there are more."""
    cell = max(_CLOUD_CELL, float((high - low).max()) / 2500)
    columns, rows = (int(n) for n in np.ceil((high - low) / cell))
    total, mixed = np.zeros((rows, columns)), np.zeros((rows, columns, 3))
    for number, points in enumerate(layers):
        place = np.floor((points - low) / cell).astype(int)
        inside = np.all((place >= 0) & (place < (columns, rows)), axis=1)
        count = np.bincount(place[inside, 1] * columns + place[inside, 0], minlength=rows * columns)
        weight = np.log1p(count.reshape(rows, columns))
        total += weight
        mixed += weight[..., None] * rgb(SCANS[number % len(SCANS)])[0]
    colour = mixed / np.maximum(total, 1e-9)[..., None]
    ink = np.clip(total / max(1e-9, float(np.percentile(total[total > 0], 97))), 0, 1)[..., None] ** 0.6
    result: NDArray[np.float64] = 1 - ink * (1 - colour)
    return result


# --- room by room ---------------------------------------------------------------------------------------------------


def _place_of(path: Path) -> tuple[str, str]:
    """Room and cycle from a name such as ``R01_3_view.npz``."""
    match = re.match(r"(?P<room>.+?)_(?P<cycle>\d+)_\w+$", path.stem)
    return (match["room"], match["cycle"]) if match else (path.stem, "")


def _views(run: Run) -> list[Picture]:
    pictures = []
    for source, arrays in run.arrays("evidence/*_view.npz"):
        grid = grid_of(arrays)
        if grid is None:
            continue
        room, cycle = _place_of(source)
        path = _target(run, source.stem)
        _draw_view(path, crop(grid, grid.data != Label.OUTSIDE), arrays)
        pictures.append(Picture(path, f"{run.room_names.get(room, room)}, cycle {cycle}", "view", room, cycle))
    return pictures


def _draw_view(path: Path, grid: Grid, arrays: dict[str, NDArray]) -> None:
    candidates = arrays.get("candidates", np.zeros((0, 4)))
    with canvas(path, with_margins(grid_extent(grid)), width=6.0) as axes:
        draw_grid(axes, grid, rgb("#eef1f4", PAPER, "#f3c98b", "#3e4c59"))
        if candidates.size:
            x, y, gain, counted = candidates.T
            size = np.where(counted, _COUNTED, _ESTIMATED) ** 2
            dots = axes.scatter(x, y, c=gain, s=size, cmap="viridis", linewidths=0, zorder=4)
            _gain_bar(axes, dots, int(candidates[:, 2].max()))
        if arrays.get("best", np.zeros(0)).size:
            x, y = arrays["best"][0, :2]
            axes.plot(x, y, marker="*", markersize=17, color=BAD, markeredgecolor=PAPER, zorder=6)
        if "station" in arrays:
            x, y = arrays["station"][:2]
            axes.plot(x, y, "o", color=ACCENT, markersize=9, markeredgecolor=PAPER, zorder=6)
        legend(axes, [(PAPER, "empty"), ("#f3c98b", "occluded"), ("#3e4c59", "occupied")])


def _gain_bar(axes: Any, dots: Any, most: int) -> None:
    """A key of the gains at the lower left, below the map."""
    bar = axes.figure.colorbar(dots, cax=axes.inset_axes((0.02, 0.015, 0.3, 0.02), zorder=20), orientation="horizontal")
    bar.set_ticks([])
    bar.outline.set_visible(False)
    bar.ax.set_title(f"voxels gained, up to {most:,}", fontsize=7, color=INK, pad=3)


def _ceilings(run: Run) -> list[Picture]:
    pictures = []
    for source, arrays in _latest_by_room(run.arrays("evidence/*_ceiling.npz")):
        grid = grid_of(arrays)
        if grid is None:
            continue
        room, cycle = _place_of(source)
        path = _target(run, f"{room}_ceiling")
        contour = np.asarray(arrays.get("contour", np.zeros((0, 2))), float)
        with canvas(path, grid_extent(grid), width=6.0) as axes:
            draw_grid(axes, grid.with_data(grid.data > 0), rgb(PAPER, "#9fb3c8"))
            if len(contour):
                axes.plot(*np.vstack([contour, contour[:1]]).T, color=BAD, linewidth=2, zorder=4)
        title = f"{run.room_names.get(room, room)}: ceiling and contour H"
        pictures.append(Picture(path, title, "ceiling", room, cycle))
    return pictures


def _flatness(run: Run) -> list[Picture]:
    by_room: dict[str, list[Grid]] = {}
    for source, arrays in run.arrays("evidence/*_flatness.npz"):
        if (grid := grid_of(arrays)) is not None:
            by_room.setdefault(_place_of(source)[0], []).append(grid)
    pictures = []
    for room, grids in by_room.items():
        fused = _fused(grids)
        extent = _surveyed(run, room) or grid_extent(fused)
        path = _target(run, f"{room}_flatness")
        with canvas(path, with_margins(extent), width=6.0, ground=_UNKNOWN) as axes:
            draw_grid(axes, fused, rgb(_FLAT, BAD, _UNKNOWN))
            legend(axes, [(_FLAT, "flat"), (BAD, "not flat"), (_UNKNOWN, "unknown")])
        pictures.append(Picture(path, f"{run.room_names.get(room, room)}: flatness map F(t)", "flatness", room))
    return pictures


def _fused(grids: list[Grid]) -> Grid:
    """All maps of one resolution as one: an irregular cell of any scan stays, a flat one fills the unknown."""
    cell = grids[0].resolution
    low = np.min([grid.origin for grid in grids], axis=0)
    high = np.max([grid_extent(grid)[2:] for grid in grids], axis=0)
    columns, rows = (int(n) for n in np.ceil((high - low) / cell - 1e-6))
    fused = Grid(np.full((rows, columns), Cell.UNKNOWN, np.uint8), (float(low[0]), float(low[1])), cell)
    for state in (Cell.FREE, Cell.OBSTACLE):
        for grid in grids:
            cells = fused.cells_of(grid.centres_of(np.argwhere(grid.data == state)))
            fused.data[tuple(np.minimum(cells, np.array(fused.shape) - 1).T)] = state
    return fused


def _latest_by_room(found: list[tuple[Path, dict[str, NDArray]]]) -> list[tuple[Path, dict[str, NDArray]]]:
    return list({_place_of(path)[0]: (path, arrays) for path, arrays in found}.values())
