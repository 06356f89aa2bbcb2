"""What each stage reports: small values of poses and figures that travel between processes and into the journal."""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from perception.transforms import Matrix

Polygon = NDArray[np.float64]
"""``(N, 2)`` vertices in the map frame, metres, counter-clockwise, not closed."""


@dataclass(frozen=True)
class Alignment:
    """Result of section 3.1: how the scanner stood.

    Args:
        level_from_scanner: 4x4; the level frame has z up, the floor at z = 0 and the scanner over its origin.
        roll, pitch: the tilt that was removed, radians.
        scanner_height: above the floor, metres.
        ceiling_z: height of the ceiling over the floor, metres.
        wall_yaw: direction of the dominant walls in the level frame, radians in [-pi/4, pi/4).
        peak_share: share of the points in the highest bin of the Z-histogram.
    """

    level_from_scanner: Matrix
    roll: float
    pitch: float
    scanner_height: float
    ceiling_z: float
    wall_yaw: float
    peak_share: float


@dataclass(frozen=True)
class Registration:
    """Result of section 5: where a scan was taken, and how sure that is.

    Args:
        map_from_scanner: 4x4.
        fitness: share of source points with a partner within the last correspondence distance.
        rmse: root mean square point-to-plane distance of those pairs, metres.
        overlap: share of source points within 10 cm of the reference.
        min_eigenvalue: smallest eigenvalue of the mean of n n^T over the pairs' normals (1/3 is best, 0 slides).
        weak_axis: its eigenvector, the direction that the pairs do not hold.
        correction_m, correction_rad: distance and angle from the guess to the result.
        method: ``anchor`` (first scan), ``icp`` or ``global``.
        conflict: share of the surface that both sides could test which one of them saw through.
        turn_hold: how well the pairs hold the turn that they hold least, 0 where the scan turns freely.
        turn_axis: the axis of that turn.
    """

    map_from_scanner: Matrix
    fitness: float
    rmse: float
    overlap: float
    min_eigenvalue: float
    weak_axis: tuple[float, float, float]
    correction_m: float
    correction_rad: float
    method: str
    conflict: float = 0.0
    turn_hold: float = 1.0
    turn_axis: tuple[float, float, float] = (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class PoseAdjustment:
    """Result of the building's pose graph: where all scans together say that each was taken.

    Args:
        poses: ``map_from_scanner`` by scan id; the old ones where ``reason`` says why they were kept.
        residuals: of each scan that was compared, the root mean square distance of its surface from that of the
            scans it shares surface with, metres.
        compared: pairs of scans that were compared and fitted.
        disbelieved: those of them that contradicted the others.
        rms_before, rms_after: how far the poses were, and are, from what the pairs want, metres.
        moved_m: how far the scan moved that moved furthest, metres.
        reason: why the poses were left as they were; empty when they were not.
        refused: pairs that did not fit, with the code of the refusal.
    """

    poses: Mapping[str, Matrix]
    residuals: Mapping[str, float]
    compared: int
    disbelieved: tuple[tuple[str, str], ...]
    rms_before: float
    rms_after: float
    moved_m: float
    reason: str = ""
    refused: tuple[tuple[str, str, str], ...] = ()


@dataclass(frozen=True)
class RoomShape:
    """Result of section 3.1 for one room: contour ``H`` and the interval between floor and ceiling.

    Args:
        contour: polygon of the room's ceiling, map frame.
        floor_z, ceiling_z: metres, map frame.
        walls: one row (x0, y0, x1, y1) per straight wall segment, interior on its left.
    """

    contour: Polygon
    floor_z: float
    ceiling_z: float
    walls: NDArray[np.float64]

    @property
    def area(self) -> float:
        """Area inside the contour, square metres."""
        x, y = self.contour[:, 0], self.contour[:, 1]
        return 0.5 * abs(float(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))))


@dataclass(frozen=True)
class Movement:
    """What stands in a scan where an earlier one saw that nothing was: people, carts, a door that was moved.

    Args:
        share: of the scan's points.
        place: (x, y) in the midst of them, map frame; None where there are none.
    """

    share: float
    place: tuple[float, float] | None


@dataclass(frozen=True)
class LabelCounts:
    """Voxels of a room by label after a cycle (Table 1): total is V, occupied + empty is V_s."""

    occupied: int
    empty: int
    occluded: int

    @property
    def seen(self) -> int:
        return self.occupied + self.empty

    @property
    def total(self) -> int:
        return self.seen + self.occluded


@dataclass(frozen=True)
class Candidate:
    """A position that meets the three requirements of section 4.2, with what a scan there would show.

    Args:
        x, y: map frame, metres.
        gain: occluded voxels that would become visible.
        path_length: along the labelled map from the current position, metres.
    """

    x: float
    y: float
    gain: int
    path_length: float


@dataclass(frozen=True)
class ViewChoice:
    """Result of section 4.2: the best candidates first (at most 20), and how many there were in all."""

    best: tuple[Candidate, ...]
    candidates: int


@dataclass(frozen=True)
class Door:
    """An open passage in a wall of a room (section 2).

    Args:
        x, y: centre of the net width on the wall plane, map frame.
        normal: (nx, ny), out of the room it was found from.
        width: clear width between the jambs, metres.
        net_width: what an opened leaf leaves of it, metres.
        height: of the opening, metres.
        confidence: share of the observable cells of the opening that beams passed through.
        thickness: of the wall where both faces were seen, else a nominal value, metres.
    """

    x: float
    y: float
    normal: tuple[float, float]
    width: float
    net_width: float
    height: float
    confidence: float
    thickness: float = 0.15


@dataclass(frozen=True)
class DoorFindings:
    """Doors found in a room, openings that were turned down with the gate that did it, and those to look at closer."""

    doors: tuple[Door, ...]
    refused: tuple[tuple[Door, str], ...] = field(default=())
    suspects: tuple[Door, ...] = field(default=())
