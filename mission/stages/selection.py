"""Which scans a stage looks at: of a long mission not all, or the last room would take longer than the first."""

import numpy as np
import shapely

from mission.stages.scan_library import PlacedScans

MOST = 10
"""Scans that a room is made of at once."""
_AT_DOOR = 1.5
"""A station this near to the room's contour stands in it or in one of its doors, metres."""


def of_room(scans: PlacedScans, place: shapely.Geometry, most: int = MOST) -> PlacedScans:
    """At most so many of the scans, in their order: the newest, then those in the room, then those nearest to it.

    Of more than enough in the room the next one is always that which stands farthest from those chosen, so that every
    part of a long corridor has been looked at from near by.

    Args:
        scans: that can have seen into the room.
        place: the room's contour as far as it is known, or a point in it.
        most: number of scans.
    """
    if len(scans) <= most:
        return scans
    stations = np.array([np.asarray(pose)[:2, 3] for _, pose in scans])
    away = shapely.distance(place, shapely.points(stations))
    chosen = [len(scans) - 1]
    inside = np.flatnonzero(away < _AT_DOOR)
    while len(chosen) < min(most, len(np.union1d(inside, chosen))):
        apart = np.linalg.norm(stations[inside][:, None] - stations[chosen][None], axis=2).min(axis=1)
        chosen.append(int(inside[apart.argmax()]))
    outside = [int(n) for n in np.argsort(away, kind="stable") if n not in chosen]
    return [scans[n] for n in sorted([*chosen, *outside[: most - len(chosen)]])]
