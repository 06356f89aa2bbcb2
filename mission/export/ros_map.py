"""The robot map as a ROS ``map_server`` pair: an image and its description."""

from pathlib import Path

import cv2
import numpy as np
import yaml

from mission.store import whole_file, write_text
from perception.failure import FailureError
from perception.grids import Cell, Grid

_GREY = {Cell.FREE: 254, Cell.OBSTACLE: 0, Cell.UNKNOWN: 205}
_OCCUPIED, _FREE = 0.65, 0.196


def write_ros_map(grid: Grid, stem: Path) -> tuple[Path, Path]:
    """Write ``<stem>.pgm`` and ``<stem>.yaml``; black is an obstacle, as in the paper's figures.

    Args:
        grid: robot map of :class:`~perception.grids.Cell`.
        stem: path without a suffix.

    Returns:
        Paths of the image and of its description.
    """
    image, description = Path(f"{stem}.pgm"), Path(f"{stem}.yaml")
    shades = np.array([_GREY[cell] for cell in Cell], np.uint8)
    # The image's first row is its top, the grid's first row is the lowest y.
    encoded = cv2.imencode(".pgm", np.ascontiguousarray(shades[grid.data.astype(np.intp)][::-1]))[1]
    with whole_file(image) as partial:
        partial.write_bytes(encoded.tobytes())
    fields = {
        "image": image.name,
        "mode": "trinary",
        "resolution": float(grid.resolution),
        "origin": [float(grid.origin[0]), float(grid.origin[1]), 0.0],
        "negate": 0,
        "occupied_thresh": _OCCUPIED,
        "free_thresh": _FREE,
    }
    write_text(description, yaml.safe_dump(fields, sort_keys=False))
    return image, description


def read_ros_map(description: Path) -> Grid:
    """Read a ``map_server`` description and its image, by its own thresholds.

    Raises:
        FailureError: ``MAP_UNREADABLE`` if the pair is not there, or is turned by a yaw.
    """
    try:
        fields = yaml.safe_load(description.read_text())
        data = np.frombuffer((description.parent / fields["image"]).read_bytes(), np.uint8)
        x, y, yaw = fields["origin"]
        resolution = float(fields["resolution"])
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise FailureError("MAP_UNREADABLE", f"{description} describes no map: {error}") from error
    image = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise FailureError("MAP_UNREADABLE", f"{fields['image']} is no image")
    if yaw:
        raise FailureError("MAP_UNREADABLE", f"{description} is turned by {yaw} rad; only level maps are read", yaw=yaw)
    brightness = image[::-1] / 255.0
    occupancy = brightness if fields.get("negate") else 1.0 - brightness
    cells = np.full(occupancy.shape, Cell.UNKNOWN, np.uint8)
    cells[occupancy > fields.get("occupied_thresh", _OCCUPIED)] = Cell.OBSTACLE
    cells[occupancy < fields.get("free_thresh", _FREE)] = Cell.FREE
    return Grid(cells, (float(x), float(y)), resolution)
