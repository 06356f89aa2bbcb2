"""Two rooms with a wall and a doorway between them, for the tests of contour and robot map."""

import numpy as np

from perception import transforms
from perception.scan import BeamPattern
from tests.synthetic import Scene, box

PATTERN = BeamPattern.with_step(np.deg2rad(0.6), (np.deg2rad(-40), np.deg2rad(60)), (1.5, 120.0))
ROOM_A = [(0, 0), (6, 0), (6, 5), (0, 5)]
ROOM_B = [(6.15, 0), (11, 0), (11, 5), (6.15, 5)]
DOOR = (2.0, 2.9)

CABINET = box((1, 4.55, 0), (3, 4.99, 1.9))
CURTAIN = box((0.15, 0.8, 0.1), (0.2, 2.2, 2.7))
TABLE = box((2, 1, 0.70), (3.4, 1.8, 0.74))
LAMP = box((2.4, 3.4, 2.75), (3.6, 3.6, 2.85))
BEAM = box((4.3, 0, 2.7), (4.5, 5, 3.0))
LOWERED = box((0, 3.2, 2.6), (1.2, 5, 3.0))
FURNITURE = (CABINET, CURTAIN, TABLE, LAMP, BEAM, LOWERED)


def two_rooms(*extra, height=3.0, lintel=True, door=DOOR, ceiling=True):
    """Room A on the left of the wall x = 6.00..6.15, room B on its right."""
    parts = [box((-0.3, -0.3, -0.2), (11.3, 5.3, 0))]
    parts += [box((-0.2, -0.2, 0), (11.2, 0, height)), box((-0.2, 5, 0), (11.2, 5.2, height))]
    parts += [box((-0.2, -0.2, 0), (0, 5.2, height)), box((11, -0.2, 0), (11.2, 5.2, height))]
    parts += [box((6, 0, 0), (6.15, door[0], height)), box((6, door[1], 0), (6.15, 5, height))]
    if lintel:
        parts.append(box((6, door[0], 2.05), (6.15, door[1], height)))
    if ceiling:
        parts.append(box((-0.3, -0.3, height), (11.3, 5.3, height + 0.2)))
    return Scene(*parts, *extra)


def survey(scene, *places, pattern=PATTERN):
    """Points of scans at (x, y), the stations ``(S, 3)`` and the station of each point; map frame."""
    stations = np.array([(x, y, 1.3) for x, y in places])
    clouds = []
    for index, station in enumerate(stations):
        pose = transforms.from_euler(0, 0, 0.3 * index, station)
        clouds.append(transforms.apply(pose, scene.take(pose, pattern, seed=index).points))
    return np.concatenate(clouds), stations, np.repeat(np.arange(len(clouds)), [len(cloud) for cloud in clouds])
