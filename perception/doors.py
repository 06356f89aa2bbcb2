"""Open doors in the walls of a room (paper section 2) by what the beams did at the planes of the walls.

A door is a hole that reaches the floor, has jambs and goes on: floor at the same height behind it, room to stand, and
a gap that the robot fits through. Windows, niches, cupboards, mirrors and steps each fail a gate that has their name.
"""

from collections.abc import Sequence
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from perception import transforms
from perception.building import before, beyond, door_pose
from perception.findings import Door, DoorFindings, RoomShape
from perception.openings import (
    AROUND,
    LOW,
    TOP,
    DoorGates,
    Opening,
    columns_of,
    guessed,
    half_hidden,
    holes,
    measured,
    thickness_of,
)
from perception.passage import passage
from perception.rays.wall_evidence import CELL, Beam, gather, local_points, walls_of
from perception.scan import Scan
from perception.transforms import Matrix
from perception.views import Views

__all__ = ["DoorGates", "before", "beyond", "door_pose", "find_doors"]

_USUAL = DoorGates()

UNVERIFIED = "depth"
"""The last gate: all else speaks for a door, but from where the scans were nobody saw that it leads anywhere."""
HIDDEN = "hidden"
"""Beams passed to the floor in a strip too narrow for a door, but what hides the wall beside it may be its leaf."""


def find_doors(
    shape: RoomShape,
    scans: Sequence[tuple[Scan, Matrix]],
    robot_width: float = 0.6,
    gates: DoorGates = _USUAL,
) -> DoorFindings:
    """Find the open doors of a room.

    Args:
        shape: contour, floor, ceiling and walls of the room; the walls may be 10 cm off.
        scans: every scan near the room with its ``map_from_scanner``; evidence adds up over them.
        robot_width: metres that an opened leaf must leave; a narrower door is refused as ``narrow``.

    Returns:
        The doors; the door-like holes that failed, each with the name of the gate; and of those the suspects, which
        a scan from nearby would decide.
    """
    ranges = [scan.range_image() for scan, _ in scans]
    cloud = _surroundings(shape, scans)
    doors: list[Door] = []
    refused: list[tuple[Door, str]] = []
    for wall in walls_of(shape, cloud.points[:: max(1, len(cloud.points) // 200_000)]):
        evidence = gather(wall, scans, ranges)
        views: Views | None = None
        columns = columns_of(evidence, gates)
        refused += [(guessed(wall, evidence, part), HIDDEN) for part in half_hidden(columns, evidence, gates)]
        for left, right in holes(columns, gates):
            if views is None:
                views = cloud.moved(partial(local_points, wall))
                deeper = gather(wall.moved(gates.free_depth), scans, ranges)
            opening = measured(wall, evidence, deeper, left, right, views)
            door, gate = _judge(opening, robot_width, gates)
            if gate is None:
                doors.append(door)
            else:
                refused.append((door, gate))
    suspects = tuple(door for door, gate in refused if gate in (UNVERIFIED, HIDDEN))
    return DoorFindings(tuple(doors), tuple(refused), suspects)


def _surroundings(shape: RoomShape, scans: Sequence[tuple[Scan, Matrix]]) -> Views:
    """All points between a little below the floor and the ceiling, in and around the room, map frame."""
    low, high = shape.contour.min(axis=0) - AROUND, shape.contour.max(axis=0) + AROUND
    clouds = []
    for scan, map_from_scanner in scans:
        points = transforms.apply(map_from_scanner, scan.points)
        inside = np.all((points[:, :2] > low) & (points[:, :2] < high), axis=1)
        clouds.append(points[inside & (points[:, 2] > shape.floor_z - 1.0) & (points[:, 2] < shape.ceiling_z)])
    stations = np.array([map_from_scanner[:3, 3] for _, map_from_scanner in scans], np.float32)
    # Small numbers, for there are tens of millions of them.
    station_of = np.repeat(np.arange(len(clouds), dtype=np.int16), [len(cloud) for cloud in clouds])
    return Views(np.concatenate(clouds), stations, station_of)


def _judge(opening: Opening, robot_width: float, gates: DoorGates) -> tuple[Door, str | None]:
    """The opening as a door, and the first gate that it fails."""
    wall = opening.wall
    thickness = thickness_of(opening)
    way = passage(opening.within(0.08, 1.4)[:, :2], opening.left, opening.right, thickness)
    x, y = wall.at(way.centre)
    rows = slice(LOW, min(TOP, round(opening.height / CELL)))
    inner_rows = slice(rows.start + 1, rows.stop - 2)
    fill = opening.evidence.share((opening.columns, rows), Beam.OPEN)
    door = Door(
        x=float(x),
        y=float(y),
        normal=(float(wall.outward[0]), float(wall.outward[1])),
        width=opening.right - opening.left,
        net_width=way.clearance,
        height=opening.height,
        confidence=0.0 if np.isnan(fill) else fill,
        thickness=thickness,
    )
    ground = _ground_behind(opening)
    checks = {
        "width": gates.min_width <= door.width <= gates.max_width,
        "height": _height_fits(opening, gates),
        "sill": _reaches_floor(opening),
        "glass": opening.evidence.echoes((opening.inner_columns, inner_rows)) < gates.glass,
        "fill": door.confidence >= gates.fill,
        "jambs": _jambs_stand(opening, gates),
        "floor": ground is None or abs(ground) <= gates.floor_step,
        "narrow": door.net_width >= robot_width,
        "mirror": not _is_mirror(opening, gates),
        UNVERIFIED: ground is not None and _goes_on(opening, gates),
    }
    return door, next((gate for gate, passed in checks.items() if not passed), None)


def _height_fits(opening: Opening, gates: DoorGates) -> bool:
    to_ceiling = opening.height > opening.wall.ceiling_z - opening.wall.floor_z - 0.15
    return opening.height >= gates.min_height and (opening.height <= gates.max_height or to_ceiling)


def _reaches_floor(opening: Opening) -> bool:
    """Beams passed between 15 and 50 cm over the floor wherever they got there, and got there at all."""
    share = opening.evidence.share((opening.columns, slice(LOW, round(0.5 / CELL))), Beam.OPEN)
    return bool(share > 0.5)


def _jambs_stand(opening: Opening, gates: DoorGates) -> bool:
    """The wall on both sides of the hole is solid; one side may have gone untested, nearer than the minimum range."""
    solid = [_jamb_solidity(opening, side) for side in (-1, 1)]
    tested = [share for share in solid if not np.isnan(share)]
    return bool(tested and min(tested) >= gates.jamb)


def _jamb_solidity(opening: Opening, side: int) -> float:
    """Share of the wall beside the hole that threw beams back; 1 in the room's corner, NaN where no beam tested it."""
    columns = opening.columns
    near = slice(columns.start - 4, columns.start - 1) if side < 0 else slice(columns.stop + 1, columns.stop + 4)
    if near.start < 0 or near.stop > opening.evidence.counts.shape[1]:
        return 1.0
    return opening.evidence.share((near, slice(LOW, None)), Beam.SOLID)


def _ground_behind(opening: Opening) -> float | None:
    """Height of the ground behind the hole, up to 1.5 m deep, over the floor, metres; None where nobody saw it."""
    low = opening.within(-1.0, 0.25)
    ground = low[(low[:, 1] > 0.10) & (low[:, 1] < 1.5), 2]
    levels, edges = np.histogram(ground, np.arange(-1.0, 0.26, 0.02))
    # The commonest height, because the feet of leaves and walls stand on the floor too but spread over all heights.
    commonest = int(np.argmax(levels))
    return float(edges[commonest]) + 0.01 if levels[commonest] >= 5 else None


def _goes_on(opening: Opening, gates: DoorGates) -> bool:
    """Something was seen deeper than a cupboard's back: beams that went on, or an opened leaf that reaches there."""
    aside = round(gates.free_depth / CELL)
    columns = slice(max(0, opening.columns.start - aside), opening.columns.stop + aside)
    passed = np.any(opening.deeper.decided[columns, LOW:TOP] == Beam.OPEN, axis=1)
    if np.count_nonzero(passed) * CELL >= gates.min_deep_view:
        return True
    deep = opening.within(0.15, 1.85, opening.left, opening.right)
    deep = deep[(deep[:, 1] > gates.cupboard) & (deep[:, 1] < gates.leaf_reach)]
    return len(np.unique(np.floor(deep[:, [0, 2]] / CELL), axis=0)) >= gates.min_leaf_cells


def _is_mirror(opening: Opening, gates: DoorGates) -> bool:
    """What is seen through the hole repeats, reflected, what stands before the wall.

    What a window beside it shows is another matter. Floor, ceiling and walls that run on through the plane repeat in
    any case: they also do when the reflection is displaced, so only what does not is asked.
    """
    top = opening.wall.ceiling_z - opening.wall.floor_z - 0.15
    points = opening.points
    upright = (points[:, 2] > 0.15) & (points[:, 2] < top)
    beyond_it = upright & (points[:, 1] > 0.3)
    behind, front = points[beyond_it][opening.through(beyond_it)], points[upright & (points[:, 1] < -0.1)]
    if len(behind) < 50 or len(front) < 50:
        return False
    reflected = behind[:: max(1, len(behind) // 2000)] * np.array([1, -1, 1], np.float32)
    tree = cKDTree(front)

    def repeats(shift: float) -> NDArray[np.bool_]:
        displaced = reflected + np.array([0, shift, 0], np.float32)
        return np.isfinite(tree.query(displaced, distance_upper_bound=0.06, workers=2)[0])

    telling = ~(repeats(0.25) | repeats(-0.25))
    return bool(np.count_nonzero(telling) >= 50 and np.mean(repeats(0.0)[telling]) > gates.mirrored)
