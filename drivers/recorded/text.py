"""Text: one point a line, separated by blanks, commas or semicolons (``.xyz``, ``.csv``).

A first line may name the columns; then x, y and z are taken by name, in any order, and so are row and column. Without
one, the first three columns are x, y, z. Coordinates are metres unless the heading says otherwise, as in ``x_mm``,
``X (cm)`` or ``x[ft]``. Further columns are left alone; lines that begin with ``#`` or ``//`` are comments, the first
of which may be the heading.
"""

import re
import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from drivers.recorded.raw import Lattice, RawScan, broken, raw_scan

SUFFIXES = (".xyz", ".csv")
_METRES = {"": 1.0, "m": 1.0, "cm": 0.01, "mm": 0.001, "ft": 0.3048, "in": 0.0254}
_HEADING = re.compile(r"^(?P<name>[a-z]+)[\s_]*[\[(]?(?P<unit>[a-z]*)[\])]?$")
_LONGEST = 1 << 22
"""Largest row or column number that is believed."""


def read(path: Path) -> list[RawScan]:
    """The one scan of a file."""
    heading, separator, skip = _layout(path)
    if heading is None:
        return [raw_scan(numbers(path, 3, separator=separator, skip=skip), path)]
    names = [_named(path, word) for word in heading]
    places = {name: index for index, (name, _) in reversed(list(enumerate(names)))}
    if not {"x", "y", "z"} <= places.keys():
        broken(path, "heading", "columns x, y, z", ", ".join(heading))
    gridded = {"row", "column"} <= places.keys()
    columns = [places[name] for name in (("x", "y", "z", "row", "column") if gridded else ("x", "y", "z"))]
    units = {names[places[axis]][1] for axis in "xyz"}
    if len(units) > 1:
        broken(path, "heading", "one unit for x, y, z", ", ".join(sorted(units)))
    values = numbers(path, columns, separator=separator, skip=skip)
    points = values[:, :3] * _METRES[units.pop()]
    return [raw_scan(points, path, lattice=_lattice(path, values[:, 3:]) if gridded else None)]


def numbers(path: Path, columns: int | list[int], separator: str | None = None, skip: int = 0) -> NDArray[np.float64]:
    """Columns of a text file as ``(N, C)``; as many as the lines say, so that nothing is allocated on a promise.

    Raises:
        FailureError: ``RECORDED_BROKEN`` when there is no line, or one does not hold these numbers.
    """
    wanted = list(range(columns)) if isinstance(columns, int) else columns
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # An empty file is refused below.
            values = np.loadtxt(path, delimiter=separator, skiprows=skip, usecols=wanted, ndmin=2, comments=["#", "//"])
    except (ValueError, OSError) as error:
        broken(path, "lines", f"{len(wanted)} numbers each", str(error))
    if len(values) == 0:
        broken(path, "lines", f"{len(wanted)} numbers each", "none")
    return values


def _layout(path: Path) -> tuple[list[str] | None, str | None, int]:
    """Names of the columns if there are any, the separator (None for blanks), and how many lines to skip."""
    first = data = ""
    with path.open(encoding="utf-8", errors="replace") as lines:
        for number, line in enumerate(lines):
            text = line[:4096].strip()
            comment = text.startswith(("#", "//"))
            text = text.lstrip("#/ ")
            if text and not first and re.match(r"\W*[A-Za-z]", text) and not _is_number(text):
                first, skip = text.lower(), number + 1
            elif text and not comment:
                data = text
                break
            if number > 1000:
                break
    separator = next((mark for mark in (";", ",") if mark in (data or first)), None)
    if not first:
        return None, separator, 0
    between = next((mark for mark in (";", ",", "\t") if mark in first), None)
    heading = [word.strip().strip('"') for word in first.split(between)]
    named = any(_HEADING.match(word) and word[0] in "xyz" for word in heading)
    return (heading if named else None), separator, skip if named else 0


def _is_number(text: str) -> bool:
    return text.split()[0].strip(",;").lower() in ("nan", "inf")


def _named(path: Path, word: str) -> tuple[str, str]:
    """Name of a column and its unit; a unit that is not known is refused where it matters."""
    match = _HEADING.match(word)
    if match is None:
        return word, ""
    name = {"col": "column"}.get(match["name"], match["name"])
    if name in ("x", "y", "z") and match["unit"] not in _METRES:
        broken(path, "unit", ", ".join(unit for unit in _METRES if unit), word)
    return name, match["unit"]


def _lattice(path: Path, cells: NDArray[np.float64]) -> Lattice:
    if not (np.isfinite(cells).all() and cells.min() >= 0 and cells.max() < _LONGEST):
        broken(path, "rows and columns", f"0 to {_LONGEST - 1}", f"{cells.min()} to {cells.max()}")
    row, column = cells.astype(np.int64).T
    return Lattice(row, column, int(row.max()) + 1, int(column.max()) + 1)
