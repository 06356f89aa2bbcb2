"""The beams of a recorded scan: by the rows and columns of its file, or found again from the directions of its points.

Later stages ask where the scanner looked and where nothing came back, which bare points do not say. Their directions
do, as far as the scanner's steps can be told from them.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from drivers.recorded.raw import Lattice, RawScan
from perception.scan import BeamPattern, Scan

_STEPS = tuple(np.deg2rad((0.02, 0.05, 0.1, 0.2, 0.25, 0.4, 0.5, 1.0)))
_FILL = 0.6
"""Share of the beams, where the scanner looked, that must have returned: else the steps are too fine."""
_KEPT = 0.95
_COHERENT = 0.7
"""How well directions must agree on a step, 0 to 1, for it to be the scanner's."""
_ENOUGH = 1000
_SECTORS = 90
_BINS = 1 << 17
_OFF_BEAM = np.deg2rad(0.5)
_MOST = 50_000_000
_TILTED_COLUMNS = np.deg2rad(60.0)
"""Nearer to the zenith, azimuth says little of the column."""


def scan_of(raw: RawScan, scan_id: str) -> tuple[Scan, bool]:
    """The scan of a set-up, one point a beam: where several fall into one, the nearest.

    The file's own rows and columns are the beams if its points lie where a regular grid has them; otherwise the beams
    are found by direction, with steps that are the scanner's where the points repeat them, else the finest they fill.

    Returns:
        The scan, and whether its beams are those of the file.
    """
    points, ranges = raw.points, np.linalg.norm(raw.points, axis=1)
    gridded = _of_lattice(points, ranges, raw.lattice) if raw.lattice is not None else None
    pattern, beam = gridded or _of_directions(points, ranges)
    order = np.lexsort((ranges, beam))
    order = order[beam[order] >= 0]
    _, first = np.unique(beam[order], return_index=True)
    kept = order[first]
    ones = np.ones(len(kept), np.float32)
    scan = Scan(scan_id, points[kept].astype(np.float32), ones, beam[kept], pattern, np.eye(4), np.eye(4))
    return scan, gridded is not None


def _angles(points: NDArray[np.floating]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Azimuth and elevation, radians."""
    x, y, z = points.T
    return np.arctan2(y, x), np.arctan2(z, np.hypot(x, y))


def _limits(ranges: NDArray[np.floating]) -> tuple[float, float]:
    return float(ranges.min()) * 0.999, float(ranges.max()) * 1.001


# --- by rows and columns ---------------------------------------------------------------------------------------------


def _of_lattice(
    points: NDArray[np.floating], ranges: NDArray[np.floating], lattice: Lattice
) -> tuple[BeamPattern, NDArray[np.int32]] | None:
    """Pattern and beams of a grid whose columns turn evenly and whose rows rise evenly; None if they do not."""
    azimuth, elevation = _angles(points)
    flat = np.abs(elevation) < _TILTED_COLUMNS
    if lattice.rows < 2 or lattice.columns < 2 or lattice.rows * lattice.columns > _MOST or flat.sum() < _ENOUGH:
        return None
    turn, first = _line(lattice.column[flat], azimuth[flat])
    rise, lowest = _line(lattice.row, elevation)
    highest = lowest + rise * (lattice.rows - 1)
    if turn == 0 or rise == 0 or max(abs(lowest), abs(highest)) > np.pi / 2 + abs(rise):
        return None
    columns = round(2 * np.pi / abs(turn))
    if not lattice.columns * 0.98 <= columns or columns * lattice.rows > _MOST:
        return None
    pattern = BeamPattern(columns, lattice.rows, min(lowest, highest), max(lowest, highest), *_limits(ranges))
    column = np.rint((first + turn * lattice.column) / pattern.azimuth_step).astype(np.int64) % columns
    row = lattice.row if rise > 0 else lattice.rows - 1 - lattice.row
    beam = (row * columns + column).astype(np.int32)
    along = np.einsum("ij,ij->i", pattern.directions(beam), points) / ranges
    return (pattern, beam) if np.quantile(along, 0.01) > np.cos(_OFF_BEAM) else None


def _line(index: NDArray[np.integer], angle: NDArray[np.floating]) -> tuple[float, float]:
    """Slope and offset of the angle (which may wrap) over the index; slope 0 where there is none to be had."""
    seen, place = np.unique(index, return_inverse=True)
    if len(seen) < 2:
        return 0.0, 0.0
    middle = np.arctan2(np.bincount(place, np.sin(angle)), np.bincount(place, np.cos(angle)))
    unwrapped = np.unwrap(middle)
    # Few columns may hold strays only; the median of the slopes does not mind.
    slope = float(np.median(np.diff(unwrapped) / np.diff(seen)))
    offsets = middle - slope * seen
    return slope, float(np.arctan2(np.median(np.sin(offsets)), np.median(np.cos(offsets))))


# --- by direction ----------------------------------------------------------------------------------------------------


def _of_directions(points: NDArray[np.floating], ranges: NDArray[np.floating]) -> tuple[BeamPattern, NDArray[np.int32]]:
    azimuth, elevation = _angles(points)
    columns, rows = _columns(azimuth), _rows(elevation)
    low, high = (float(value) for value in np.quantile(elevation, (0.0005, 0.9995)))
    span = (rows[1], rows[2]) if rows else (low, max(high, low + _STEPS[-1]))

    def with_step(step: float) -> BeamPattern:
        square = BeamPattern.with_step(step, span, _limits(ranges))
        return replace(square, columns=columns or square.columns, rows=rows[0] if rows else square.rows)

    patterns = [pattern for pattern in map(with_step, _STEPS) if pattern.size <= _MOST]
    last = len(patterns) - 1
    index = next((i for i, pattern in enumerate(patterns) if _fill(pattern, points) > _FILL), last)
    finest, coarser = patterns[index], patterns[min(index + 1, last)]
    # A grid of 0.5 degrees fills most of one of 0.4 as well; in its own, no two of its points meet.
    pattern = coarser if _returned(coarser, points).size > _KEPT * _returned(finest, points).size else finest
    return pattern, pattern.beams_towards(points)


def _columns(azimuth: NDArray[np.floating]) -> int | None:
    """Columns of a full circle that the azimuths repeat, first column at +x; None if they are spread."""
    if len(azimuth) < _ENOUGH:
        return None
    frequency = _fundamental(azimuth, 2 * np.pi)
    if frequency is None:
        return None
    # Columns that begin between two beams of the pattern would alternate between them.
    phase = np.angle(np.exp(1j * azimuth * frequency).mean()) / (2 * np.pi)
    return frequency if abs(phase) < 0.3 else 2 * frequency


def _rows(elevation: NDArray[np.floating]) -> tuple[int, float, float] | None:
    """Number of rings and the elevations of the lowest and the highest; None if the elevations are spread."""
    if len(elevation) < _ENOUGH:
        return None
    # A fraction of a turn as the period gives the spectrum the resolution that rings over a small angle need.
    period = 8 * np.pi
    frequency = _fundamental(elevation, period)
    if frequency is None:
        return None
    step = period / frequency
    offset = float(np.angle(np.exp(2j * np.pi * elevation / step).mean())) / (2 * np.pi) * step
    ring = np.rint((elevation - offset) / step)
    low, high = (int(value) for value in np.quantile(ring, (0.0005, 0.9995)))
    return (high - low + 1, offset + low * step, offset + high * step) if high > low else None


def _fundamental(angles: NDArray[np.floating], period: float) -> int | None:
    """The lowest number of steps to the period at which all angles are near multiples of the step, if there is one."""
    place = np.floor((angles + period / 2) / period * _BINS).astype(np.int64) % _BINS
    spectrum = np.abs(np.fft.rfft(np.bincount(place, minlength=_BINS))) / len(angles)
    # Below lies the shape of the scene: angles that crowd in one direction.
    coarsest = int(np.ceil(period / np.deg2rad(4.0)))
    coherent = np.flatnonzero(spectrum[coarsest : _BINS // 4] > _COHERENT)
    if len(coherent) == 0:
        return None
    lowest = coarsest + int(coherent[0])
    width = max(1, round(period / np.pi))
    return lowest + int(np.argmax(spectrum[lowest : lowest + width]))


def _returned(pattern: BeamPattern, points: NDArray[np.floating]) -> NDArray[np.int32]:
    """Beams that some point lies in."""
    beams = np.unique(pattern.beams_towards(points))
    return beams[beams >= 0]


def _fill(pattern: BeamPattern, points: NDArray[np.floating]) -> float:
    """Share of the beams that returned, in the sectors that the scanner looked at."""
    returned = _returned(pattern, points)
    sectors = min(_SECTORS, pattern.columns)
    looked_at = np.unique(returned % pattern.columns * sectors // pattern.columns).size / sectors
    return returned.size / max(looked_at * pattern.size, 1)
