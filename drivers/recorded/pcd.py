"""PCD (Point Cloud Library): text, binary or compressed; organised clouds keep their rows and columns.

Metres, points in the sensor's frame. ``VIEWPOINT`` is the pose; the identity is what is written when nobody knows it.
"""

from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.recorded.raw import Lattice, RawScan, broken, check_room, raw_scan
from drivers.recorded.text import numbers
from perception import transforms
from perception.transforms import Matrix

SUFFIXES = (".pcd",)
_LONGEST_HEADER = 1 << 14
_NO_VIEWPOINT = ["0", "0", "0", "1", "0", "0", "0"]
_LZF_RATIO = 132
"""At best, LZF packs 264 bytes into two."""


class _Header(NamedTuple):
    fields: dict[str, list[str]]
    kind: np.dtype
    end: int
    lines: int

    def number(self, key: str) -> int:
        return int(self.fields[key][0])


def read(path: Path) -> list[RawScan]:
    """The one scan of a file."""
    try:
        header = _header(path)
        width, height, count = (header.number(key) for key in ("WIDTH", "HEIGHT", "POINTS"))
    except (KeyError, ValueError, IndexError, TypeError) as error:
        broken(path, "header", "the header of a PCD file", f"{type(error).__name__}: {error}")
    if count != width * height or min(width, height, count) < 0:
        broken(path, "POINTS", f"{width} x {height}", f"{count}")
    if not {"x", "y", "z"} <= set(header.kind.names or ()):
        broken(path, "FIELDS", "x y z", " ".join(header.kind.names or ()))
    if any(header.kind[axis].shape for axis in "xyz"):
        broken(path, "COUNT", "one x, y, z a point", " ".join(header.fields["COUNT"]))
    points = _points(path, header, count)
    organised = Lattice(*np.divmod(np.arange(count), width), height, width) if height > 1 else None
    return [raw_scan(points, path, _pose(path, header), organised)]


def _header(path: Path) -> _Header:
    with path.open("rb") as file:
        start = file.read(_LONGEST_HEADER)
    fields: dict[str, list[str]] = {}
    end = lines = 0
    while "DATA" not in fields:
        newline = start.find(b"\n", end)
        if newline < 0:
            raise ValueError(f"no DATA within {len(start)} bytes")
        words = start[end:newline].decode("ascii", "replace").split()
        end, lines = newline + 1, lines + 1
        if words and not words[0].startswith("#"):
            fields[words[0]] = words[1:]
    counts = fields.get("COUNT", ["1"] * len(fields["FIELDS"]))
    # The padding that PCL writes is a field "_", several times.
    names = [name if name != "_" else f"_{n}" for n, name in enumerate(fields["FIELDS"])]
    letters = {"F": "f", "I": "i", "U": "u"}
    kinds = [letters[kind] + size for kind, size in zip(fields["TYPE"], fields["SIZE"], strict=True)]
    shapes = [(int(count),) if int(count) != 1 else () for count in counts]
    kind = np.dtype([(name, f"<{k}", shape) for name, k, shape in zip(names, kinds, shapes, strict=True)])
    return _Header(fields, kind, end, lines)


def _points(path: Path, header: _Header, count: int) -> NDArray[np.float64]:
    form = " ".join(header.fields["DATA"])
    names = header.kind.names or ()
    if form == "ascii":
        check_room(path, "POINTS", count, 2 * len(names), header.end)
        widths = [int(np.prod(header.kind[name].shape)) for name in names]
        places = {name: sum(widths[:n]) for n, name in enumerate(names)}
        values = numbers(path, [places[axis] for axis in "xyz"], skip=header.lines)
        if len(values) != count:
            broken(path, "POINTS", f"{count} lines", f"{len(values)}")
        return values
    if form == "binary":
        check_room(path, "POINTS", count, header.kind.itemsize, header.end)
        data = np.fromfile(path, header.kind, count, offset=header.end)
        return np.stack([data[axis] for axis in "xyz"], axis=1).astype(np.float64)
    if form != "binary_compressed":
        broken(path, "DATA", "ascii, binary, binary_compressed", form)
    return _compressed(path, header, count)


def _compressed(path: Path, header: _Header, count: int) -> NDArray[np.float64]:
    """Open3D unpacks it, after the sizes have been found to agree: it believes them."""
    import open3d as o3d

    check_room(path, "DATA", 2, 4, header.end)
    packed, unpacked = (int(size) for size in np.fromfile(path, "<u4", 2, offset=header.end))
    check_room(path, "DATA", packed, 1, header.end + 8)
    if unpacked != count * header.kind.itemsize or unpacked > _LZF_RATIO * packed:
        broken(path, "DATA", f"{count} points of {header.kind.itemsize} bytes", f"{packed} bytes for {unpacked}")
    with o3d.utility.VerbosityContextManager(o3d.utility.VerbosityLevel.Error):
        cloud = o3d.io.read_point_cloud(path, format="pcd", remove_nan_points=False, remove_infinite_points=False)
    if len(cloud.points) != count:
        broken(path, "DATA", f"{count} points", f"{len(cloud.points)}")
    return np.asarray(cloud.points)


def _pose(path: Path, header: _Header) -> Matrix | None:
    words = header.fields.get("VIEWPOINT") or _NO_VIEWPOINT
    try:
        x, y, z, qw, qx, qy, qz = (float(word) for word in words)
        if not 0.9 < np.linalg.norm([qw, qx, qy, qz]) < 1.1:
            raise ValueError
    except ValueError:
        broken(path, "VIEWPOINT", "a position and a unit quaternion", " ".join(words))
    pose = transforms.from_quaternion((qx, qy, qz, qw), (x, y, z))
    return None if np.array_equal(pose, np.eye(4)) else pose
