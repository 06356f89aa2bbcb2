"""Contour, walls and interior of rooms against their plans."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from perception.contour import barriers, interior_mask, room_shape
from perception.failure import FailureError
from perception.findings import Door, RoomShape
from perception.outline.columns import CELL, volume_of
from perception.segmentation import floor_and_ceiling
from tests.perception.rooms import BEAM, DOOR, FURNITURE, ROOM_A, ROOM_B, survey, two_rooms
from tests.synthetic import Scene, box

IN_A, IN_B, UNDER_DOOR = (3.2, 2.7), (8.5, 2.5), (6.07, 2.45)
BEYOND_DOOR = (6.9, 2.45)


def _shape(cloud, seed, with_stations=True, **options):
    points, stations, station_of = cloud
    if with_stations:
        options |= {"stations": stations, "station_of": station_of}
    return room_shape(points, floor_and_ceiling(points), seed, **options)


def _deviation(shape, plan):
    """Largest distance between the two outlines, either way."""
    return shapely.Polygon(shape.contour).exterior.hausdorff_distance(shapely.Polygon(plan).exterior)


@pytest.fixture(scope="module")
def furnished():
    return survey(two_rooms(*FURNITURE), IN_A, UNDER_DOOR, IN_B)


def test_an_empty_room_is_its_plan():
    shape = _shape(survey(two_rooms(), (3, 2.5)), (3, 2.5))
    assert _deviation(shape, ROOM_A) < 0.01
    assert shape.ceiling_z == pytest.approx(3.0, abs=0.005)
    assert shape.floor_z == pytest.approx(0.0, abs=0.005)


def test_furniture_curtain_lamp_beam_and_lowered_ceiling_do_not_move_the_walls():
    shape = _shape(survey(two_rooms(*FURNITURE), IN_A), IN_A)
    assert _deviation(shape, ROOM_A) < 0.05
    assert shape.ceiling_z == pytest.approx(3.0, abs=0.01)


@pytest.mark.parametrize(("behind", "stays"), [(0.0, True), (0.05, True), (3.0, False)])
def test_a_lintel_is_a_wall_unless_beams_go_on_behind_it(behind, stays):
    """From afar the beams up to its face seem to end a pixel behind it; below a beam they go on to the next room."""
    x, z = np.meshgrid(np.arange(0.0, 1.0, 0.03), np.arange(2.1, 2.7, 0.03))
    lintel = np.column_stack([x.ravel(), np.full(x.size, 3.02), z.ravel()])
    x, y = np.meshgrid(np.arange(-2.0, 3.0, 0.03), np.arange(0.0, 6.0, 0.03))
    level = np.column_stack([x.ravel(), y.ravel(), np.random.default_rng(0).normal(0.0, 0.003, x.size)])
    points = np.concatenate([lintel, level, level + np.array([0.0, 0.0, 2.7])])
    levels = floor_and_ceiling(points)
    volume = volume_of(points, levels)
    ((row, column),) = volume.pixels(np.array([[0.5, 3.02]]))
    crossed = np.zeros(volume.shape, bool)
    crossed[: row + 1 + round(behind / CELL)] = True
    assert barriers(volume, levels, crossed)[:, column].any() == stays


def test_walls_have_the_interior_on_their_left(furnished):
    shape = _shape(furnished, IN_A)
    assert len(shape.walls) >= 4
    for x0, y0, x1, y1 in shape.walls:
        assert (x1 - x0) * (2.5 - y0) - (y1 - y0) * (3.0 - x0) > 0


@pytest.mark.parametrize(("seed", "plan"), [(IN_A, ROOM_A), (BEYOND_DOOR, ROOM_B)])
def test_rooms_joined_by_a_door_do_not_merge(furnished, seed, plan):
    assert _deviation(_shape(furnished, seed), plan) < 0.05


def test_from_the_doorway_the_new_room_is_taken():
    shape = _shape(survey(two_rooms(*FURNITURE), IN_A, UNDER_DOOR), BEYOND_DOOR)
    found, plan = shapely.Polygon(shape.contour), shapely.Polygon(ROOM_B)
    assert found.intersection(plan).area > 0.95 * plan.area
    assert found.intersection(shapely.Polygon(ROOM_A)).area < 0.1
    assert found.difference(plan).area < 0.03 * plan.area


def test_a_known_door_keeps_rooms_apart_whose_lintel_was_not_seen():
    # Only the scanner under the door, as when a mission starts there: it sees neither lintel nor wall.
    door = Door(6.075, 2.45, (1.0, 0.0), 0.9, 0.9, 2.05, 1.0)
    shape = _shape(survey(two_rooms(), UNDER_DOOR), BEYOND_DOOR, doors=[door])
    found = shapely.Polygon(shape.contour)
    assert found.intersection(shapely.Polygon(ROOM_A)).area < 0.1
    assert found.intersection(shapely.Polygon(ROOM_B)).area > 0.9 * shapely.Polygon(ROOM_B).area


def test_a_station_close_to_a_wall_does_not_push_it_out():
    cloud = survey(two_rooms(), (3, 2.5), (5.4, 4.4))
    assert _deviation(_shape(cloud, (3, 2.5)), ROOM_A) < 0.05


def test_a_known_room_is_not_entered():
    cloud = survey(two_rooms(lintel=False, door=(1.5, 3.5)), IN_A, IN_B)
    shape = _shape(cloud, IN_B, others=[np.array(ROOM_A, float)])
    assert _deviation(shape, ROOM_B) < 0.3
    assert shapely.Polygon(shape.contour).intersection(shapely.Polygon(ROOM_A)).area < 0.3


def test_an_open_passage_without_a_lintel_joins_its_rooms():
    shape = _shape(survey(two_rooms(lintel=False, door=(1.5, 3.5)), IN_A, IN_B), IN_A)
    assert shape.area == pytest.approx(30.0 + 24.25 + 0.3, abs=0.5)


def test_a_beam_splits_no_room():
    shape = _shape(survey(two_rooms(BEAM), (2.5, 2.5), (5.2, 3.5)), (2.5, 2.5))
    assert _deviation(shape, ROOM_A) < 0.05


def test_the_overhead_cone_does_not_split_a_corridor():
    corridor = Scene(box((0, 0, 0), (14, 1.8, 3.0)))
    cloud = survey(corridor, (7, 0.9))
    assert _shape(cloud, (7, 0.9)).area == pytest.approx(14 * 1.8, rel=0.02)


def test_a_room_that_is_not_rectangular_keeps_its_shape():
    plan = [(0, 0), (7, 0), (7, 4), (4, 4), (4, 7), (0, 7)]
    room = Scene(
        box((-0.2, -0.2, -0.2), (7.2, 7.2, 0)),
        box((-0.2, -0.2, 3), (7.2, 7.2, 3.2)),
        box((-0.2, -0.2, 0), (7.2, 0, 3)),
        box((-0.2, -0.2, 0), (0, 7.2, 3)),
        box((7, 0, 0), (7.2, 4, 3)),
        box((0, 7, 0), (4, 7.2, 3)),
        box((4, 4, 0), (7.2, 7.2, 3)),
    )
    assert _deviation(_shape(survey(room, (2.5, 2.5)), (2.5, 2.5)), plan) < 0.1


def test_the_contour_grows_with_later_scans_and_keeps_its_room():
    scene = two_rooms(*FURNITURE)
    first = _shape(survey(scene, IN_A, UNDER_DOOR), BEYOND_DOOR)
    # The seed is far off on purpose: what was the room before must decide.
    second = _shape(survey(scene, IN_A, UNDER_DOOR, IN_B), (20.0, 20.0), previous=first)
    assert second.area > first.area
    assert _deviation(second, ROOM_B) < 0.05


def test_without_a_ceiling_beams_above_door_height_tell_the_room():
    cloud = survey(two_rooms(ceiling=False), IN_A, IN_B)
    for seed, plan in ((IN_A, ROOM_A), (IN_B, ROOM_B)):
        shape = _shape(cloud, seed)
        assert _deviation(shape, plan) < 0.05
        assert shape.ceiling_z == pytest.approx(3.0, abs=0.1)


def test_without_stations_the_room_is_still_found(furnished):
    assert _deviation(_shape(furnished, IN_A, with_stations=False), ROOM_A) < 0.25


def test_a_seed_outside_is_refused(furnished):
    with pytest.raises(FailureError, match="CONTOUR_NOT_FOUND"):
        _shape(furnished, (20.0, 20.0))


def test_points_seen_through_the_door_are_outside(furnished):
    shape = _shape(furnished, IN_A)
    points = furnished[0]
    inside = interior_mask(points, shape, 0.05)
    assert not inside[points[:, 0] > 6.1].any()
    in_plan = np.all((points[:, :2] > 0.02) & (points[:, :2] < (5.98, 4.98)), axis=1)
    assert inside[in_plan].all()
    assert DOOR[0] < UNDER_DOOR[1] < DOOR[1]


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.floats(-0.2, 0.4))
def test_interior_mask_agrees_with_an_independent_library(seed, margin):
    rng = np.random.default_rng(seed)
    polygon = shapely.Polygon([(0, 0), (7, 0.5), (6, 4), (4, 4), (4, 7), (0, 6)])
    contour = np.array(polygon.exterior.coords)[:-1]
    points = rng.uniform((-1, -1, -1), (8, 8, 4), (300, 3))
    expected = shapely.contains_xy(polygon.buffer(margin, join_style="mitre"), points[:, 0], points[:, 1])
    expected &= (points[:, 2] >= -margin) & (points[:, 2] <= 3 + margin)
    shape = RoomShape(contour, 0.0, 3.0, np.empty((0, 4)))
    assert np.array_equal(interior_mask(points, shape, margin), expected)
