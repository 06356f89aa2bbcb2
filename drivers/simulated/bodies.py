"""People and carts: upright bodies that walk along timed tracks."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Annotated, Literal

import msgspec
import numpy as np
import shapely
from shapely import affinity


@dataclass(frozen=True)
class Body:
    """An upright cylinder (``width`` is its diameter) or box standing on the floor at (x, y, yaw), metres."""

    x: float
    y: float
    yaw: float = 0.0
    length: float = 0.5
    width: float = 0.5
    height: float = 1.75
    round: bool = True

    def outline(self) -> shapely.Polygon:
        """What it covers of the floor."""
        if self.round:
            return shapely.Point(self.x, self.y).buffer(self.width / 2, quad_segs=6)
        box = shapely.box(-self.length / 2, -self.width / 2, self.length / 2, self.width / 2)
        turned = affinity.rotate(box, self.yaw, origin=(0, 0), use_radians=True)
        return affinity.translate(turned, self.x, self.y)


SHAPES = {
    "person": Body(0.0, 0.0),
    "cart": Body(0.0, 0.0, length=0.8, width=0.5, height=1.0, round=False),
}


class Track(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Where a person or cart goes: waypoints (t, x, y) in simulated seconds and metres, straight in between.

    It is not there before the first waypoint nor after the last; to stay, give a last waypoint far in the future.
    """

    waypoints: Annotated[tuple[tuple[float, float, float], ...], msgspec.Meta(min_length=1)]
    kind: Literal["person", "cart"] = "person"

    def at(self, time: float) -> Body | None:
        """The body at a time, facing where it walks."""
        t, x, y = np.asarray(self.waypoints, float).T
        if not t[0] <= time <= t[-1]:
            return None
        leg = min(int(np.searchsorted(t, time, side="right")), len(t) - 1)
        yaw = float(np.arctan2(y[leg] - y[leg - 1], x[leg] - x[leg - 1])) if leg else 0.0
        shape = SHAPES[self.kind]
        place = float(np.interp(time, t, x)), float(np.interp(time, t, y))
        return Body(*place, yaw, shape.length, shape.width, shape.height, shape.round)


def standing(tracks: Iterable[Track], time: float) -> tuple[Body, ...]:
    """All bodies that are in the building at a time."""
    return tuple(body for track in tracks if (body := track.at(time)) is not None)
