"""Every way for a scan to be rotten that the libraries accept in silence."""

from dataclasses import replace

import numpy as np
import pytest

from perception import transforms
from perception.failure import FailureError
from perception.validation import Limits, validate
from tests.synthetic import COARSE, Scene, box


@pytest.fixture(scope="module")
def scan():
    return Scene(box((-3, -2, 0), (4, 5, 3))).take(transforms.from_euler(0, 0, 0, (0, 0, 1.3)), COARSE)


def _code(scan, limits=None):
    with pytest.raises(FailureError) as error:
        validate(scan, limits)
    return error.value.failure.code


def _part(scan, chosen):
    return replace(scan, points=scan.points[chosen], intensity=scan.intensity[chosen], beam=scan.beam[chosen])


def _spoiled(scan, count, value):
    points = scan.points.copy()
    points[np.linspace(0, len(points) - 1, count).astype(int)] = value
    return replace(scan, points=points)


def test_a_good_scan_passes_unchanged(scan):
    valid = validate(scan)
    assert valid.dropped == 0
    assert np.array_equal(valid.scan.points, scan.points)
    assert valid.return_share > 0.99
    assert valid.extent == pytest.approx((7, 7, 3), abs=0.05)
    assert valid.empty_sector == 0


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, 500.0])
def test_a_few_bad_points_are_dropped(scan, value):
    valid = validate(_spoiled(scan, 20, value))
    assert valid.dropped == 20
    assert len(valid.scan.points) == len(valid.scan.beam) == len(valid.scan.intensity) == len(scan.points) - 20
    assert np.isfinite(valid.scan.points).all()


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0])
def test_many_bad_points_are_refused(scan, value):
    assert _code(_spoiled(scan, 200, value)) == "SCAN_INVALID"


@pytest.mark.parametrize("scale", [1000.0, 0.001, 1 / 60])
def test_wrong_units_are_refused(scan, scale):
    assert _code(replace(scan, points=scan.points * np.float32(scale))) == "SCAN_INVALID"


def test_nothing_but_nan_is_refused(scan):
    assert _code(replace(scan, points=np.full_like(scan.points, np.nan))) == "SCAN_INVALID"


def test_a_mirrored_scan_is_refused(scan):
    assert _code(replace(scan, points=scan.points * np.float32([1, -1, 1]))) == "SCAN_INVALID"


def test_an_empty_scan_is_refused(scan):
    assert _code(_part(scan, slice(0, 0))) == "SCAN_INVALID"


@pytest.mark.parametrize("beam", [-1, COARSE.size, 1])
def test_beams_that_cannot_be_are_refused(scan, beam):
    beams = scan.beam.copy()
    beams[0] = beam
    assert _code(replace(scan, beam=beams)) == "SCAN_INVALID"


def test_arrays_that_do_not_match_are_refused(scan):
    assert _code(replace(scan, intensity=scan.intensity[:-1])) == "SCAN_INVALID"


def test_a_scan_that_was_cut_short_is_incomplete(scan):
    assert _code(_part(scan, scan.beam % COARSE.columns < 0.6 * COARSE.columns)) == "SCAN_INCOMPLETE"


def test_a_scan_without_its_last_rows_is_incomplete(scan):
    assert _code(_part(scan, slice(0, int(0.9 * len(scan.points))))) == "SCAN_INCOMPLETE"


def test_the_open_sky_is_not_a_missing_part():
    court = Scene(box((-4, -3, -0.1), (5, 6, 0)), box((-4, -3, 0), (-3.9, 6, 2.5)), box((-4, 5.9, 0), (5, 6, 2.5)))
    assert validate(court.take(transforms.from_euler(0, 0, 0, (0, 0, 1.3)), COARSE)).return_share < 0.7


def test_a_near_wall_and_jambs_are_not_a_missing_part():
    near = replace(COARSE, range_min=1.5)
    corner = Scene(box((-0.5, -0.5, 0), (6, 5, 3)))
    valid = validate(corner.take(transforms.from_euler(0, 0, 0, (0, 0, 1.3)), near))
    assert valid.empty_sector > np.deg2rad(90)
    jambs = [box((-0.1, 0.45, 0), (0.1, 3, 3)), box((-0.1, -3, 0), (0.1, -0.45, 3)), box((-4, -3, 0), (4, 3, 3))]
    assert validate(Scene(*jambs).take(transforms.from_euler(0, 0, 0, (0, 0, 1.3)), near)).dropped == 0


def test_too_few_returns_are_incomplete(scan):
    assert _code(_part(scan, slice(None, None, 10))) == "SCAN_INCOMPLETE"


def test_limits_are_the_callers(scan):
    assert _code(scan, Limits(median_range=(10.0, 60.0))) == "SCAN_INVALID"
