from fractions import Fraction
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perception.failure import FailureError
from perception.grids import Grid, Label, VoxelSpace
from perception.labelled_map import CandidateField
from perception.next_best_view import NOT_EVALUATED, Travel, next_best_view, rank_views, surface
from perception.rays import ray_walk
from perception.sensor import Sensor

SENSOR = Sensor(0.55, np.deg2rad(-40), np.deg2rad(60), 0.2, 120.0)
SUB = ray_walk.SUBDIVISION


def random_space(seed, shape=(9, 8, 9), occupied=0.12, occluded=0.4):
    rng = np.random.default_rng(seed)
    share = (0.05, 0.95 - occupied - occluded, occluded, occupied)
    return VoxelSpace(rng.choice(4, shape, p=share).astype(np.uint8), (-0.3, 0.4, -0.05), 0.1)


def field_of(space, cells=None, path=None):
    rows, columns = space.labels.shape[1::-1]
    mask = np.zeros((rows, columns), bool)
    mask[tuple(np.transpose(cells if cells is not None else np.argwhere(~mask)))] = True
    length = np.ones((rows, columns)) if path is None else path
    return CandidateField(*(Grid(data, space.origin[:2], space.size) for data in (mask, length)))


def crosses(voxel, start, end):
    """Whether the open segment meets the inside of a voxel: slabs in rational numbers, no walk."""
    enter, leave = Fraction(0), Fraction(1)
    for index, a, b in zip(voxel, start, end, strict=True):
        low, high = SUB * int(index), SUB * (int(index) + 1)
        if a == b:
            if not low < a < high:
                return False
            continue
        first, last = sorted((Fraction(low - a, b - a), Fraction(high - a, b - a)))
        enter, leave = max(enter, first), min(leave, last)
    return enter < leave


def clear_by_slabs(blocking, voxel, place):
    start = tuple(SUB * int(v) + SUB // 2 for v in voxel)
    ends = {tuple(map(int, voxel)), tuple(int(p) // SUB for p in place)}
    low, high = (tuple(f(v, p // SUB) for v, p in zip(voxel, place, strict=True)) for f in (min, max))
    between = product(*(range(int(a), int(b) + 1) for a, b in zip(low, high, strict=True)))
    return not any(blocking[v] and v not in ends and crosses(v, start, place) for v in between)


def oracle_gains(space, field, sensor, floor_z, wanted):
    """Every candidate against every voxel in rational geometry."""
    blocking = (space.labels == Label.OCCUPIED) | (space.labels == Label.OUTSIDE)
    level = round((floor_z + sensor.height - space.origin[2]) / space.size * 8) * (SUB // 8)
    gains = np.full(field.mask.shape, NOT_EVALUATED)
    for row, column in np.argwhere(field.mask.data):
        place = (int(column) * SUB + SUB // 2, int(row) * SUB + SUB // 2, level)
        gain = 0
        for voxel in np.argwhere(wanted):
            ray = (voxel * SUB + SUB // 2 - place) * space.size / SUB
            distance, across = np.linalg.norm(ray), np.hypot(ray[0], ray[1])
            elevation = np.arctan2(ray[2], across)
            if sensor.elevation_min <= elevation <= sensor.elevation_max and distance >= sensor.range_min:
                gain += clear_by_slabs(blocking, voxel, place)
        gains[row, column] = gain
    return gains


@settings(max_examples=12, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.3, 0.8))
def test_gains_are_those_of_the_exhaustive_oracle(seed, height):
    space = random_space(seed, (7, 6, 9))
    cells = np.random.default_rng(seed).integers(0, (6, 7), (3, 2))
    sensor = Sensor(height, SENSOR.elevation_min, SENSOR.elevation_max, SENSOR.range_min, SENSOR.range_max)
    field = field_of(space, cells)
    _, gains = next_best_view(space, field, sensor, 0.0)
    expected = oracle_gains(space, field, sensor, 0.0, space.labels == Label.OCCLUDED)
    assert np.array_equal(gains.data, expected)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.02, 0.5))
def test_rays_walked_together_agree_with_rays_walked_alone(seed, density):
    rng = np.random.default_rng(seed)
    walls, outside = rng.random((2, 14, 12, 11)) < [[[[density]]], [[[0.05]]]]
    wanted = rng.random(walls.shape) < 0.3
    places = np.column_stack([rng.integers(0, (14, 12), (4, 2)) * SUB + SUB // 2, rng.integers(0, 11 * SUB, 4)])
    view = (-0.8, 1.7), (2.0 * SUB, 11.0 * SUB)
    words = ray_walk.words(wanted)
    columns = np.argwhere(words)
    sight = np.repeat(words[tuple(columns.T)][None], len(places), axis=0)
    together = ray_walk.look(ray_walk.words(walls), ray_walk.words(outside), columns, sight, places, *view)
    alone = ray_walk.count_visible(walls | outside, np.argwhere(wanted), places, *view)
    assert together.tolist() == alone.tolist()


def next_cycle(space, rng, grow):
    """What a scan does: some occluded voxels become empty or occupied; the room may grow, its array as well."""
    labels = space.labels.copy()
    shown = (labels == Label.OCCLUDED) & (rng.random(labels.shape) < 0.4)
    labels[shown] = rng.choice([Label.EMPTY, Label.OCCUPIED], np.count_nonzero(shown), p=(0.8, 0.2))
    if grow:
        labels[(labels == Label.OUTSIDE) & (rng.random(labels.shape) < 0.5)] = Label.OCCLUDED
        labels = np.pad(labels, ((1, 1), (0, 2), (0, 0)), constant_values=Label.OCCLUDED)
    origin = np.asarray(space.origin) - (np.array([1, 0, 0]) * space.size if grow else 0.0)
    return VoxelSpace(labels, tuple(origin), space.size)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from(["all", "surface"]), st.lists(st.booleans(), min_size=2, max_size=4))
def test_what_was_hidden_before_need_not_be_looked_at_again(seed, weight, growing):
    rng = np.random.default_rng(seed)
    space, sight = random_space(seed, (12, 10, 9), occupied=0.08, occluded=0.5), None
    for grow in growing:
        space = next_cycle(space, rng, grow)
        rows, columns = space.labels.shape[1::-1]
        field = field_of(space, rng.integers(0, (rows, columns), (25, 2)))
        ranking = rank_views(space, field, SENSOR, 0.0, weight=weight, earlier=sight)
        fresh, all_gains = next_best_view(space, field, SENSOR, 0.0, weight=weight)
        assert np.array_equal(ranking.gains.data, all_gains.data)
        assert np.array_equal(ranking.estimates.data, all_gains.data)
        assert ranking.choice == fresh
        sight = ranking.sight


def test_what_is_no_longer_occupied_hides_nothing():
    space = empty_room()
    space.labels[20, :, :] = Label.OCCUPIED
    space.labels[30, 15, 5] = Label.OCCLUDED
    sight = rank_views(space, field_of(space), SENSOR, 0.0).sight
    cleared = VoxelSpace(np.where(space.labels == Label.OCCUPIED, Label.EMPTY, space.labels), space.origin, space.size)
    gains = rank_views(cleared, field_of(space), SENSOR, 0.0, earlier=sight).gains
    assert gains.data[10, 5] == 1


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10_000))
def test_sight_is_the_same_both_ways_and_in_a_mirror(seed):
    rng = np.random.default_rng(seed)
    blocking = rng.random((8, 8, 8)) < 0.2
    a, b = rng.integers(0, 8, (2, 3))
    clear = ray_walk.is_clear(blocking, *a, *(b * SUB + SUB // 2))
    assert clear == ray_walk.is_clear(blocking, *b, *(a * SUB + SUB // 2))
    mirrored = np.ascontiguousarray(blocking[::-1])
    flip = np.array([7, 0, 0]) + np.array([-1, 1, 1]) * [a, b]
    assert clear == ray_walk.is_clear(mirrored, *flip[0], *(flip[1] * SUB + SUB // 2))


def test_a_hall_too_high_for_one_word_is_counted_all_the_same():
    rng = np.random.default_rng(1)
    blocking = rng.random((5, 5, 70)) < 0.1
    targets = np.argwhere(rng.random(blocking.shape) < 0.2)
    places = np.array([[2 * SUB + 32, 2 * SUB + 32, 33 * SUB + 7]])
    seen = ray_walk.count_visible(blocking, targets, places, (-np.inf, np.inf), (0.0, 1e9))
    assert seen[0] == sum(clear_by_slabs(blocking, target, tuple(places[0])) for target in targets)


def empty_room(shape=(40, 30, 20)):
    labels = np.full(shape, Label.EMPTY, np.uint8)
    return VoxelSpace(labels, (0.0, 0.0, -0.05), 0.1)


def test_a_voxel_behind_a_wall_is_seen_only_from_its_own_side():
    space = empty_room()
    space.labels[20, :, :] = Label.OCCUPIED
    space.labels[30, 15, 5] = Label.OCCLUDED
    _, gains = next_best_view(space, field_of(space), SENSOR, 0.0)
    assert np.all(gains.data[:, :20] == 0)
    assert gains.data[10, 25] == 1


def test_range_and_field_of_view_limit_the_gain():
    space = empty_room()
    space.labels[20, 15, 1] = Label.OCCLUDED
    near = Sensor(1.3, SENSOR.elevation_min, SENSOR.elevation_max, 0.0, 2.0)
    _, gains = next_best_view(space, field_of(space), near, 0.0)
    assert gains.data[15, 21] == 0  # below the cone
    assert gains.data[15, 35] == 1
    assert gains.data[15, 38] == 0  # 2.1 m away


def test_a_view_that_reaches_the_zenith_sees_what_is_straight_above():
    space = empty_room()
    space.labels[20, 15, 18] = Label.OCCLUDED
    dome = Sensor(0.55, -np.pi / 2, np.pi / 2, 0.0, 120.0)
    assert next_best_view(space, field_of(space, [(15, 20)]), dome, 0.0)[0].best[0].gain == 1
    assert next_best_view(space, field_of(space, [(15, 20)]), SENSOR, 0.0)[0].best[0].gain == 0


def test_a_sensor_outside_the_space_is_refused():
    with pytest.raises(FailureError, match="NBV_SENSOR_OUTSIDE"):
        next_best_view(empty_room(), field_of(empty_room()), Sensor(2.5, -0.7, 1.0, 0.5, 120.0), 0.0)


def test_ties_go_to_the_shorter_path_then_to_the_lower_index():
    space = empty_room()
    space.labels[20, 15, 19] = Label.OCCLUDED
    cells = [(5, 5), (5, 35), (25, 5), (25, 35)]
    path = np.ones((30, 40))
    path[25, 35] = 0.5
    shortest, _ = next_best_view(space, field_of(space, cells, path), SENSOR, 0.0)
    lowest, _ = next_best_view(space, field_of(space, cells), SENSOR, 0.0)
    assert {view.gain for view in shortest.best} == {1}
    assert (shortest.best[0].x, shortest.best[0].y) == pytest.approx((3.55, 2.55))
    assert (lowest.best[0].x, lowest.best[0].y) == pytest.approx((0.55, 0.55))


def test_travel_prefers_a_near_view_that_shows_a_little_less():
    space = empty_room()
    space.labels[20, :, :] = Label.OCCUPIED
    space.labels[5, 5:9, 8] = Label.OCCLUDED
    space.labels[35, 5:10, 8] = Label.OCCLUDED
    path = np.full((30, 40), 1.0)
    path[:, 20:] = 60.0
    cells = [(15, 10), (15, 30)]
    by_gain, _ = next_best_view(space, field_of(space, cells, path), SENSOR, 0.0)
    by_rate, _ = next_best_view(space, field_of(space, cells, path), SENSOR, 0.0, travel=Travel())
    assert [view.gain for view in by_gain.best] == [5, 4]
    assert [view.gain for view in by_rate.best] == [4, 5]


def test_avoided_discs_hold_no_view():
    space = random_space(3, (30, 24, 8), occupied=0.01)
    first, _ = next_best_view(space, field_of(space), SENSOR, 0.0)
    best = first.best[0]
    second, gains = next_best_view(space, field_of(space), SENSOR, 0.0, avoid=[(best.x, best.y, 0.5)])
    assert all(np.hypot(view.x - best.x, view.y - best.y) > 0.5 for view in second.best)
    assert second.candidates < first.candidates
    assert np.count_nonzero(gains.data == NOT_EVALUATED) == first.candidates - second.candidates


def test_no_candidate_gives_an_empty_choice():
    space = empty_room()
    choice, gains = next_best_view(space, field_of(space, np.empty((0, 2), int)), SENSOR, 0.0)
    assert (choice.best, choice.candidates) == ((), 0)
    assert np.all(gains.data == NOT_EVALUATED)


def test_coarse_to_fine_counts_fewer_cells_exactly_and_stays_near_the_best():
    space = random_space(5, (30, 24, 8), occupied=0.02)
    exact, all_gains = next_best_view(space, field_of(space), SENSOR, 0.0)
    quick = rank_views(space, field_of(space), SENSOR, 0.0, max_rays=200_000)
    counted = quick.gains.data != NOT_EVALUATED
    assert 0 < np.count_nonzero(counted) < 0.7 * counted.size
    assert np.array_equal(quick.gains.data[counted], all_gains.data[counted])
    assert quick.choice.best[0].gain >= 0.95 * exact.best[0].gain


def test_what_is_not_counted_is_estimated():
    """By a part of the voxels, and from a neighbour: the picture of the choice, not the choice."""
    space = random_space(5, (30, 24, 8), occupied=0.02)
    truth = next_best_view(space, field_of(space), SENSOR, 0.0)[1].data
    ranking = rank_views(space, field_of(space), SENSOR, 0.0, max_rays=1_000_000)
    counted = ranking.gains.data != NOT_EVALUATED
    assert np.array_equal(ranking.estimates.data[counted], truth[counted])
    error = np.abs(ranking.estimates.data - truth)[~counted] / truth.max()
    assert 0 < np.median(error) < 0.1


def test_listed_views_are_apart_and_ranked():
    space = random_space(6, (30, 24, 8), occupied=0.02)
    best = next_best_view(space, field_of(space), SENSOR, 0.0)[0].best
    places = np.array([(view.x, view.y) for view in best])
    apart = np.linalg.norm(places[:, None] - places[None], axis=2) + 9 * np.eye(len(best))
    assert 5 < len(best) <= 20
    assert apart.min() >= 0.5 - 1e-9
    assert [view.gain for view in best] == sorted((view.gain for view in best), reverse=True)


def test_surface_leaves_out_the_inside_of_what_is_unseen():
    space = empty_room()
    space.labels[10:20, 10:20, 5:15] = Label.OCCLUDED
    space.labels[0, :, :] = Label.OCCLUDED
    chosen = surface(space)
    assert chosen[0, 15, 10]
    assert chosen[10, 15, 10]
    assert not chosen[15, 15, 10]
    _, every = next_best_view(space, field_of(space, [(2, 30)]), SENSOR, 0.0)
    _, shell = next_best_view(space, field_of(space, [(2, 30)]), SENSOR, 0.0, weight="surface")
    assert 0 < shell.data.max() < every.data.max()
