"""What lies under a rectangle that stands anywhere, at any angle, on a raster."""

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True)
def covers_any(
    raster: NDArray, x: float, y: float, yaw: float, half_length: float, half_width: float, cell: float
) -> bool:
    """Whether a set cell's centre lies in the rectangle round (x, y), metres from the raster's lower-left corner."""
    cos, sin = np.cos(yaw), np.sin(yaw)
    reach_x = half_length * abs(cos) + half_width * abs(sin)
    reach_y = half_length * abs(sin) + half_width * abs(cos)
    rows, columns = raster.shape
    for row in range(max(0, int((y - reach_y) / cell)), min(rows, int((y + reach_y) / cell) + 1)):
        dy = (row + 0.5) * cell - y
        for column in range(max(0, int((x - reach_x) / cell)), min(columns, int((x + reach_x) / cell) + 1)):
            if raster[row, column]:
                dx = (column + 0.5) * cell - x
                if abs(cos * dx + sin * dy) <= half_length and abs(cos * dy - sin * dx) <= half_width:
                    return True
    return False
