import numpy as np
import pytest

from perception import voxels
from perception.findings import RoomShape
from perception.grids import Cell, Grid, Label, VoxelSpace
from perception.labelled_map import Robot, candidates, labelled_map
from perception.sensor import Sensor

SENSOR = Sensor(1.3, np.deg2rad(-40), np.deg2rad(60), 0.5, 120.0)
POSE = (2.05, 2.05, 0.0)
CORNERS = np.array([[0, 0], [6, 0], [6, 4], [0, 4]], float) + 0.02


def paint(space, lower, upper, label):
    """The space with a box (metres) painted; voxels outside the room keep their label."""
    labels = space.labels.copy()
    low, high = space.voxels_of(np.array([lower, upper], float) + 1e-6)
    window = labels[tuple(slice(max(a, 0), max(b, 0)) for a, b in zip(low, high, strict=True))]
    window[window != Label.OUTSIDE] = label
    return VoxelSpace(labels, space.origin, space.size)


def known_room():
    """A room of 6 x 4 m seen wholly: air between an occupied floor, ceiling and walls."""
    space = voxels.room_space(RoomShape(CORNERS, 0.0, 2.5, np.empty((0, 4))))
    space = paint(space, (-1, -1, -1), (7, 5, 4), Label.OCCUPIED)
    return paint(space, (0.2, 0.2, 0.1), (5.8, 3.8, 2.4), Label.EMPTY)


def at(grid, x, y):
    return grid.data[tuple(grid.cells_of((x, y)))]


def test_pixel_takes_the_label_of_highest_priority_between_floor_and_scanner():
    space = known_room()
    space = paint(space, (1.0, 1.0, 0.5), (1.1, 1.1, 0.6), Label.OCCLUDED)
    space = paint(space, (2.0, 1.0, 0.5), (2.1, 1.1, 0.6), Label.OCCLUDED)
    space = paint(space, (2.0, 1.0, 0.8), (2.1, 1.1, 0.9), Label.OCCUPIED)
    space = paint(space, (3.0, 1.0, 1.6), (3.1, 1.1, 1.8), Label.OCCUPIED)
    grid = labelled_map(space, SENSOR.height, 0.0)
    assert at(grid, 1.05, 1.05) == Label.OCCLUDED
    assert at(grid, 2.05, 1.05) == Label.OCCUPIED
    assert at(grid, 3.05, 1.05) == Label.EMPTY  # a lamp over the scanner, a floor below: neither counts
    assert at(grid, 0.05, 2.05) == Label.OCCUPIED
    assert grid.origin == space.origin[:2]


def test_a_floor_at_the_edge_of_its_layer_does_not_veto_the_room():
    grid = labelled_map(paint(known_room(), (-1, -1, 0.05), (7, 5, 0.15), Label.OCCUPIED), SENSOR.height, 0.04)
    assert at(grid, 3.05, 2.05) == Label.EMPTY


@pytest.mark.parametrize("rule", ["graded", "paper"])
def test_candidates_keep_their_distance_and_have_a_way(rule):
    space = paint(known_room(), (4.0, 0.0, 0.0), (4.1, 4.0, 2.0), Label.OCCUPIED)
    field = candidates(space, POSE, SENSOR, 0.0, rule=rule)
    assert at(field.mask, 3.05, 2.05)
    assert not at(field.mask, 3.75, 2.05)
    assert not at(field.mask, 5.05, 2.05)
    assert np.isinf(at(field.path_length, 5.05, 2.05))
    assert at(field.path_length, 3.05, 2.05) == pytest.approx(1.0)
    assert at(field.path_length, 3.05, 3.05) == pytest.approx(np.sqrt(2))


def test_every_candidate_is_clear_of_every_obstacle_by_brute_force():
    space = known_room()
    rng = np.random.default_rng(4)
    for x, y in rng.uniform(0.5, (5.5, 3.5), (6, 2)):
        if np.hypot(x - POSE[0], y - POSE[1]) > 1.0:
            space = paint(space, (x, y, 0.1), (x + 0.1, y + 0.1, 1.0), Label.OCCUPIED)
    field = candidates(space, POSE, SENSOR, 0.0)
    grid = labelled_map(space, SENSOR.height, 0.0)
    obstacles = grid.centres_of(np.argwhere(grid.data == Label.OCCUPIED))
    chosen = field.mask.centres_of(np.argwhere(field.mask.data))
    assert len(chosen) > 100
    distance = np.linalg.norm(chosen[:, None] - obstacles[None], axis=2).min()
    assert distance >= Robot().security_goal - 1e-6


@pytest.mark.parametrize("rule", ["graded", "paper"])
def test_the_blind_cone_of_a_station_does_not_trap_the_robot(rule):
    space = known_room()
    centres = space.centres(np.argwhere(space.labels > 0))
    cone = np.hypot(centres[:, 0] - POSE[0], centres[:, 1] - POSE[1]) < (1.3 - centres[:, 2]) / np.tan(np.deg2rad(40))
    labels = space.labels.copy()
    labels[tuple(np.argwhere(space.labels > 0)[cone].T)] = Label.OCCLUDED
    blind = VoxelSpace(labels, space.origin, space.size)
    field = candidates(blind, POSE, SENSOR, 0.0, rule=rule)
    assert at(field.mask, *POSE[:2])
    assert at(field.mask, 4.05, 2.05)
    elsewhere = candidates(blind, (5.05, 2.05, 0.0), SENSOR, 0.0, rule=rule)
    assert not at(elsewhere.mask, *POSE[:2])
    told = candidates(blind, (5.05, 2.05, 0.0), SENSOR, 0.0, rule=rule, stations=[POSE[:2]])
    assert at(told.mask, *POSE[:2])


def test_only_the_graded_rule_takes_a_pixel_that_is_mostly_seen():
    space = paint(known_room(), (4.0, 1.0, 0.1), (5.0, 3.0, 0.4), Label.OCCLUDED)
    assert at(candidates(space, POSE, SENSOR, 0.0).mask, 4.55, 2.05)
    assert not at(candidates(space, POSE, SENSOR, 0.0, rule="paper").mask, 4.55, 2.05)
    mostly_unseen = paint(space, (4.0, 1.0, 0.1), (5.0, 3.0, 0.9), Label.OCCLUDED)
    assert not at(candidates(mostly_unseen, POSE, SENSOR, 0.0).mask, 4.55, 2.05)


def test_the_graded_rule_asks_for_a_floor():
    pit = paint(known_room(), (4.0, 1.0, -0.1), (5.0, 3.0, 0.1), Label.EMPTY)
    field = candidates(pit, POSE, SENSOR, 0.0)
    assert at(field.mask, 3.55, 2.05)
    assert not at(field.mask, 4.55, 2.05)


def test_what_swallowed_the_beams_within_the_minimum_range_is_an_obstacle():
    far_sighted = Sensor(1.3, SENSOR.elevation_min, SENSOR.elevation_max, 1.5, 120.0)
    desk = paint(known_room(), (3.0, 1.7, 0.1), (3.4, 2.4, 0.8), Label.OCCLUDED)
    field = candidates(desk, POSE, far_sighted, 0.0)
    assert not at(field.mask, 2.75, 2.05)
    assert at(candidates(desk, POSE, SENSOR, 0.0).mask, 2.75, 2.05)


def test_the_flood_starts_in_a_doorway_outside_the_space():
    space = known_room()
    space = paint(space, (-0.2, 1.55, 0.1), (0.2, 2.55, 2.0), Label.EMPTY)
    field = candidates(space, (-0.1, 2.05, 0.0), SENSOR, 0.0)
    assert at(field.mask, 3.05, 2.05)
    assert at(field.path_length, 3.05, 2.05) == pytest.approx(3.15, abs=0.1)
    assert field.mask.shape == space.labels.shape[1::-1]


def test_the_driven_track_is_passable_whatever_the_labels_say():
    space = paint(known_room(), (3.0, 0.0, 0.1), (3.3, 4.0, 2.0), Label.OCCLUDED)
    assert not at(candidates(space, POSE, SENSOR, 0.0).mask, 4.55, 2.05)
    track = [(x, 2.05, 0.0) for x in np.arange(2.05, 4.6, 0.1)]
    assert at(candidates(space, POSE, SENSOR, 0.0, driven=track).mask, 4.55, 2.05)


def test_obstacles_of_the_robot_map_count():
    data = np.full((100, 140), Cell.UNKNOWN, np.uint8)
    robot_map = Grid(data, (-0.5, -0.5), 0.05)
    data[tuple(robot_map.cells_of((4.01, 2.01)))] = Cell.OBSTACLE
    assert at(candidates(known_room(), POSE, SENSOR, 0.0).mask, 4.05, 2.05)
    assert not at(candidates(known_room(), POSE, SENSOR, 0.0, robot_map=robot_map).mask, 4.05, 2.45)
