"""Value types of the maps: the 2-D grids and the voxel space, in the map frame."""

from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray


class Cell(IntEnum):
    """State of a cell of the robot map ``M(t)``."""

    FREE = 0
    OBSTACLE = 1
    UNKNOWN = 2


class Label(IntEnum):
    """Label of a voxel, and of a pixel of the labelled map (paper section 4.1); priority in a pixel grows upwards."""

    OUTSIDE = 0
    EMPTY = 1
    OCCLUDED = 2
    OCCUPIED = 3


@dataclass(frozen=True)
class Grid:
    """A 2-D grid in the map frame.

    Args:
        data: ``(rows, columns)``, indexed ``[row, column]`` with row along +y and column along +x.
        origin: map coordinates (x, y) of the lower-left corner of cell [0, 0], metres.
        resolution: side of a cell, metres.
    """

    data: NDArray
    origin: tuple[float, float]
    resolution: float

    @property
    def shape(self) -> tuple[int, int]:
        return self.data.shape[0], self.data.shape[1]

    def cells_of(self, xy: ArrayLike) -> NDArray[np.int64]:
        """(row, column) of each map position ``(..., 2)``; may lie outside the grid."""
        offset = np.asarray(xy, float)[..., :2] - self.origin
        return np.floor(offset / self.resolution).astype(np.int64)[..., ::-1]

    def centres_of(self, cells: ArrayLike) -> NDArray[np.float64]:
        """Map position (x, y) of the centre of each cell (row, column) ``(..., 2)``."""
        return (np.asarray(cells)[..., ::-1] + 0.5) * self.resolution + np.asarray(self.origin)

    def contains(self, cells: ArrayLike) -> NDArray[np.bool_]:
        """Whether each cell (row, column) ``(..., 2)`` lies in the grid."""
        cells = np.asarray(cells)
        return np.all((cells >= 0) & (cells < self.shape), axis=-1)

    def with_data(self, data: NDArray) -> "Grid":
        """The same frame with other values."""
        return Grid(data, self.origin, self.resolution)


@dataclass(frozen=True)
class VoxelSpace:
    """The voxel space ``V(t)`` of a room (paper section 4.1).

    Args:
        labels: ``(nx, ny, nz)`` uint8 of :class:`Label`; OUTSIDE where the voxel is not of this room.
        origin: map coordinates of the lower corner of voxel [0, 0, 0], metres.
        size: side ``l`` of a voxel, metres.
    """

    labels: NDArray[np.uint8]
    origin: tuple[float, float, float]
    size: float

    def count(self, label: Label) -> int:
        return int(np.count_nonzero(self.labels == label))

    @property
    def total(self) -> int:
        """V, the number of voxels of the room."""
        return int(np.count_nonzero(self.labels))

    @property
    def seen(self) -> int:
        """V_s, occupied and empty voxels."""
        return self.count(Label.OCCUPIED) + self.count(Label.EMPTY)

    def voxels_of(self, points: NDArray[np.floating]) -> NDArray[np.int64]:
        """Voxel index (i, j, k) of each map position ``(N, 3)``; may lie outside."""
        return np.floor((np.asarray(points, float) - self.origin) / self.size).astype(np.int64)

    def centres(self, voxels: NDArray[np.integer]) -> NDArray[np.float64]:
        """Map position of the centre of each voxel ``(N, 3)``."""
        return (voxels + 0.5) * self.size + np.asarray(self.origin)
