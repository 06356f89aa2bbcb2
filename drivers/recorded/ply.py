"""PLY (Stanford): text or binary, points with any further properties. Metres, in the frame of the file; no pose."""

from pathlib import Path
from typing import NamedTuple

import numpy as np

from drivers.recorded.raw import RawScan, broken, check_room, raw_scan
from drivers.recorded.text import numbers

SUFFIXES = (".ply",)
_LONGEST_HEADER = 1 << 16
_ORDER = {"binary_little_endian": "<", "binary_big_endian": ">"}
_KIND = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4",
    "double": "f8", "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float32": "f4", "float64": "f8",
}  # fmt: skip


class _Header(NamedTuple):
    """Format, the elements up to the points (name, count, properties by name and kind), and where the data begin."""

    form: str
    elements: list[tuple[str, int, list[tuple[str, str]]]]
    end: int
    lines: int


def read(path: Path) -> list[RawScan]:
    """The one scan of a file.

    ``obj_info num_cols`` and the like are not read: no two programs agree on them.
    """
    header = _header(path)
    *before, (_, count, properties) = header.elements
    names = [name for name, _ in properties]
    if not {"x", "y", "z"} <= set(names):
        broken(path, "vertex", "properties x, y, z", ", ".join(names) or "none")
    if any(kind == "list" for _, _, parts in header.elements for _, kind in parts):
        broken(path, "header", "no lists up to the vertices", "a list")
    if header.form == "ascii":
        check_room(path, "vertex", count, 2 * len(properties), header.end)
        skip = header.lines + sum(length for _, length, _ in before)
        values = numbers(path, [names.index(axis) for axis in "xyz"], skip=skip)[:count]
        if len(values) < count:
            broken(path, "vertex", f"{count} lines", f"{len(values)}")
        return [raw_scan(values, path)]
    order = _ORDER.get(header.form) or broken(path, "format", ", ".join(("ascii", *_ORDER)), header.form)
    kinds = [np.dtype([(name, order + kind) for name, kind in parts]) for _, _, parts in header.elements]
    offset = header.end + sum(length * kind.itemsize for (_, length, _), kind in zip(before, kinds, strict=False))
    check_room(path, "vertex", count, kinds[-1].itemsize, offset)
    data = np.fromfile(path, kinds[-1], count, offset=offset)
    return [raw_scan(np.stack([data[axis] for axis in "xyz"], axis=1).astype(np.float64), path)]


def _header(path: Path) -> _Header:
    with path.open("rb") as file:
        start = file.read(_LONGEST_HEADER)
    text, end, _ = start.partition(b"end_header")
    newline = start.find(b"\n", len(text))
    if not start.startswith(b"ply") or not end or newline < 0:
        broken(path, "header", "ply ... end_header", repr(start[:20]))
    form = ""
    elements: list[tuple[str, int, list[tuple[str, str]]]] = []
    lines = text.decode("ascii", "replace").splitlines()
    for line in lines:
        match line.split():
            case ["format", form, *_]:
                pass
            case ["element", name, count] if count.isdigit():
                if elements and elements[-1][0] == "vertex":
                    break
                elements.append((name, int(count), []))
            case ["property", "list", *_, name] if elements:
                elements[-1][2].append((name, "list"))
            case ["property", kind, name] if elements and kind in _KIND:
                elements[-1][2].append((name, _KIND[kind]))
            case ["ply"] | ["comment" | "obj_info", *_] | []:
                pass
            case _:
                broken(path, "header", "a line of a PLY header", repr(line[:80]))
    if not elements or elements[-1][0] != "vertex":
        broken(path, "header", "element vertex", ", ".join(name for name, _, _ in elements) or "no element")
    return _Header(form, elements, newline + 1, len(lines) + 1)
