"""The fence that an operator draws around the start: a line that the robot's middle does not cross."""

from collections.abc import Sequence

import numpy as np
import shapely

from perception import transforms
from perception.findings import Polygon
from perception.transforms import Matrix

Vertices = Sequence[tuple[float, float]]
"""Where the robot stands when the mission begins: x ahead of it and y to its left, metres."""


def check(vertices: Vertices) -> None:
    """Raises ValueError unless the vertices go once around the start, without crossing their own line."""
    if len(vertices) < 3:
        raise ValueError(f"a fence has at least 3 corners, found {len(vertices)}")
    ring = shapely.Polygon(vertices)
    if not ring.is_valid or ring.area == 0.0:
        raise ValueError("the fence crosses or touches itself")
    if not ring.contains(shapely.Point(0.0, 0.0)):
        raise ValueError("the start, (0, 0), must lie inside the fence")


def in_map(vertices: Vertices, map_from_start: Matrix) -> Polygon:
    """The fence in the map frame; ``map_from_start`` is the 4x4 pose of the base when the mission began."""
    corners = np.column_stack([np.asarray(vertices, float), np.zeros(len(vertices))])
    return transforms.apply(map_from_start, corners)[:, :2].astype(np.float64)
