"""The one pass over a scan's points against the same rules in plain numpy."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from perception.intake.census import Kind, take_census
from perception.scan import BeamPattern

PATTERN = BeamPattern(40, 11, -0.6, 1.0, 0.5, 20.0)


def oracle(points: np.ndarray, beam: np.ndarray, pattern: BeamPattern) -> np.ndarray:
    """The kind of each point, slowly."""
    exists = (beam >= 0) & (beam < pattern.size)
    with np.errstate(all="ignore"):
        distance = np.linalg.norm(points.astype(np.float64), axis=1)
        along = np.einsum("ij,ij->i", points.astype(np.float64), pattern.directions(np.where(exists, beam, 0)))
        tolerance = max(np.deg2rad(1), 2 * pattern.azimuth_step, 2 * pattern.elevation_step)
        wrong = [
            (Kind.STRAY_BEAM, ~exists),
            (Kind.NOT_FINITE, ~np.isfinite(points).all(axis=1)),
            (Kind.TOO_NEAR, distance <= 0.9 * pattern.range_min),
            (Kind.TOO_FAR, distance >= 1.1 * pattern.range_max),
            (Kind.OFF_BEAM, along <= np.cos(tolerance) * distance),
        ]
    kind = np.select([mask for _, mask in wrong], [code for code, _ in wrong], Kind.GOOD)
    good = np.flatnonzero(kind == Kind.GOOD)
    again = np.setdiff1d(good, good[np.unique(beam[good], return_index=True)[1]])
    kind[again] = Kind.REPEATED_BEAM
    return kind


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 10_000), count=st.integers(0, 400), spoil=st.floats(0, 0.5))
def test_every_point_is_judged_as_by_numpy(seed, count, spoil):
    random = np.random.default_rng(seed)
    beam = random.integers(0, PATTERN.size, count).astype(np.int32)
    points = PATTERN.directions(beam) * random.uniform(0.6, 19, (count, 1)).astype(np.float32)
    spoiled = random.random((count, 3)) < spoil
    values = np.array([np.nan, np.inf, -np.inf, 0.0, 1e9, -3.0, 1e30], np.float32)
    points[spoiled] = random.choice(values, int(spoiled.sum()))
    beam[random.random(count) < spoil / 5] = random.choice([-1, PATTERN.size, 2**31 - 1])
    census = take_census(points, beam, PATTERN)
    expected = oracle(points, beam, PATTERN)
    np.testing.assert_array_equal(census.kind, expected)
    np.testing.assert_array_equal(census.counts, np.bincount(expected, minlength=len(Kind)))
    good = expected == Kind.GOOD
    image = np.zeros(PATTERN.size, int)
    image[beam[good]] = 1
    image = image.reshape(PATTERN.rows, PATTERN.columns)
    np.testing.assert_array_equal(census.rows, image.sum(axis=1))
    np.testing.assert_array_equal(census.columns, image.sum(axis=0))
    if good.any():
        np.testing.assert_allclose(census.low, points[good].min(axis=0))
        np.testing.assert_allclose(census.high, points[good].max(axis=0))


def test_arrays_that_may_not_be_written_to_are_judged_too():
    points = np.frombuffer(np.ones((5, 3), np.float32).tobytes(), np.float32).reshape(5, 3)
    assert take_census(points, np.frombuffer(np.zeros(5, np.int32).tobytes(), np.int32), PATTERN).counts.sum() == 5


@settings(max_examples=40, deadline=None)
@given(columns=st.integers(4, 400), rows=st.integers(2, 60), step=st.integers(1, 9))
def test_a_coarser_pattern_looks_where_the_fine_one_did(columns, rows, step):
    fine = BeamPattern(columns, rows, -0.6, 1.0, 0.5, 20.0)
    coarse = fine.every(step)
    up, across = fine.strides(step)
    row, column = np.divmod(np.arange(coarse.size), coarse.columns)
    same = fine.directions(row * up * fine.columns + column * across)
    np.testing.assert_allclose(coarse.directions(), same, atol=1e-6)
