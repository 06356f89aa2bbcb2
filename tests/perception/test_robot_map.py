"""Robot maps of known rooms, and what coupling does to evidence."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perception import transforms
from perception.grids import Cell, Grid
from perception.robot_map import MapEvidence, below, couple, mark_free, partial_map
from tests.perception.rooms import DOOR, TABLE, survey, two_rooms
from tests.synthetic import box

LEG = box((4.5, 3.5, 0), (4.54, 3.54, 0.7))
BAR = box((1.2, 2.0, 0), (1.25, 3.4, 0.03))
STEP = np.deg2rad(0.6)
HERE = (3.2, 2.7, 1.3)


@pytest.fixture(scope="module")
def scanned():
    points, _, _ = survey(two_rooms(TABLE, LEG, BAR), HERE[:2])
    return points


@pytest.fixture(scope="module")
def mapped(scanned):
    return partial_map(scanned, HERE, azimuth_step=STEP).evidence.to_grid()


def _state(grid, x, y):
    row, column = grid.cells_of((x, y))
    return Cell(int(grid.data[row, column]))


def test_walls_table_legs_and_bars_are_obstacles(mapped):
    for x, y in ((6.0, 1.0), (0.0 - 0.01, 4.0), (2.5, 1.4), (4.52, 3.52), (1.22, 2.7)):
        around = [_state(mapped, x + dx, y + dy) for dx in (-0.05, 0, 0.05) for dy in (-0.05, 0, 0.05)]
        assert Cell.OBSTACLE in around, (x, y)


def test_most_of_the_seen_floor_is_free(mapped):
    xy = np.stack(np.meshgrid(np.arange(1.4, 5.7, 0.05), np.arange(2.2, 3.2, 0.05)), axis=-1).reshape(-1, 2)
    xy = xy[np.hypot(xy[:, 0] - HERE[0], xy[:, 1] - HERE[1]) > 1.7]
    rows, columns = mapped.cells_of(xy).T
    assert np.mean(mapped.data[rows, columns] == Cell.FREE) > 0.97


def test_the_blind_disc_is_unknown_until_it_is_marked(mapped):
    assert _state(mapped, *HERE[:2]) == Cell.UNKNOWN
    freed = mark_free(mapped, [HERE[:2], (3.4, 2.7)], 0.3)
    assert _state(freed, 3.4, 2.9) == Cell.FREE
    assert _state(freed, 3.2, 3.1) == Cell.UNKNOWN


def test_a_doorway_stays_open(mapped):
    across = [_state(mapped, 6.075, y) for y in np.arange(DOOR[0] + 0.075, DOOR[1] - 0.05, 0.05)]
    assert Cell.OBSTACLE not in across
    assert across.count(Cell.FREE) > 0.8 * len(across)


def test_what_is_behind_a_wall_is_unknown(mapped):
    assert _state(mapped, 6.08, 4.0) == Cell.UNKNOWN


def test_a_single_point_in_the_air_is_noise(scanned):
    ghosts = np.array([[1.8, 4.2, 0.8], [4.9, 2.6, 1.1]], np.float32)
    grid = partial_map(np.concatenate([scanned, ghosts]), HERE, azimuth_step=STEP).evidence.to_grid()
    assert all(_state(grid, x, y) == Cell.FREE for x, y, _ in ghosts)


def test_what_is_above_the_robot_is_no_obstacle():
    points, _, _ = survey(two_rooms(box((4.6, 2.4, 1.6), (5.2, 3.0, 1.8))), HERE[:2])
    grid = partial_map(points, HERE, azimuth_step=STEP).evidence.to_grid()
    assert _state(grid, 4.9, 2.7) != Cell.OBSTACLE


def _evidence(layers, origin=(0.0, 0.0)):
    hits, seen, cleared = (np.asarray(layer, np.int16).reshape(1, -1) for layer in layers)
    return MapEvidence(hits, seen, cleared, origin, 0.05)


HIT, CLEAR = _evidence(([1], [0], [0])), _evidence(([0], [1], [1]))
FAR_FLOOR = _evidence(([0], [1], [0]))


@pytest.mark.parametrize(
    ("scans", "state"),
    [
        ((CLEAR, HIT), Cell.OBSTACLE),
        ((HIT, CLEAR), Cell.OBSTACLE),
        ((HIT, CLEAR, CLEAR), Cell.FREE),
        ((HIT, FAR_FLOOR, FAR_FLOOR, FAR_FLOOR), Cell.OBSTACLE),
        ((HIT, CLEAR, HIT, CLEAR), Cell.OBSTACLE),
        ((HIT, CLEAR, CLEAR, HIT), Cell.OBSTACLE),
    ],
)
def test_an_obstacle_wins_until_scans_in_a_row_clear_it(scans, state):
    total = None
    for scan in scans:
        total = couple(total, scan)
    assert total.to_grid().data[0, 0] == state


@settings(max_examples=30, deadline=None)
@given(st.integers(-40, 40), st.integers(-40, 40), st.integers(0, 1000))
def test_coupling_keeps_every_cell_in_its_place(dx, dy, seed):
    rng = np.random.default_rng(seed)
    first = MapEvidence(*(rng.integers(0, 2, (3, 7, 5)).astype(np.int16)), (0.0, 0.0), 0.05)
    second = MapEvidence(*(rng.integers(0, 2, (3, 4, 9)).astype(np.int16)), (dx * 0.05, dy * 0.05), 0.05)
    total = couple(first, second)
    grid = Grid(total.hits, total.origin, total.resolution)
    for part in (first, second):
        own, other = (Grid(e.hits, e.origin, 0.05) for e in ((part, second) if part is first else (part, first)))
        centres = own.centres_of(np.argwhere(np.ones(own.shape)))
        cells, elsewhere = grid.cells_of(centres), other.cells_of(centres)
        both = other.contains(elsewhere)
        expected = own.data.ravel().astype(int)
        expected[both] += other.data[elsewhere[both][:, 0], elsewhere[both][:, 1]]
        assert np.array_equal(grid.data[cells[:, 0], cells[:, 1]], expected)
    assert total.hits.sum() == first.hits.sum() + second.hits.sum()


def test_marking_beyond_the_grid_makes_it_grow():
    grid = Grid(np.full((2, 2), Cell.OBSTACLE, np.uint8), (0.0, 0.0), 0.05)
    grown = mark_free(grid, [(-0.5, 0.05)], 0.1)
    assert _state(grown, -0.5, 0.05) == Cell.FREE
    assert _state(grown, 0.02, 0.02) == Cell.OBSTACLE


def test_only_the_robots_own_place_is_freed_of_obstacles():
    grid = Grid(np.full((20, 20), Cell.OBSTACLE, np.uint8), (0.0, 0.0), 0.05)
    assert _state(mark_free(grid, [(0.5, 0.5)], 0.2), 0.5, 0.5) == Cell.OBSTACLE
    assert _state(mark_free(grid, [(0.5, 0.5)], 0.2, over_obstacles=True), 0.5, 0.5) == Cell.FREE


@pytest.mark.parametrize("seed", range(3))
def test_below_is_what_a_transform_and_a_comparison_give(seed):
    rng = np.random.default_rng(seed)
    points = rng.normal(0, 3, (5000, 3)).astype(np.float32)
    pose = transforms.from_euler(0.01, -0.02, rng.uniform(-3, 3), (1.0, -2.0, 1.3))
    moved = transforms.apply(pose, points)
    low = below(points, pose, 1.4)
    assert np.allclose(low, moved[moved[:, 2] < 1.4], atol=1e-5)
