"""The leaf of a door, and what it leaves of the opening to the robot."""

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from drivers.simulated.world import DoorState

LEAF_THICKNESS = 0.04
ROBOT_DISC = 0.72
"""Diameter of the disc that stands for the robot when a door is called passable, metres."""
FLOOR_GAP = 0.01

Vector = NDArray[np.float64]


@dataclass(frozen=True)
class Leaf:
    """A leaf that is hinged at the room's face of the wall and opens into the room.

    Args:
        hinge: (x, y) of the jamb's edge on the face of the wall.
        across: unit vector from the hinge to the other jamb.
        inwards: unit vector into the room the leaf opens into.
        opening: clear width between the jambs, metres.
        thickness: of the wall, metres.
        width: of the leaf, metres; 0 when there is none.
        angle: how far it stands open, radians.
    """

    hinge: Vector
    across: Vector
    inwards: Vector
    opening: float
    thickness: float
    width: float
    angle: float

    @property
    def footprint(self) -> shapely.Polygon:
        """The leaf seen from above; shut, it lies within the reveal."""
        along = self.across * np.cos(self.angle) + self.inwards * np.sin(self.angle)
        depth = self.across * np.sin(self.angle) - self.inwards * np.cos(self.angle)
        tip, back = along * self.width, depth * LEAF_THICKNESS
        return shapely.Polygon([self.hinge, self.hinge + tip, self.hinge + tip + back, self.hinge + back])

    @property
    def state(self) -> DoorState:
        """Open from 70 degrees on, shut below 15."""
        if self.width == 0 or self.angle >= np.deg2rad(70):
            return DoorState.OPEN
        return DoorState.HALF if self.angle >= np.deg2rad(15) else DoorState.SHUT

    @property
    def net_width(self) -> float:
        """What is left to a straight passage across the wall, metres."""
        if self.width == 0:
            return self.opening
        if self.state is DoorState.SHUT:
            return 0.0
        corners = np.array(self.footprint.exterior.coords) - self.hinge
        return float(np.clip(self.opening - np.max(corners @ self.across), 0.0, self.opening))

    @property
    def clearance(self) -> float:
        """Diameter of the largest disc that passes between the leaf and the other jamb, metres."""
        if self.width == 0:
            return self.opening
        if self.state is DoorState.SHUT:
            return 0.0
        jamb = self.hinge + self.across * self.opening
        reveal = shapely.LineString([jamb, jamb - self.inwards * self.thickness])
        return min(self.opening, float(self.footprint.distance(reveal)))

    @property
    def passable(self) -> bool:
        return self.clearance >= ROBOT_DISC
