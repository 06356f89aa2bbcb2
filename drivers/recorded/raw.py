"""What every reader of recorded scans gives: points, with their grid and pose; and how a file is refused."""

from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from perception.failure import FailureError
from perception.transforms import Matrix


@dataclass(frozen=True)
class Lattice:
    """The scanner's own rows and columns, as the file has them.

    Args:
        row, column: ``(N,)`` of each point.
        rows, columns: how many the scanner fired, also where nothing returned.
    """

    row: NDArray[np.int64]
    column: NDArray[np.int64]
    rows: int
    columns: int


@dataclass(frozen=True)
class RawScan:
    """One set-up as a file has it.

    Args:
        points: ``(N, 3)`` float64, metres, finite, in the frame of the file; what did not return is left out.
        source: file name, and the set-up's own name where a file holds several.
        world_from_scanner: 4x4, None where the file does not say.
        lattice: None where the file has points and no more.
    """

    points: NDArray[np.float64]
    source: str
    world_from_scanner: Matrix | None = None
    lattice: Lattice | None = None


def raw_scan(
    points: NDArray[np.floating],
    path: Path,
    world_from_scanner: Matrix | None = None,
    lattice: Lattice | None = None,
    name: str = "",
) -> RawScan:
    """The set-up without its missing returns: rows that are not finite, and those exactly at the scanner's centre.

    Raises:
        FailureError: ``RECORDED_BROKEN`` when nothing is left.
    """
    kept = np.isfinite(points).all(axis=1) & points.any(axis=1)
    if not kept.any():
        broken(path, "points", "at least one", f"{len(points)} rows without a return")
    if lattice is not None:
        lattice = Lattice(lattice.row[kept], lattice.column[kept], lattice.rows, lattice.columns)
    source = f"{path.name}: {name}" if name else path.name
    return RawScan(points[kept].astype(np.float64, copy=False), source, world_from_scanner, lattice)


def broken(path: Path, what: str, expected: str, found: str) -> NoReturn:
    """Refuse a file by name.

    Raises:
        FailureError: ``RECORDED_BROKEN``, always.
    """
    raise FailureError(
        "RECORDED_BROKEN",
        f"{path}: {what}: expected {expected}, found {found}",
        file=str(path),
        expected=expected,
        found=found,
    )


def check_room(path: Path, what: str, count: int, size: int, offset: int = 0) -> None:
    """Refuse a header that promises ``count`` items of at least ``size`` bytes beyond ``offset`` that are not there.

    Called before anything of the promised size is allocated.
    """
    there = path.stat().st_size - offset
    if count < 0 or count * size > there:
        broken(path, what, f"{count} of at least {size} bytes", f"{there} bytes")


def rigid_pose(path: Path, matrix: NDArray[np.floating]) -> Matrix:
    """The pose of a file, its rotation made exact: headers are rounded.

    Raises:
        FailureError: ``RECORDED_BROKEN`` for a matrix that is not finite, scales, shears or mirrors.
    """
    pose = np.eye(4)
    pose[:3] = matrix[:3]
    if not np.isfinite(matrix).all():
        broken(path, "pose", "finite numbers", str(matrix.tolist()))
    u, scales, v = np.linalg.svd(pose[:3, :3])
    if np.abs(scales - 1).max() > 0.01 or np.linalg.det(u @ v) < 0:
        broken(path, "pose", "a rotation", str(pose[:3, :3].round(4).tolist()))
    pose[:3, :3] = u @ v
    return pose
