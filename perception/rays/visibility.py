"""What every candidate would see of the unseen voxels, kept from cycle to cycle (paper section 4.2).

What something hides stays hidden, because occupied voxels are never taken back: from a candidate that was looked from
before, only those voxels must be looked for again that were in free sight then, and those that are new. So after the
first cycle a count of all candidates costs a tenth, and is exact all the same.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from perception.grids import Label, VoxelSpace
from perception.rays import ray_walk

MOST_WORDS = 12_000_000
"""Pairs of candidate and column that are kept in memory, 8 bytes each."""


@dataclass(frozen=True)
class View:
    """From which height, and how far, every candidate looks.

    Args:
        level: of the optical centre above the lower face of the space, in units of :mod:`perception.rays.ray_walk`.
        slopes: tangents of the least and greatest elevation.
        ranges: least and greatest range in those units.
    """

    level: int
    slopes: tuple[float, float]
    ranges: tuple[float, float]


@dataclass(frozen=True)
class Sight:
    """What the candidates of a cycle saw but for what lies outside the room.

    Args:
        view: of the candidates.
        floor: lowest layer on the lattice that all spaces share.
        walls: words of the occupied voxels ``(nx, ny)``.
        corner: lattice column of ``walls[0, 0]``.
        cells: ``(K, 2)`` candidates of this cycle and, behind them, of earlier ones; lattice columns.
        columns: ``(C, 2)`` lattice columns with unseen voxels.
        unseen: ``(C,)`` their words.
        words: ``(K, C)`` those of them in free sight, or not known to be hidden.
    """

    view: View
    floor: int
    walls: NDArray[np.int64]
    corner: NDArray[np.int64]
    cells: NDArray[np.int64]
    columns: NDArray[np.int64]
    unseen: NDArray[np.int64]
    words: NDArray[np.int64]


def count(
    space: VoxelSpace, unseen: NDArray[np.bool_], cells: NDArray[np.int64], view: View, earlier: Sight | None = None
) -> tuple[NDArray[np.int64], Sight | None]:
    """How many of the ``unseen`` voxels each candidate sees.

    Args:
        space: its occupied voxels and the outside of the room block.
        unseen: ``(nx, ny, nz)`` voxels to count.
        cells: ``(K, 2)`` candidates, columns (i, j) of the space.
        view: of all candidates.
        earlier: result of an earlier cycle of this room; of another room it only does not help.

    Returns:
        ``(K,)`` counts, and what to hand in next time; None where that would be too much to keep.
    """
    centres = cells * ray_walk.SUBDIVISION + ray_walk.SUBDIVISION // 2
    places = np.column_stack([centres, np.full(len(cells), view.level)])
    if space.labels.shape[2] > ray_walk.MAX_LAYERS:
        blocking = (space.labels == Label.OCCUPIED) | (space.labels == Label.OUTSIDE)
        return ray_walk.count_visible(blocking, np.argwhere(unseen), places, view.slopes, view.ranges), None
    walls, outside, wanted = (
        ray_walk.words(mask) for mask in (space.labels == Label.OCCUPIED, space.labels == Label.OUTSIDE, unseen)
    )
    columns = np.argwhere(wanted)
    most = max(1, MOST_WORDS // max(1, len(columns)))
    if len(cells) > most:
        parts = [places[n : n + most] for n in range(0, len(places), most)]
        sights = [_repeated(wanted, columns, len(part)) for part in parts]
        seen = [
            ray_walk.look(walls, outside, columns, sight, part, view.slopes, view.ranges)
            for sight, part in zip(sights, parts, strict=True)
        ]
        return np.concatenate(seen), None
    corner = _lattice_corner(space)
    now = Sight(view, int(corner[2]), walls, corner[:2], cells + corner[:2], columns + corner[:2],
                wanted[tuple(columns.T)], _repeated(wanted, columns, len(cells)))  # fmt: skip
    if earlier is not None and _still_holds(earlier, now):
        now = _with_what_was_hidden(earlier, now, most)
    # A view of the first rows: candidates of before that are none now wait behind them.
    asked = now.words[: len(cells)]
    return ray_walk.look(walls, outside, columns, asked, places, view.slopes, view.ranges), now


def _repeated(wanted: NDArray[np.int64], columns: NDArray[np.int64], cells: int) -> NDArray[np.int64]:
    """The words of the columns once for each candidate."""
    return np.repeat(wanted[tuple(columns.T)][None], cells, axis=0)


def _lattice_corner(space: VoxelSpace) -> NDArray[np.int64]:
    return np.rint(np.asarray(space.origin) / space.size + (0.0, 0.0, 0.5)).astype(np.int64)


def _still_holds(earlier: Sight, now: Sight) -> bool:
    """Whether all that was occupied still is, and the candidates look from the same height."""
    if earlier.view != now.view or earlier.floor != now.floor:
        return False
    row, column = earlier.corner - now.corner
    rows, columns = earlier.walls.shape
    if row < 0 or column < 0:
        return False
    part = now.walls[row : row + rows, column : column + columns]
    return part.shape == earlier.walls.shape and not np.any(earlier.walls & ~part)


def _with_what_was_hidden(earlier: Sight, now: Sight, most: int) -> Sight:
    """``now`` without what was hidden before, and with the candidates of before, as many as there is room for."""
    absent = ~np.isin(_keys(earlier.cells), _keys(now.cells))
    left = earlier.cells[absent][: most - len(now.cells)]
    cells = np.concatenate([now.cells, left])
    words = np.concatenate([now.words, np.repeat(now.unseen[None], len(left), axis=0)])
    cell, cell_before = _common(cells, earlier.cells)
    column, column_before = _common(now.columns, earlier.columns)
    never_asked = ~earlier.unseen[column_before]
    words[np.ix_(cell, column)] &= earlier.words[np.ix_(cell_before, column_before)] | never_asked
    return replace(now, cells=cells, words=words)


def _common(a: NDArray[np.int64], b: NDArray[np.int64]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Where rows ``(N, 2)`` of both are equal: indices into either."""
    _, first, second = np.intersect1d(_keys(a), _keys(b), assume_unique=True, return_indices=True)
    return first, second


def _keys(rows: NDArray[np.int64]) -> NDArray[np.int64]:
    return rows[:, 0] * 2**32 + rows[:, 1]
