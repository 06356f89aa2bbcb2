import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from perception import transforms
from perception.matching import thinning
from perception.matching.planes import fit_planes
from perception.matching.surfels import first_per_voxel, surface_of
from perception.scan import BeamPattern
from tests.synthetic import Scene, box

PATTERN = BeamPattern.with_step(np.deg2rad(0.8), (np.deg2rad(-40), np.deg2rad(60)), (0.5, 120.0))
COORDINATES = st.floats(-50, 50, width=32) | st.sampled_from([np.nan, np.inf, -np.inf, 1e9])
CLOUDS = arrays.arrays(np.float32, st.tuples(st.integers(0, 300), st.just(3)), elements=COORDINATES)


def usable(points):
    return points[(np.abs(points) < thinning.REACH).all(axis=1)]


@settings(max_examples=60, deadline=None)
@given(points=CLOUDS, size=st.sampled_from([0.03, 0.25, 4.0]))
def test_voxel_means_are_those_of_sorting(points, size):
    kept = usable(points)
    cells = np.floor(kept.astype(np.float64) * (1.0 / size)).astype(np.int64)
    _, group = np.unique(cells, axis=0, return_inverse=True)
    group = group.reshape(-1)
    expected = [kept[group == g].astype(float).mean(axis=0) for g in range(group.max(initial=-1) + 1)]
    found = thinning.voxel_means(points, size)
    assert len(found) == len(expected)
    if expected:
        assert np.allclose(
            np.sort(found, axis=0), np.sort(np.array(expected, np.float32), axis=0), rtol=1e-5, atol=1e-5
        )


@settings(max_examples=60, deadline=None)
@given(keys=arrays.arrays(np.int64, st.integers(0, 400), elements=st.integers(-9, 9) | st.integers(-(2**62), 2**62)))
def test_first_of_keys_is_that_of_sorting(keys):
    assert np.array_equal(thinning.first_of_keys(keys), np.sort(np.unique(keys, return_index=True)[1]))


def test_hash_table_grows_without_losing_a_voxel():
    points = np.random.default_rng(0).uniform(-40, 40, (200_000, 3)).astype(np.float32)
    assert len(thinning.voxel_means(points, 0.05)) == len(np.unique(np.floor(points.astype(float) / 0.05), axis=0))


@settings(max_examples=60, deadline=None)
@given(points=CLOUDS)
def test_view_cells_are_whole_degrees(points):
    cells, ranges = thinning.view_cells(points)
    good = (np.abs(points) < thinning.REACH).all(axis=1)
    assert (cells[~good] == -1).all()
    assert ((cells[good] >= 0) & (cells[good] < thinning.VIEW_ROWS * thinning.VIEW_COLUMNS)).all()
    # What is within a millimetre of the scanner has no direction to speak of.
    good &= np.nan_to_num(ranges) > 1e-3
    x, y, z = points[good].astype(np.float64).T
    assert np.allclose(ranges[good], np.linalg.norm(points[good].astype(np.float64), axis=1), rtol=1e-5)
    elevation = np.rad2deg(np.arctan2(z, np.hypot(x, y))) + 90.0
    azimuth = np.rad2deg(np.arctan2(y, x)) % 360.0
    row, column = np.divmod(cells[good], thinning.VIEW_COLUMNS)
    assert (np.abs(row + 0.5 - elevation) <= 0.501).all()
    turned = np.abs(column + 0.5 - azimuth)
    assert (np.minimum(turned, 360 - turned) <= 0.501).all()


def test_ranges_by_cell_and_their_shares_are_those_of_counting():
    rng = np.random.default_rng(1)
    cells = rng.integers(-1, 40, 3000).astype(np.int32)
    ranges = rng.uniform(1, 9, 3000).astype(np.float32)
    grouped, bounds = thinning.ranges_by_cell(cells, ranges)
    asked, limits = np.arange(45, dtype=np.int32), rng.uniform(1, 9, 45).astype(np.float32)
    shares = thinning.share_beyond(grouped, bounds, asked, limits)
    least = thinning.least_by_cell(cells, ranges)
    for cell, limit, share in zip(asked, limits, shares, strict=True):
        own = ranges[cells == cell]
        assert np.array_equal(np.sort(grouped[bounds[cell] : bounds[cell + 1]]), np.sort(own))
        assert share == pytest.approx(np.mean(own > limit) if len(own) else 0.0)
        assert least[cell] == (own.min() if len(own) else np.inf)


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), flatness=st.sampled_from([0.0, 1e-4, 0.01, 0.5]))
def test_planes_are_those_of_the_eigenvectors(seed, flatness):
    rng = np.random.default_rng(seed)
    points = (rng.normal(size=(200, 3)) * (1.0, 0.4, flatness * 0.2)).astype(np.float32)
    points += rng.uniform(-8, 8, 3).astype(np.float32)
    groups = rng.integers(0, len(points), (50, 14))
    centroids, normals, variances = fit_planes(points, groups)
    for group, centroid, normal, variance in zip(groups, centroids, normals, variances, strict=True):
        own = points[group].astype(np.float64)
        values, axes = np.linalg.eigh(np.cov(own.T, bias=True))
        assert np.allclose(centroid, own.mean(axis=0), atol=1e-5)
        assert np.allclose(variance, values, atol=1e-6)
        if values[0] < 0.5 * values[1]:
            assert abs(normal @ axes[:, 0]) > 1 - 1e-5


def test_surfels_lie_on_the_walls_and_look_at_the_scanner():
    scan = Scene(box((0, 0, 0), (6, 4, 3))).take(transforms.from_euler(0, 0, 0, (2, 1.5, 1.3)), PATTERN, noise=0.002)
    surfels = surface_of(scan.points).surfels
    points = surfels.points + np.float32([2, 1.5, 1.3])
    to_faces = np.abs(np.concatenate([points, points - np.float32([6, 4, 3])], axis=1))
    assert len(surfels) > 1000
    assert np.median(to_faces.min(axis=1)) < 0.002
    assert (np.einsum("ij,ij->i", surfels.points, surfels.normals) <= 0).all()
    assert np.isclose(np.abs(surfels.normals).max(axis=1), 1.0, atol=0.02).mean() > 0.95


def test_pane_that_beams_went_through_is_left_out():
    """The glass answers one beam in five; the wall 2 m behind it answers the others."""
    rng = np.random.default_rng(0)
    glass = np.c_[np.full(20_000, 3.0), rng.uniform(-1, 1, (20_000, 2))]
    wall = np.c_[np.full(80_000, 5.0), rng.uniform(-5 / 3, 5 / 3, (80_000, 2))]
    surfels = surface_of(np.vstack([glass, wall])).surfels
    assert np.count_nonzero(surfels.points[:, 0] > 4.9) > 100
    assert np.count_nonzero(surfels.points[:, 0] < 3.1) == 0


@pytest.mark.parametrize("count", [0, 1, 5])
def test_too_few_points_give_no_surface(count):
    assert len(surface_of(np.ones((count, 3))).surfels) == 0
    assert len(first_per_voxel(np.empty((0, 3), np.float32), 0.1)) == 0
