import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import maximum_filter

from perception import transforms
from perception.rays.hits import enter, solid

SHAPE, SIZE, BEAMS = (7, 5, 6), 0.1, (50, 60)
ORIGIN = np.array([2.0, -1.0, 0.5])
SINGLE_PRECISION = 1e-4
"""Of a voxel's side."""


def entered(points, beam, pose):
    return enter(points, beam, pose, ORIGIN, SIZE, SHAPE, BEAMS)


@given(count=st.integers(0, 3000), seed=st.integers(0, 999), spread=st.floats(0.1, 3.0))
def test_every_point_is_counted_in_its_voxel_and_every_beam_has_its_range(count, seed, spread):
    """Any number of points, many of them outside, in any order."""
    rng = np.random.default_rng(seed)
    pose = transforms.from_euler(0.02, -0.01, 1.0, (2.3, -0.8, 0.8))
    points = rng.normal(0, spread, (count, 3)).astype(np.float32)
    place = (transforms.apply(pose, points.astype(float)) - ORIGIN) / SIZE
    at_a_face = np.any(np.abs(place - np.rint(place)) < SINGLE_PRECISION, axis=1)
    points, place = points[~at_a_face], place[~at_a_face]
    beam = rng.permutation(np.prod(BEAMS))[: len(points)].astype(np.int32)
    hits, ranges = entered(points, beam, pose)
    index = np.floor(place).astype(int)
    inside = index[np.all((index >= 0) & (index < SHAPE), axis=1)]
    expected = np.zeros(SHAPE, int)
    np.add.at(expected, tuple(inside.T), 1)
    assert np.array_equal(hits, expected)
    of_beam = np.zeros(BEAMS)
    of_beam.reshape(-1)[beam] = np.linalg.norm(points, axis=1)
    assert np.allclose(ranges, of_beam, rtol=1e-6, atol=0)


@given(seed=st.integers(0, 999), density=st.floats(0.01, 0.5), min_points=st.integers(1, 4))
def test_a_voxel_is_solid_by_its_points_or_by_company(seed, density, min_points):
    rng = np.random.default_rng(seed)
    hits = rng.poisson(density, SHAPE).astype(np.int32)
    around = np.ones((3, 3, 3), bool)
    around[1, 1, 1] = False
    company = maximum_filter(hits, footprint=around, mode="constant") > 0
    assert np.array_equal(solid(hits, min_points), (hits >= min_points) | ((hits > 0) & company))
