"""One scan as the scanner took it: points, and which beam gave each, so that a missing return is known."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from perception.transforms import Matrix


@dataclass(frozen=True)
class BeamPattern:
    """The regular grid of beams of a rotating scanner, in the scanner's frame.

    Beam ``row * columns + column`` has azimuth ``2 pi column / columns`` (counter-clockwise from +x) and the
    elevation of its row, rows running evenly from ``elevation_min`` to ``elevation_max`` (both included), radians.
    A beam returns nothing below ``range_min`` or above ``range_max`` (metres).
    """

    columns: int
    rows: int
    elevation_min: float
    elevation_max: float
    range_min: float
    range_max: float

    @classmethod
    def with_step(cls, step: float, elevation: tuple[float, float], ranges: tuple[float, float]) -> "BeamPattern":
        """Pattern over 360 degrees with about ``step`` radians between neighbouring beams."""
        columns = max(4, round(2 * np.pi / step))
        rows = max(2, round((elevation[1] - elevation[0]) / step) + 1)
        return cls(columns, rows, elevation[0], elevation[1], ranges[0], ranges[1])

    @property
    def size(self) -> int:
        return self.columns * self.rows

    @property
    def elevation_step(self) -> float:
        return (self.elevation_max - self.elevation_min) / (self.rows - 1)

    @property
    def azimuth_step(self) -> float:
        return 2 * np.pi / self.columns

    def strides(self, step: int) -> tuple[int, int]:
        """Rows and columns from one to the next when about every ``step``-th is taken; columns go evenly round."""
        across = next((n for n in range(step, self.columns // 4 + 1) if self.columns % n == 0), 1)
        return min(step, self.rows - 1), across

    def every(self, step: int) -> "BeamPattern":
        """The pattern of the beams that :meth:`strides` picks, from the first on."""
        up, across = self.strides(step)
        rows = (self.rows - 1) // up + 1
        top = self.elevation_min + (rows - 1) * up * self.elevation_step
        return replace(self, columns=self.columns // across, rows=rows, elevation_max=top)

    def directions(self, beams: NDArray[np.integer] | None = None) -> NDArray[np.float32]:
        """Unit vectors ``(N, 3)`` of the given beams (all of them by default)."""
        index = np.arange(self.size) if beams is None else beams
        azimuth = (index % self.columns) * self.azimuth_step
        elevation = self.elevation_min + (index // self.columns) * self.elevation_step
        cos = np.cos(elevation)
        return np.stack([cos * np.cos(azimuth), cos * np.sin(azimuth), np.sin(elevation)], axis=-1).astype(np.float32)

    def beams_towards(self, points: NDArray[np.floating]) -> NDArray[np.int32]:
        """Nearest beam of each point ``(N, 3)`` (scanner frame); -1 outside the field of view."""
        x, y, z = points[:, 0], points[:, 1], points[:, 2]
        column = np.rint(np.arctan2(y, x) / self.azimuth_step).astype(np.int32) % self.columns
        row = np.rint((np.arctan2(z, np.hypot(x, y)) - self.elevation_min) / self.elevation_step).astype(np.int32)
        return np.where((row >= 0) & (row < self.rows), row * self.columns + column, -1).astype(np.int32)


@dataclass(frozen=True)
class Scan:
    """The partial cloud ``P_p(t)`` in the scanner's frame with the odometry it was taken at.

    Args:
        scan_id: name, unique within a mission.
        points: ``(N, 3)`` float32, metres, scanner frame.
        intensity: ``(N,)`` float32 in [0, 1].
        beam: ``(N,)`` int32, the beam of ``pattern`` that gave each point; each beam at most once.
        pattern: the beams that were fired; one without a point had no return.
        odom_from_base: 4x4, the base's odometry while it stood for the scan.
        base_from_scanner: 4x4, the scanner's mounting.
    """

    scan_id: str
    points: NDArray[np.float32]
    intensity: NDArray[np.float32]
    beam: NDArray[np.int32]
    pattern: BeamPattern
    odom_from_base: Matrix
    base_from_scanner: Matrix

    def without(self, places: NDArray[np.integer]) -> "Scan":
        """The scan less the points at these places; itself, not a copy, if there are none."""
        if len(places) == 0:
            return self
        kept = np.ones(len(self.points), np.bool_)
        kept[places] = False
        return replace(self, points=self.points[kept], intensity=self.intensity[kept], beam=self.beam[kept])

    def every(self, step: int) -> "Scan":
        """The scan as :meth:`BeamPattern.every` would have taken it."""
        pattern, (up, across) = self.pattern.every(step), self.pattern.strides(step)
        row, column = np.divmod(self.beam, np.int32(self.pattern.columns))
        kept = np.flatnonzero((row % up == 0) & (column % across == 0))
        beam = (row[kept] // up * pattern.columns + column[kept] // across).astype(np.int32)
        return replace(self, points=self.points[kept], intensity=self.intensity[kept], beam=beam, pattern=pattern)

    def range_image(self) -> NDArray[np.float32]:
        """``(rows, columns)`` measured range of each beam in metres; 0 where nothing returned."""
        image = np.zeros(self.pattern.size, np.float32)
        image[self.beam] = np.linalg.norm(self.points, axis=1)
        return image.reshape(self.pattern.rows, self.pattern.columns)
