"""PTX (Leica): text, one block a set-up: columns, rows, the scanner's pose twice, then every beam of the grid in turn.

A beam without a return is written as ``0 0 0``. Points are metres in the scanner's frame, column after column; the
4x4 matrix is written for row vectors.
"""

from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from typing import TextIO

import numpy as np

from drivers.recorded.raw import Lattice, RawScan, broken, check_room, raw_scan, rigid_pose

SUFFIXES = (".ptx",)
_POSE_LINES = (3, 3, 3, 3, 4, 4, 4, 4)
"""Numbers in each line of the head: position, three axes, and the matrix."""
_SHORTEST = len("0 0 0 0")


def read(path: Path) -> list[RawScan]:
    """Every set-up of a file."""
    with path.open(encoding="ascii", errors="replace") as lines:
        return list(_set_ups(path, lines))


def _set_ups(path: Path, lines: TextIO) -> Iterator[RawScan]:
    number = 0
    while (columns := _count(path, lines, "columns", optional=number > 0)) is not None:
        number += 1
        rows = _count(path, lines, "rows") or 0
        head = [_head_line(path, lines, length) for length in _POSE_LINES]
        check_room(path, "points", columns * rows, _SHORTEST)
        pose = rigid_pose(path, np.array(head[4:]).T)
        beams = islice(lines, columns * rows)
        try:
            points = np.loadtxt(beams, usecols=(0, 1, 2), ndmin=2)
        except ValueError as error:
            broken(path, "points", "x y z intensity", str(error))
        if len(points) != columns * rows:
            broken(path, "points", f"{columns} x {rows} lines", f"{len(points)}")
        column, row = np.divmod(np.arange(columns * rows), rows)
        yield raw_scan(points, path, pose, Lattice(row, column, rows, columns), f"set-up {number}")


def _count(path: Path, lines: TextIO, what: str, optional: bool = False) -> int | None:
    line = next((line for line in lines if line.strip()), "")
    if not line and optional:
        return None
    if not (line.strip().isascii() and line.strip().isdigit()) or len(line) > 20 or int(line) < 1:
        broken(path, what, "a whole number", repr(line[:40]))
    return int(line)


def _head_line(path: Path, lines: TextIO, length: int) -> list[float]:
    line = next(lines, "")
    try:
        values = [float(word) for word in line.split()]
    except ValueError:
        values = []
    if len(values) != length:
        broken(path, "pose", f"{length} numbers", repr(line[:80]))
    return values
