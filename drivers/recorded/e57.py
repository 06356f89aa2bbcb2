"""E57 (ASTM E2807): every set-up of a file, with its pose, and its rows and columns where it has them."""

from pathlib import Path

import numpy as np
import pye57
from numpy.typing import NDArray
from pye57 import libe57

from drivers.recorded.raw import Lattice, RawScan, broken, raw_scan
from perception import transforms
from perception.transforms import Matrix

SUFFIXES = (".e57",)
_AT_ONCE = 1_000_000
"""Points that are read at a time, so that a header that lies costs no memory."""
_CARTESIAN = ("cartesianX", "cartesianY", "cartesianZ")
_SPHERICAL = ("sphericalRange", "sphericalAzimuth", "sphericalElevation")
_INVALID = ("cartesianInvalidState", "sphericalInvalidState")
_CELLS = ("rowIndex", "columnIndex")

Columns = dict[str, NDArray]


def read(path: Path) -> list[RawScan]:
    """Every set-up of a file that holds points."""
    try:
        with pye57.E57(str(path)) as image:
            scans = [_set_up(path, image, number) for number in range(image.scan_count)]
    except (RuntimeError, ValueError, TypeError, KeyError, AttributeError, libe57.E57Exception) as error:
        broken(path, "E57", "a file that can be read", f"{type(error).__name__}: {str(error)[:200]}")
    if not scans:
        broken(path, "data3D", "at least one scan", "none")
    return scans


def _set_up(path: Path, image: pye57.E57, number: int) -> RawScan:
    header = image.get_header(number)
    there = set(header.point_fields)
    axes = next((fields for fields in (_CARTESIAN, _SPHERICAL) if there.issuperset(fields)), None)
    if axes is None:
        broken(path, "points", f"{_CARTESIAN} or {_SPHERICAL}", ", ".join(sorted(there)))
    gridded = there.issuperset(_CELLS)
    data = _columns(image, header, [*axes, *(field for field in (*_INVALID, *_CELLS) if field in there)])
    points = np.stack([data[field] for field in axes], axis=1)
    if axes == _SPHERICAL:
        distance, azimuth, elevation = points.T
        flat = distance * np.cos(elevation)
        points = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), distance * np.sin(elevation)], axis=1)
    for field in _INVALID:
        points[data.get(field, np.zeros(len(points))) != 0] = np.nan
    lattice = _lattice(header, data) if gridded and len(points) else None
    return raw_scan(points, path, _pose(path, header), lattice, _name(header, number))


def _columns(image: pye57.E57, header: pye57.ScanHeader, fields: list[str]) -> Columns:
    arrays, buffers = image.make_buffers(fields, min(_AT_ONCE, max(1, header.point_count)))
    reader = header.points.reader(buffers)
    parts: list[Columns] = [{field: array[:0].copy() for field, array in arrays.items()}]
    while count := reader.read():
        parts.append({field: array[:count].copy() for field, array in arrays.items()})
    reader.close()
    return {field: np.concatenate([part[field] for part in parts]) for field in fields}


def _lattice(header: pye57.ScanHeader, data: Columns) -> Lattice:
    """Rows and columns counted from the first of the file's bounds; the bounds also tell of what did not return."""
    row, column = (data[field].astype(np.int64) for field in _CELLS)
    sizes = []
    for cells, name in ((row, "row"), (column, "column")):
        low, high = int(cells.min()), int(cells.max())
        try:
            bounds = header["indexBounds"]
            first, last = (int(bounds[f"{name}{end}"].value()) for end in ("Minimum", "Maximum"))
        except (KeyError, AttributeError, libe57.E57Exception):
            first, last = low, high
        # Bounds beyond any grid are not believed; those of points without a grid are the points' numbers.
        if not (first <= low and high <= last < first + 4 * (high - low + 1)):
            first, last = low, high
        cells -= first
        sizes.append(last - first + 1)
    return Lattice(row, column, *sizes)


def _pose(path: Path, header: pye57.ScanHeader) -> Matrix | None:
    if not header.has_pose():
        return None
    w, x, y, z = (float(value) for value in header.rotation)
    if not 0.9 < np.linalg.norm([w, x, y, z]) < 1.1 or not np.isfinite(header.translation).all():
        broken(path, "pose", "a unit quaternion and a position", f"{[w, x, y, z]}, {list(header.translation)}")
    return transforms.from_quaternion((x, y, z, w), header.translation)


def _name(header: pye57.ScanHeader, number: int) -> str:
    try:
        return str(header["name"].value())
    except (KeyError, libe57.E57Exception):
        return f"scan {number + 1}"
