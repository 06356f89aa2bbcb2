"""Search over cells and headings: compiled, for it looks at hundreds of thousands of poses."""

import heapq

import numpy as np
from numba import njit
from numpy.typing import NDArray

from drivers.simulated.footprint import covers_any

HEADINGS = 32
TURN_LEFT, TURN_RIGHT, FORWARD, FORWARD_LEFT, FORWARD_RIGHT, BACKWARD = range(6)
_TURN_COST, _BEND_COST, _BACKWARD_FACTOR = 0.2, 0.05, 2.0
_STRAIN_FACTOR = 2.2
_BLOCKED = 100
_MAX_OFFSET = 5


def headings() -> NDArray[np.float64]:
    """Angle of each heading index, radians."""
    return np.arange(HEADINGS, dtype=np.float64) * (2 * np.pi / HEADINGS)


def strides() -> NDArray[np.int64]:
    """Cell step (row, column) ``(HEADINGS, 2)`` that goes best along each heading."""
    reach = np.arange(-_MAX_OFFSET, _MAX_OFFSET + 1)
    rows, columns = (axis.ravel() for axis in np.meshgrid(reach, reach, indexing="ij"))
    length = np.hypot(rows, columns)
    usable = length > 0
    rows, columns, length = rows[usable], columns[usable], length[usable]
    error = np.abs(np.angle(np.exp(1j * (np.arctan2(rows, columns)[None, :] - headings()[:, None]))))
    # Among steps of equal direction the shortest.
    best = np.argmin(np.round(error, 6) + 1e-4 * length, axis=1)
    return np.stack([rows[best], columns[best]], axis=1)


@njit(cache=True)
def cost_to_go(
    price: NDArray[np.float32], clearance: NDArray[np.float32], inscribed: float, goal: tuple[int, int]
) -> NDArray[np.float32]:
    """Cost (in metres times price) from each cell to the goal for a disc of radius ``inscribed``, inf where none."""
    rows, columns = price.shape
    cost = np.full((rows, columns), np.inf, np.float32)
    cost[goal] = 0.0
    heap = [(np.float32(0.0), goal[0] * columns + goal[1])]
    while heap:
        spent, index = heapq.heappop(heap)
        row, column = index // columns, index % columns
        if spent > cost[row, column]:
            continue
        for dr in range(-1, 2):
            for dc in range(-1, 2):
                r, c = row + dr, column + dc
                if r < 0 or c < 0 or r >= rows or c >= columns or clearance[r, c] < inscribed:
                    continue
                step = np.float32(np.sqrt(dr * dr + dc * dc)) * (price[row, column] + price[r, c]) / np.float32(2.0)
                if spent + step < cost[r, c]:
                    cost[r, c] = spent + step
                    heapq.heappush(heap, (cost[r, c], r * columns + c))
    return cost


@njit(cache=True)
def footprint_free(
    row: int,
    column: int,
    angle: float,
    half_length: float,
    half_width: float,
    obstacle: NDArray[np.bool_],
    clearance: NDArray[np.float32],
    resolution: float,
) -> bool:
    """Whether no obstacle cell's centre lies in the rectangle round a cell's centre (metres); False off the grid."""
    rows, columns = obstacle.shape
    if row < 0 or column < 0 or row >= rows or column >= columns:
        return False
    space = clearance[row, column]
    if space < min(half_length, half_width):
        return False
    if space > np.hypot(half_length, half_width):
        return True
    x, y = (column + 0.5) * resolution, (row + 0.5) * resolution
    return not covers_any(obstacle, x, y, angle, half_length, half_width, resolution)


@njit(cache=True)
def _tightness(
    row: int,
    column: int,
    angle: float,
    half: tuple[float, float],
    margins: NDArray[np.float64],
    obstacle: NDArray[np.bool_],
    clearance: NDArray[np.float32],
    resolution: float,
) -> int:
    """How many of the margins, widest first, do not fit round the footprint at a pose."""
    for i in range(len(margins)):
        length, width = half[0] + margins[i], half[1] + margins[i]
        if footprint_free(row, column, angle, length, width, obstacle, clearance, resolution):
            return i
    return len(margins)


@njit(cache=True)
def search(
    start: tuple[int, int, int],
    goal: tuple[int, int],
    goal_heading: int,
    angles: NDArray[np.float64],
    stride: NDArray[np.int64],
    half: tuple[float, float],
    margins: NDArray[np.float64],
    escape_radius: float,
    obstacle: NDArray[np.bool_],
    clearance: NDArray[np.float32],
    price: NDArray[np.float32],
    to_go: NDArray[np.float32],
    resolution: float,
    cost: NDArray[np.float32],
    came: NDArray[np.int8],
    tight: NDArray[np.int8],
    max_expansions: int,
) -> NDArray[np.int64]:
    """A* from a pose to a cell; the rows (row, column, heading, move that led there), empty if there is no way.

    Args:
        start: (row, column, heading index).
        goal_heading: heading index to end with, or -1 for any.
        half: half length and half width of the footprint, metres.
        margins: space round it, metres, from the comfortable one to the one that must be; the fewer of them fit, the
            dearer.
        escape_radius: distance from the start within which no margin need fit, for the robot may stand closer to
            something than it would ever go.
        cost, came, tight: zeros, one per cell and heading; 0 stands for "not reached" and "not looked at".
    """
    rows, columns = obstacle.shape
    count = len(angles)
    first = (start[0] * columns + start[1]) * count + start[2]
    cost[first] = 1e-6
    tried = np.append(margins, 0.0)
    heap = [(to_go[start[0], start[1]] * np.float32(resolution), first)]
    expansions = 0
    while heap and expansions < max_expansions:
        estimate, state = heapq.heappop(heap)
        heading = state % count
        row, column = (state // count) // columns, (state // count) % columns
        if estimate > cost[state] + to_go[row, column] * np.float32(resolution) + np.float32(1e-4):
            continue  # was reached at a lower cost meanwhile
        expansions += 1
        if row == goal[0] and column == goal[1] and (goal_heading < 0 or heading == goal_heading):
            return _trace(state, first, came, stride, columns, count)
        for move in range(6):
            r, c, h, steps = row, column, heading, 1
            sign = -1 if move == BACKWARD else 1
            if move in (TURN_LEFT, FORWARD_LEFT):
                h = (heading + 1) % count
            elif move in (TURN_RIGHT, FORWARD_RIGHT):
                h = (heading - 1) % count
            if move >= FORWARD:
                dr, dc = sign * stride[heading, 0], sign * stride[heading, 1]
                r, c, steps = row + dr, column + dc, max(abs(dr), abs(dc))
                if r < 0 or c < 0 or r >= rows or c >= columns:
                    continue
            if not np.isfinite(to_go[r, c]):
                continue
            after = (r * columns + c) * count + h
            if move >= FORWARD:
                step = resolution * np.hypot(r - row, c - column) * (price[row, column] + price[r, c]) / 2
                if move == BACKWARD:
                    step *= _BACKWARD_FACTOR
                elif move != FORWARD:
                    step += _BEND_COST
            else:
                step = _TURN_COST
            if cost[after] != 0.0 and cost[state] + step >= cost[after]:
                continue
            tightness = 0
            for k in range(1, steps + 1):
                rk = row + int(np.rint((r - row) * k / steps))
                ck = column + int(np.rint((c - column) * k / steps))
                hk = h if 2 * k > steps else heading
                pose = (rk * columns + ck) * count + hk
                if tight[pose] == 0:
                    tight[pose] = 1 + _tightness(rk, ck, angles[hk], half, tried, obstacle, clearance, resolution)
                tightness = max(tightness, tight[pose] - 1)
                escaping = np.hypot(rk - start[0], ck - start[1]) * resolution < escape_radius
                if tightness > len(margins) or (tightness == len(margins) and not escaping):
                    tightness = _BLOCKED
                    break
            if tightness == _BLOCKED:
                continue
            total = np.float32(cost[state] + step * _STRAIN_FACTOR**tightness)
            if cost[after] == 0.0 or total < cost[after]:
                cost[after] = total
                came[after] = move + 1
                heapq.heappush(heap, (np.float32(total + to_go[r, c] * resolution), after))
    return np.empty((0, 4), np.int64)


@njit(cache=True)
def _trace(
    state: int, first: int, came: NDArray[np.int8], stride: NDArray[np.int64], columns: int, count: int
) -> NDArray[np.int64]:
    """Walk back from the goal to the start by the moves that led there."""
    found = [(0, 0, 0, 0)]
    found.clear()
    while True:
        heading = state % count
        row, column = (state // count) // columns, (state // count) % columns
        if state == first:
            found.append((row, column, heading, -1))
            break
        move = came[state] - 1
        found.append((row, column, heading, move))
        if move in (TURN_LEFT, FORWARD_LEFT):
            heading = (heading - 1) % count
        elif move in (TURN_RIGHT, FORWARD_RIGHT):
            heading = (heading + 1) % count
        if move >= FORWARD:
            sign = -1 if move == BACKWARD else 1
            row -= sign * stride[heading, 0]
            column -= sign * stride[heading, 1]
        state = (row * columns + column) * count + heading
    path = np.empty((len(found), 4), np.int64)
    for i in range(len(found)):
        path[len(found) - 1 - i] = found[i]
    return path
