"""Which part of the cloud is the room: ceiling image, its segments, the contour H and the interior (section 3.1)."""

from collections.abc import Sequence

import cv2
import numpy as np
import shapely
from numba import njit
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d

from perception.failure import FailureError
from perception.findings import Door, Polygon, RoomShape
from perception.outline.columns import CELL, SLICE, Image, Volume, volume_of
from perception.outline.surroundings import REACH, inside_ring, relevant
from perception.outline.walls import fit_walls
from perception.rasters import picked
from perception.rays.polar import crossed_between
from perception.segmentation import Levels, floor_and_ceiling
from perception.views import Views

GAP = 0.15
"""Half of the widest gap between ceiling points that is bridged, metres."""
NECK = 0.30
"""Half of the widest passage at ceiling height that still separates two rooms, metres."""
LINTEL_SPAN = 2.6
"""A longer lintel with nothing but air below it is a beam, metres."""
SPILL = 0.10
"""What is crossed by beams no further than this may be a face that they end at, metres."""
SEED_REACH = 1.5
"""The room's segment is this near to the seed, metres; right around the scanner its ceiling is not seen."""
DOOR_HEIGHT = 2.1
"""Above it the wall over a door is closed, metres over the floor."""
_OVERHEAD = np.deg2rad(60.0)
_AZIMUTH = np.deg2rad(0.5)
_DIRECTIONS = 720


def room_shape(
    points: NDArray[np.floating],
    levels: Levels,
    seed: tuple[float, float],
    stations: NDArray[np.floating] | None = None,
    station_of: NDArray[np.integer] | None = None,
    doors: Sequence[Door] = (),
    others: Sequence[Polygon] = (),
    previous: RoomShape | None = None,
) -> RoomShape:
    """Contour ``H`` and walls of the room that holds ``seed``, from all points registered so far (section 3.1).

    The ceiling image is labelled and the segment nearest to the seed (else that overlaps ``previous`` most) is it.
    A pixel whose column is filled between door height and ceiling is a barrier, so that rooms never merge over a door:
    the wall above it closes the gap. Over free floor a barrier that is longer than any door, or that beams passed
    beneath on their way to the ceiling, is a beam and none. Where there is no ceiling, a pixel belongs to the room if
    beams crossed it above door height (needs ``stations``), or else if its floor was seen. The segment's outline
    becomes straight segments, each of which is moved to the outer significant peak of its d-histogram; segments with
    no wall behind them end where sight ended and H grows later.

    Args:
        points: ``(N, 3)``, map frame, metres.
        levels: floor and ceiling layers of these points.
        seed: (x, y) in the room meant, map frame.
        stations: ``(S, 3)`` positions of the scanner, map frame; the disc of ceiling that each cannot see is filled.
        station_of: ``(N,)`` row of ``stations`` that each point was seen from; tells the two faces of a wall apart.
            Given if and only if ``stations`` are.
        doors: known doors of the building; a scanner under a door sees neither its lintel nor the wall beside it, so
            the wall there is drawn in.
        others: contours of rooms already known, which this one may not enter.
        previous: this room's shape one cycle before; decides where the seed's surroundings are not seen.

    Raises:
        FailureError: ``CONTOUR_NOT_FOUND`` if there is no ceiling (or free space) within 1.5 m of the seed.
    """
    centre = np.asarray(seed, float)
    views = relevant(points, stations, station_of, centre, others)
    if len(views.points) == 0:
        raise FailureError("CONTOUR_NOT_FOUND", f"no point around ({seed[0]:.2f}, {seed[1]:.2f})")
    volume = volume_of(views.points, levels)
    skimmed = _skimmed(volume, views, levels)
    barrier = barriers(volume, levels, skimmed) | _drawn_doors(volume, doors)
    covered = _covered(volume, views, levels, barrier) | skimmed
    for polygon in others:
        barrier |= _drawn(volume, np.asarray(shapely.Polygon(polygon).buffer(-CELL).exterior.coords))
    region = _segment(volume, covered, barrier, centre, previous)
    ceiling_z = _ceiling_height(views.points, volume, region, levels)
    contour, walls = fit_walls(_outline(volume, region), views, levels.floor.peak, ceiling_z)
    return RoomShape(contour, levels.floor.peak, ceiling_z, walls)


def interior_mask(points: NDArray[np.floating], shape: RoomShape, margin: float = 0.0) -> NDArray[np.bool_]:
    """Whether each point ``(N, 3)`` (map frame) is inside the room's prism, grown by ``margin`` metres on all sides."""
    polygon = shapely.Polygon(shape.contour).buffer(margin, join_style="mitre")
    mask = (points[:, 2] >= shape.floor_z - margin) & (points[:, 2] <= shape.ceiling_z + margin)
    x0, y0, x1, y1 = polygon.bounds
    mask &= (points[:, 0] >= x0) & (points[:, 0] <= x1) & (points[:, 1] >= y0) & (points[:, 1] <= y1)
    near = np.flatnonzero(mask)
    mask[near] = inside_ring(points[near, :2], np.asarray(polygon.exterior.coords))
    return mask


def barriers(volume: Volume, levels: Levels, skimmed: Image) -> Image:
    """Pixels of walls and lintels: columns filled between door height and the main ceiling, but for beams."""
    height = _main_ceiling(volume, levels)
    bottom = min(DOOR_HEIGHT, height - 0.3)
    upper = [cv2.dilate(level.astype(np.uint8), _disc(1.0)) for level in volume.band(bottom, height - 0.08)]
    closed = np.sum(upper, axis=0, dtype=np.uint8) >= 0.7 * len(upper)
    middle, below = (cv2.dilate(volume.any(*b).astype(np.uint8), _disc(1.0)) > 0 for b in ((1.0, 1.9), (0.0, 0.9)))
    lintel = closed & below & ~middle
    # From afar the beams up to a wall seem to end a little behind its face; those below a beam go on.
    crossed = cv2.erode(skimmed.astype(np.uint8), _disc(SPILL / CELL)) > 0
    return closed & ~(lintel & (crossed | _longer_than(lintel, LINTEL_SPAN)))


def _drawn_doors(volume: Volume, doors: Sequence[Door]) -> Image:
    """The wall at each door, a metre further on both sides than the opening."""
    image = np.zeros(volume.shape, np.uint8)
    for door in doors:
        half = (door.width / 2 + 1.0) * np.array([-door.normal[1], door.normal[0]])
        ends = volume.pixels(np.stack([np.array([door.x, door.y]) - half, np.array([door.x, door.y]) + half]))
        first, last = ((int(column), int(row)) for row, column in ends)
        cv2.line(image, first, last, 1, thickness=max(2, round(door.thickness / CELL)))
    return image > 0


def _main_ceiling(volume: Volume, levels: Levels) -> float:
    """Height up to which walls are filled: of several ceilings the widest, for a lowered part has a face above it."""
    if levels.ceiling is not None:
        return levels.ceiling.peak - levels.floor.peak
    return (len(volume.slices) - 1) * SLICE


def _longer_than(mask: Image, span: float) -> Image:
    _, labels, stats, _ = cv2.connectedComponentsWithStats(mask.astype(np.uint8), connectivity=8)
    extent = np.hypot(stats[:, cv2.CC_STAT_WIDTH], stats[:, cv2.CC_STAT_HEIGHT]) * CELL
    extent[0] = 0.0
    return (extent > span)[labels]


def _covered(volume: Volume, views: Views, levels: Levels, barrier: Image) -> Image:
    """Pixels with something overhead, or under the disc of the ceiling that a station could not see.

    What hangs below the ceiling (a lowered part, a beam, a lamp) covers the room as well as the ceiling it hides.
    """
    if not levels.ceilings:
        return _crossed(volume, views, levels)
    image = volume.any(DOOR_HEIGHT, np.inf)
    for index, station in enumerate([] if views.stations is None else views.stations):
        blind = (levels.ceilings[-1].peak - station[2]) / np.tan(_OVERHEAD) + 2 * CELL
        furthest = _furthest(views.of(index), station)
        image |= _line_of_sight(volume, barrier, station, np.minimum(blind, furthest))
    return image


def _furthest(points: NDArray[np.floating], station: NDArray[np.floating]) -> NDArray[np.float64]:
    """Distance of the furthest point in each of 720 directions; 0 where a wall nearer than the minimum range is."""
    # The beams of a coarse scan leave directions empty between them.
    return maximum_filter1d(_furthest_seen(points, float(station[0]), float(station[1])), 5, mode="wrap")


@njit(cache=True)
def _furthest_seen(points: NDArray[np.floating], x: float, y: float) -> NDArray[np.float64]:
    furthest = np.zeros(_DIRECTIONS)
    for n in range(len(points)):
        dx, dy = points[n, 0] - x, points[n, 1] - y
        sector = int(np.arctan2(dy, dx) / (2 * np.pi) % 1.0 * _DIRECTIONS) % _DIRECTIONS
        furthest[sector] = max(furthest[sector], np.sqrt(dx * dx + dy * dy))
    return furthest


def _skimmed(volume: Volume, views: Views, levels: Levels) -> Image:
    """Pixels that beams crossed above door height on their way to the ceiling further out, where it is sparse."""
    image = np.zeros(volume.shape, bool)
    if views.stations is None:
        return image
    for index, station in enumerate(views.stations):
        seen = views.of(index)
        for level in levels.ceilings:
            own = seen[level.contains(seen[:, 2])]
            clearance = min(level.peak - levels.floor.peak - DOOR_HEIGHT - 0.1, 0.5)
            if len(own) == 0 or clearance <= 0.0:
                continue
            above = level.peak - station[2]
            image |= crossed_between(own, station, volume.frame, above, clearance, _AZIMUTH, REACH)
    return image


def _line_of_sight(volume: Volume, barrier: Image, station: NDArray[np.floating], reach: NDArray[np.floating]) -> Image:
    """Pixels within ``reach`` (by direction) of the station that no barrier hides from it."""
    angles = (np.arange(_DIRECTIONS) + 0.5) * (2 * np.pi / _DIRECTIONS)
    radii = np.arange(0.0, max(float(reach.max()), CELL), CELL / 2)
    x = station[0] + radii[:, None] * np.cos(angles)
    y = station[1] + radii[:, None] * np.sin(angles)
    pixels = volume.pixels(np.stack([x.ravel(), y.ravel()], axis=1))
    inside = volume.inside(pixels)
    blocked = np.ones(len(pixels), bool)
    blocked[inside] = barrier[pixels[inside, 0], pixels[inside, 1]]
    # A station under a door has the lintel above it, not in its way.
    blocked = (blocked.reshape(x.shape) & (radii[:, None] > 0.25)) | (radii[:, None] > reach)
    visible = ~np.logical_or.accumulate(blocked, axis=0).ravel() & inside
    image = np.zeros(volume.shape, bool)
    image[pixels[visible, 0], pixels[visible, 1]] = True
    return image


def _crossed(volume: Volume, views: Views, levels: Levels) -> Image:
    """Free space without a ceiling: what beams crossed above door height, else the floor that was seen."""
    image = np.zeros(volume.shape, np.uint8)
    if views.stations is None:
        row, column = volume.pixels(views.points[levels.floor.contains(views.points[:, 2]), :2]).T
        image[row, column] = 1
        return image > 0
    for index, station in enumerate(views.stations):
        seen = views.of(index)
        furthest = _furthest(seen[seen[:, 2] > levels.floor.peak + DOOR_HEIGHT], station)
        angles = (np.arange(_DIRECTIONS) + 0.5) * (2 * np.pi / _DIRECTIONS)
        ring = station[:2] + furthest[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
        cv2.fillPoly(image, [volume.pixels(ring)[:, ::-1].astype(np.int32)], 1)
    return image > 0


def _segment(
    volume: Volume, covered: Image, barrier: Image, seed: NDArray[np.floating], previous: RoomShape | None
) -> Image:
    """The labelled segment of the ceiling image that is the room, holes filled."""
    bridged = cv2.morphologyEx((covered & ~barrier).astype(np.uint8), cv2.MORPH_CLOSE, _disc(GAP / CELL))
    filled = _filled(bridged.astype(bool) & ~barrier, ~barrier)
    core = cv2.erode(filled.astype(np.uint8), _disc(NECK / CELL))
    count, found = cv2.connectedComponents(core, connectivity=4)
    labels = np.asarray(found, np.int32)
    label = _label_of_room(volume, labels, count, seed, previous)
    room = cv2.dilate((labels == label).astype(np.uint8), _disc(NECK / CELL + 1)).astype(bool) & filled
    return _filled(_part_with(room, labels == label), np.ones(volume.shape, bool))


def _label_of_room(
    volume: Volume, labels: NDArray[np.int32], count: int, seed: NDArray[np.floating], previous: RoomShape | None
) -> int:
    pixels = np.argwhere(labels > 0)
    distance = np.hypot(*(pixels - volume.pixels(seed[None])[0]).T) * CELL if len(pixels) else np.array([np.inf])
    nearest = int(distance.argmin())
    if distance[nearest] <= SEED_REACH:
        return int(labels[tuple(pixels[nearest])])
    inside = labels[_drawn(volume, previous.contour)] if previous is not None else np.zeros(0, np.int32)
    votes = np.bincount(inside[inside > 0], minlength=1)
    if votes.any():
        return int(votes.argmax())
    raise FailureError(
        "CONTOUR_NOT_FOUND",
        f"no ceiling within {SEED_REACH} m of ({seed[0]:.2f}, {seed[1]:.2f})",
        nearest_m=float(distance[nearest]),
        segments=count - 1,
    )


def _filled(mask: Image, allowed: Image) -> Image:
    """The mask with its holes filled where ``allowed``: lamps and beams hide parts of a ceiling."""
    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    solid = cv2.drawContours(np.zeros(mask.shape, np.uint8), contours, -1, 1, cv2.FILLED)
    return (solid > 0) & allowed


def _part_with(mask: Image, core: Image) -> Image:
    _, labels = cv2.connectedComponents(mask.astype(np.uint8), connectivity=4)
    return (labels > 0) & np.isin(labels, np.unique(labels[core & mask]))


def _outline(volume: Volume, region: Image) -> Polygon:
    """Outer border of a region, counter-clockwise in the map frame, through the outer edges of its pixels."""
    doubled = cv2.resize(region.astype(np.uint8), None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST)
    contours, _ = cv2.findContours(doubled, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)
    border = max(contours, key=cv2.contourArea)
    outline = volume.corners((border[:, 0, :] + 0.5) / 2 - 0.5)
    return np.asarray(shapely.Polygon(outline).normalize().exterior.coords)[:-1][::-1]


def _drawn(volume: Volume, polygon: NDArray[np.floating]) -> Image:
    image = np.zeros(volume.shape, np.uint8)
    if len(polygon) >= 3:
        cv2.fillPoly(image, [volume.pixels(polygon[:, :2])[:, ::-1].astype(np.int32)], 1)
    return image > 0


def _ceiling_height(points: NDArray[np.floating], volume: Volume, region: Image, levels: Levels) -> float:
    """Highest wide ceiling over this region; without one, the height that its walls reach."""
    own = points[picked(region, points, volume.frame)]
    ceilings = floor_and_ceiling(own, levels.floor.peak, 0.2).ceilings if levels.ceilings else ()
    return ceilings[-1].peak if ceilings else float(np.percentile(points[:, 2], 99.5))


def _disc(radius: float) -> NDArray[np.uint8]:
    size = 2 * round(radius) + 1
    return cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size)).astype(np.uint8)
