"""Which scans a stage looks at: of a long mission not all, or the last room would take longer than the first."""

import numpy as np
import shapely
from numpy.typing import NDArray

from mission.stages.scan_library import PlacedScans

MOST = 10
"""Scans that a room is made of at once."""
ENOUGH = 6
"""So many are taken if need be from next door: through a door they show little of a room that has scans of its own."""
_AT_DOOR = 1.5
"""A station this near to the room's contour stands in it or in one of its doors, metres."""


def of_room(scans: PlacedScans, place: shapely.Geometry, most: int = MOST, enough: int = ENOUGH) -> PlacedScans:
    """Some of the scans, in their order: the newest, those in the room, and if they are few those nearest to it.

    Of more than ``most`` in the room the next one is always that which stands farthest from those chosen, so that
    every part of a long corridor has been looked at from near by.

    Args:
        scans: that can have seen into the room.
        place: the room's contour as far as it is known, or a point in it.
        most: number of scans.
        enough: number of scans up to which others than the room's are taken.
    """
    if len(scans) <= enough:
        return scans
    stations, away = _stations(scans, place)
    chosen = [len(scans) - 1]
    inside = np.flatnonzero(away < _AT_DOOR)
    while len(chosen) < min(most, len(np.union1d(inside, chosen))):
        apart = np.linalg.norm(stations[inside][:, None] - stations[chosen][None], axis=2).min(axis=1)
        chosen.append(int(inside[apart.argmax()]))
    outside = [int(n) for n in np.argsort(away, kind="stable") if n not in chosen]
    return [scans[n] for n in sorted([*chosen, *outside[: max(0, enough - len(chosen))]])]


def taken_in(scans: PlacedScans, place: shapely.Geometry) -> set[str]:
    """Names of the scans that were taken in a room or in one of its doors."""
    return {name for (name, _), away in zip(scans, _stations(scans, place)[1], strict=True) if away < _AT_DOOR}


def _stations(scans: PlacedScans, place: shapely.Geometry) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(x, y) of each station ``(S, 2)``, and its distance from a place."""
    stations = np.array([np.asarray(pose)[:2, 3] for _, pose in scans])
    return stations, np.asarray(shapely.distance(place, shapely.points(stations)))
