"""Levels and intervals of the Z-histogram."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perception.failure import FailureError
from perception.segmentation import floor_and_ceiling, histogram, local_maxima, one_per_voxel, peak_interval


def _plane(rng, z, area, at=(0.0, 0.0), noise=0.003, density=400):
    count = int(area * density)
    side = np.sqrt(area)
    return np.column_stack([rng.uniform(0, side, (count, 2)) + at, rng.normal(z, noise, count)])


def _walls(rng, side, height, density=400):
    count = int(4 * side * height * density)
    xy = rng.uniform(0, side, (count, 2))
    xy[np.arange(count), rng.integers(0, 2, count)] = rng.choice([0.0, side], count)
    return np.column_stack([xy, rng.uniform(0, height, count)])


@settings(max_examples=25, deadline=None)
@given(st.floats(-3, 3), st.floats(0.002, 0.02))
def test_interval_holds_its_plane_wherever_the_bins_lie(z, noise):
    values = np.random.default_rng(1).normal(z, noise, 20_000)
    h = histogram(values)
    interval = peak_interval(h, int(np.argmax(h.counts)))
    assert np.mean(interval.contains(values)) > 0.95
    assert interval.peak == pytest.approx(z, abs=0.01)
    assert interval.high - interval.low < 8 * noise + 0.08


def test_interval_stops_at_the_walls_that_fill_every_height():
    rng = np.random.default_rng(0)
    values = np.concatenate([rng.normal(0, 0.003, 20_000), rng.uniform(0, 3, 30_000)])
    h = histogram(values)
    assert peak_interval(h, int(np.argmax(h.counts))).high < 0.08


def test_local_maxima_of_a_plateau_are_counted_once():
    assert list(local_maxima(np.array([0.0, 5, 5, 0, 0, 0, 0, 7, 0]))) == [1, 7]


def test_one_point_per_voxel_makes_numbers_go_with_area():
    rng = np.random.default_rng(0)
    dense, sparse = _plane(rng, 0, 4.0, density=20_000), _plane(rng, 2.5, 4.0, density=2_000)
    chosen = one_per_voxel(np.concatenate([dense, sparse]), 0.05)
    low = np.count_nonzero(chosen < len(dense))
    assert low == pytest.approx(len(chosen) - low, rel=0.3)


def test_tables_lamps_and_shelves_are_neither_floor_nor_ceiling():
    rng = np.random.default_rng(0)
    cloud = [_plane(rng, 0, 20), _plane(rng, 3.0, 30), _walls(rng, 5.5, 3.0)]
    cloud += [_plane(rng, 0.74, 12), _plane(rng, 1.8, 4), _plane(rng, 2.7, 0.6)]
    levels = floor_and_ceiling(np.concatenate(cloud))
    assert levels.floor.peak == pytest.approx(0, abs=0.005)
    assert [level.peak for level in levels.ceilings] == pytest.approx([3.0], abs=0.005)


def test_a_lowered_part_is_a_second_ceiling():
    rng = np.random.default_rng(0)
    cloud = [_plane(rng, 0, 20), _plane(rng, 3.0, 22), _plane(rng, 2.6, 8), _walls(rng, 5.5, 3.0)]
    levels = floor_and_ceiling(np.concatenate(cloud))
    assert [level.peak for level in levels.ceilings] == pytest.approx([2.6, 3.0], abs=0.005)
    assert levels.ceiling is not None
    assert levels.ceiling.peak == pytest.approx(3.0, abs=0.005)


def test_walls_alone_are_no_ceiling():
    rng = np.random.default_rng(0)
    levels = floor_and_ceiling(np.concatenate([_plane(rng, 0, 30), _walls(rng, 5.5, 2.5)]))
    assert levels.ceilings == ()


def test_a_cloud_without_a_floor_is_refused():
    with pytest.raises(FailureError, match="SEGMENT_NO_FLOOR"):
        floor_and_ceiling(_plane(np.random.default_rng(0), 2.0, 10))


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 9999), st.sampled_from([0.02, 0.05, 1.0]))
def test_one_point_is_left_of_each_cube_the_first(seed, size):
    points = np.random.default_rng(seed).normal(0, 1.5, (2000, 3)).astype(np.float32)
    chosen = one_per_voxel(points, size)
    cubes = np.floor(points.astype(float) / size)
    assert np.array_equal(chosen, np.sort(np.unique(cubes, axis=0, return_index=True)[1]))


def test_a_sample_is_drawn_evenly_from_the_whole_scan():
    points = np.column_stack([np.arange(10_000), np.zeros((10_000, 2))])
    chosen = one_per_voxel(points, 0.5, limit=1000)
    assert np.array_equal(chosen // 10, np.arange(1000))
