"""Points of the cloud P(t), and the stations that they were seen from: what a point says depends on who saw it."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Views:
    """Points ``(N, 3)`` of any one frame, and where they were seen from, if known.

    Args:
        points: in the order of their stations.
        stations: ``(S, 3)``, of the same frame.
        station_of: ``(N,)`` row of ``stations``, ascending.
    """

    points: NDArray[np.floating]
    stations: NDArray[np.floating] | None = None
    station_of: NDArray[np.integer] | None = None

    def of(self, station: int) -> NDArray[np.floating]:
        """The points seen from one station; all of them if that is not known."""
        if self.station_of is None:
            return self.points
        first, last = np.searchsorted(self.station_of, [station, station + 1])
        return self.points[first:last]

    def subset(self, mask: NDArray[np.bool_]) -> "Views":
        rows = None if self.station_of is None else self.station_of[mask]
        return Views(self.points[mask], self.stations, rows)

    def moved(self, change: Callable[[NDArray[np.floating]], NDArray[np.floating]]) -> "Views":
        """The same in another frame; ``change`` maps ``(N, 3)`` to ``(N, 3)``."""
        stations = None if self.stations is None else change(self.stations)
        return Views(change(self.points), stations, self.station_of)
