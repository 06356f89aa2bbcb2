"""The columns over a room's pixels: which of their slices hold points (paper section 3.1, the ceiling image)."""

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from perception.grids import Grid
from perception.segmentation import Levels

Image = NDArray[np.bool_]

CELL = 0.05
"""Side of a pixel of the ceiling image, metres."""
SLICE = 0.10
"""Height of a slice, metres."""


@dataclass(frozen=True)
class Volume:
    """Which pixels of each 10 cm slice hold points: ``(slices, rows, columns)``, from the floor upwards."""

    slices: NDArray[np.bool_]
    origin: NDArray[np.float64]

    @property
    def shape(self) -> tuple[int, int]:
        return self.slices.shape[1], self.slices.shape[2]

    @property
    def frame(self) -> Grid:
        """The pixels as a grid."""
        return Grid(self.slices[0], (float(self.origin[0]), float(self.origin[1])), CELL)

    def band(self, low: float, high: float) -> NDArray[np.bool_]:
        """The slices that lie wholly between two heights over the floor; at least one."""
        first = int(np.ceil(low / SLICE - 1e-6))
        last = int(min(high / SLICE + 1e-6, len(self.slices)))
        return self.slices[first : max(last, first + 1)]

    def any(self, low: float, high: float) -> Image:
        """Pixels with a point between two heights over the floor."""
        return np.logical_or.reduce(self.band(low, high), axis=0)

    def pixels(self, xy: NDArray[np.floating]) -> NDArray[np.int64]:
        """(row, column) of map positions ``(N, 2)``."""
        return np.floor((xy - self.origin) / CELL).astype(np.int64)[:, ::-1]

    def inside(self, pixels: NDArray[np.int64]) -> NDArray[np.bool_]:
        return np.all((pixels >= 0) & (pixels < self.shape), axis=1)

    def corners(self, outline: NDArray[np.floating]) -> NDArray[np.float64]:
        """Map positions of pixel centres given as (column, row)."""
        return (outline + 0.5) * CELL + self.origin


def volume_of(points: NDArray[np.floating], levels: Levels) -> Volume:
    """The columns over and around points ``(N, 3)`` of the map frame, N > 0, up to the highest ceiling."""
    top = levels.ceilings[-1].high if levels.ceilings else float(np.percentile(points[:, 2], 99.5))
    height = top - levels.floor.peak
    origin = np.floor(points[:, :2].min(axis=0) / CELL - 8) * CELL
    columns, rows = np.ceil((points[:, :2].max(axis=0) - origin) / CELL).astype(int) + 8
    slices = np.zeros((int(np.ceil(height / SLICE)) + 1, rows, columns), bool)
    _fill_slices(slices, points, float(origin[0]), float(origin[1]), levels.floor.peak)
    return Volume(slices, origin)


@njit(cache=True)
def _fill_slices(slices: NDArray[np.bool_], points: NDArray[np.floating], x: float, y: float, floor_z: float) -> None:
    for n in range(len(points)):
        level = int(np.floor((points[n, 2] - floor_z) / SLICE))
        if 0 <= level < slices.shape[0]:
            row, column = int(np.floor((points[n, 1] - y) / CELL)), int(np.floor((points[n, 0] - x) / CELL))
            slices[level, row, column] = True
