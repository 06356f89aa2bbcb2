"""One look for all pictures: a metric canvas without frame or ticks, a scale bar, and colours that print."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mission.store import whole_file
from perception.grids import Grid

INK, MUTED, PAPER = "#1f2933", "#7b8794", "#ffffff"
ACCENT, GOOD, WARN, BAD = "#0b6e99", "#2f855a", "#b7791f", "#c53030"
TINTS = ("#dcebf3", "#e7f0dd", "#f6e8d5", "#efe0ec", "#e0e7f7", "#f3ecd0", "#dff0ea", "#f4dfdc")
SCANS = (
    "#0b6e99", "#d1495b", "#2f855a", "#e08e45", "#6b4fa0", "#00838f", "#a0522d", "#c2378b",
    "#7a9e1f", "#34558b", "#b8860b", "#5c6b73",
)  # fmt: skip


@contextmanager
def canvas(
    path: Path, extent: tuple[float, float, float, float], width: float = 9.0, ground: str = PAPER
) -> Iterator[Any]:
    """Axes in metres over ``(x0, y0, x1, y1)``, saved to ``path`` (by its suffix) when the block ends.

    Args:
        width: of the picture in inches; the height follows from the extent, within reason.
        ground: colour of what is not drawn.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    x0, y0, x1, y1 = extent
    height = float(np.clip(width * (y1 - y0) / max(x1 - x0, 0.1), 2.0, 10.0))
    figure = Figure(figsize=(width, height), facecolor=ground)
    FigureCanvasAgg(figure)
    axes = figure.add_axes((0, 0, 1, 1))
    axes.set_axis_off()
    axes.set_aspect("equal")
    axes.set_xlim(x0, x1)
    axes.set_ylim(y0, y1)
    yield axes
    _scale_bar(axes, extent)
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as partial:
        figure.savefig(partial, dpi=130)


def extent_of(points: NDArray[np.floating], margin: float = 0.8) -> tuple[float, float, float, float]:
    """Bounds of positions ``(N, 2+)`` with a margin; a unit square where there are none."""
    if not len(points):
        return 0.0, 0.0, 1.0, 1.0
    low, high = points[:, :2].min(axis=0) - margin, points[:, :2].max(axis=0) + margin
    return float(low[0]), float(low[1]), float(high[0]), float(high[1])


def grid_extent(grid: Grid) -> tuple[float, float, float, float]:
    """Bounds (x0, y0, x1, y1) of a grid, metres."""
    rows, columns = grid.shape
    x, y = grid.origin
    return x, y, x + columns * grid.resolution, y + rows * grid.resolution


def with_margins(extent: tuple[float, float, float, float], share: float = 0.09) -> tuple[float, float, float, float]:
    """The extent with room above for a key and below for the scale bar."""
    x0, y0, x1, y1 = extent
    more = share * max(y1 - y0, 0.6 * (x1 - x0))
    return x0, y0 - more, x1, y1 + more


def crop(grid: Grid, wanted: NDArray[np.bool_], margin: float = 0.5) -> Grid:
    """The part of a grid around the wanted cells; the whole grid where none is."""
    rows, columns = np.flatnonzero(wanted.any(axis=1)), np.flatnonzero(wanted.any(axis=0))
    if not len(rows):
        return grid
    pad = int(np.ceil(margin / grid.resolution))
    r0, r1 = max(0, rows[0] - pad), min(grid.shape[0], rows[-1] + pad + 1)
    c0, c1 = max(0, columns[0] - pad), min(grid.shape[1], columns[-1] + pad + 1)
    origin = (grid.origin[0] + c0 * grid.resolution, grid.origin[1] + r0 * grid.resolution)
    return Grid(grid.data[r0:r1, c0:c1], origin, grid.resolution)


def draw_grid(axes: Any, grid: Grid, colours: NDArray[np.float64]) -> None:
    """Draw cells by a table of colours ``(values, 3)`` in [0, 1], indexed by the cell's value."""
    x0, y0, x1, y1 = grid_extent(grid)
    index = np.clip(grid.data.astype(int), 0, len(colours) - 1)
    axes.imshow(colours[index], origin="lower", extent=(x0, x1, y0, y1), interpolation="nearest", zorder=1)


def rgb(*names: str) -> NDArray[np.float64]:
    """Hexadecimal colours as ``(N, 3)`` in [0, 1]."""
    return np.array([[int(name[i : i + 2], 16) / 255 for i in (1, 3, 5)] for name in names])


def legend(axes: Any, entries: list[tuple[str, str]]) -> None:
    """A quiet key of (colour, words) at the upper left."""
    from matplotlib.patches import Patch

    handles = [Patch(facecolor=colour, edgecolor=MUTED, linewidth=0.4, label=words) for colour, words in entries]
    key = axes.legend(
        handles=handles, loc="upper left", framealpha=0.9, edgecolor="none", fontsize=8, ncols=len(entries)
    )
    key.set_zorder(20)


def _scale_bar(axes: Any, extent: tuple[float, float, float, float]) -> None:
    x0, y0, x1, y1 = extent
    length = max(step for step in (0.5, 1, 2, 5, 10, 20, 50) if step <= max(0.5, (x1 - x0) / 4))
    x, y = x1 - length - 0.02 * (x1 - x0), y0 + 0.03 * (y1 - y0)
    axes.plot([x, x + length], [y, y], color=INK, linewidth=2.2, solid_capstyle="butt", zorder=20)
    axes.annotate(
        f"{length:g} m", (x + length / 2, y), (0, 4), textcoords="offset points", ha="center", fontsize=8, color=INK,
        zorder=20, bbox={"facecolor": PAPER, "edgecolor": "none", "alpha": 0.7, "pad": 0.6},
    )  # fmt: skip
