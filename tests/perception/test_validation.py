"""Every way for a scan to be rotten that the libraries accept in silence."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest

from perception import transforms, validation
from perception.failure import FailureError
from perception.scan import BeamPattern
from perception.validation import Limits, validate
from tests.synthetic import COARSE, Scene, box


@pytest.fixture(scope="module")
def scan():
    return Scene(box((-3, -2, 0), (4, 5, 3))).take(transforms.from_euler(0, 0, 0, (0, 0, 1.3)), COARSE)


MOUNT = transforms.from_euler(0, 0, 0, (0, 0, 1.3))


def _failure(scan, limits=None, earlier=()):
    with pytest.raises(FailureError) as error:
        validate(scan, limits, earlier)
    return error.value.failure


def _code(scan, limits=None, earlier=()):
    return _failure(scan, limits, earlier).code


def _part(scan, chosen):
    return replace(scan, points=scan.points[chosen], intensity=scan.intensity[chosen], beam=scan.beam[chosen])


def _spoiled(scan, count, value):
    points = scan.points.copy()
    points[np.linspace(0, len(points) - 1, count).astype(int)] = value
    return replace(scan, points=points)


def test_a_good_scan_passes_unchanged(scan):
    valid = validate(scan)
    assert valid.dropped == 0
    assert scan.without(valid.bad) is scan
    assert valid.return_share > 0.99
    assert valid.extent == pytest.approx((7, 7, 3), abs=0.05)
    assert valid.empty_sector == 0


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, 500.0])
def test_a_few_bad_points_are_dropped(scan, value):
    spoiled = _spoiled(scan, 20, value)
    valid = validate(spoiled)
    assert valid.dropped == 20
    cleaned = spoiled.without(valid.bad)
    assert len(cleaned.points) == len(cleaned.beam) == len(cleaned.intensity) == len(scan.points) - 20
    assert np.array_equal(cleaned.points, np.delete(scan.points, valid.bad, axis=0))


@pytest.mark.parametrize(
    ("value", "code"),
    [(np.nan, "SCAN_NOT_FINITE"), (np.inf, "SCAN_NOT_FINITE"), (0.0, "SCAN_RANGE"), (1e9, "SCAN_RANGE")],
)
def test_many_bad_points_are_refused(scan, value, code):
    assert _code(_spoiled(scan, 200, value)) == code


@pytest.mark.parametrize(
    ("scale", "unit"),
    [(1000.0, "millimetres"), (100.0, "centimetres"), (0.001, "kilometres")],
)
def test_wrong_units_are_named(scan, scale, unit):
    failure = _failure(replace(scan, points=scan.points * np.float32(scale)))
    assert failure.code == "SCAN_UNITS" and failure.evidence["unit"] == unit and unit in failure.message


def test_feet_are_told_by_the_floor_below_a_scanner_whose_mounting_is_known(scan):
    feet = replace(scan, points=scan.points / np.float32(0.3048))
    assert validate(feet).dropped == 0, "a larger room might look like that"
    failure = _failure(replace(feet, base_from_scanner=MOUNT))
    assert failure.code == "SCAN_UNITS" and failure.evidence["unit"] == "feet"
    assert validate(replace(scan, base_from_scanner=MOUNT)).dropped == 0


def test_a_floor_at_another_height_is_no_other_unit(scan):
    pit = Scene(box((-3, -2, -2.9), (4, 5, 3)), box((-1, -1, -2.9), (1, 1, 0)))
    on_a_table = pit.take(transforms.from_euler(0, 0, 0, (0, 0, 1.3)), COARSE)
    assert validate(replace(on_a_table, base_from_scanner=MOUNT)).dropped == 0


@pytest.mark.parametrize("scale", [1 / 60, 1e-8, 1e8])
def test_what_no_unit_explains_is_out_of_range(scan, scale):
    assert _code(replace(scan, points=scan.points * np.float32(scale))) == "SCAN_RANGE"


def test_nothing_but_nan_is_refused(scan):
    assert _code(replace(scan, points=np.full_like(scan.points, np.nan))) == "SCAN_NOT_FINITE"


@pytest.mark.parametrize("signs", [[1, -1, 1], [-1, 1, 1], [1, 1, -1], [-1, -1, -1]])
def test_a_mirrored_scan_is_refused(scan, signs):
    failure = _failure(replace(scan, points=scan.points * np.float32(signs)))
    assert failure.code == "SCAN_MIRRORED"
    np.testing.assert_allclose(failure.evidence["points_from_beams"], np.diag(signs), atol=0.01)


def test_swapped_axes_mirror_and_rolled_axes_turn(scan):
    assert _code(replace(scan, points=scan.points[:, [1, 0, 2]])) == "SCAN_MIRRORED"
    assert _code(replace(scan, points=scan.points[:, [1, 2, 0]])) == "SCAN_TURNED"
    turned = transforms.apply(transforms.from_euler(0, 0, np.pi / 2), scan.points)
    assert _failure(replace(scan, points=turned)).evidence["degrees"] == pytest.approx(90, abs=0.5)


def test_points_of_another_pattern_are_refused(scan):
    other = BeamPattern.with_step(np.deg2rad(0.8), (np.deg2rad(-30), np.deg2rad(90)), (0.5, 120.0))
    assert _code(replace(scan, pattern=other)) == "SCAN_BEAMS"
    shuffled = np.random.default_rng(0).permutation(scan.points)
    assert _code(replace(scan, points=shuffled)) == "SCAN_BEAMS"


def test_an_empty_scan_is_refused(scan):
    assert _code(_part(scan, slice(0, 0))) == "SCAN_EMPTY"


@pytest.mark.parametrize("beam", [-1, COARSE.size, 1])
def test_beams_that_cannot_be_are_refused(scan, beam):
    beams = scan.beam.copy()
    beams[0] = beam
    points = scan.points.copy()
    points[0] = points[1]
    assert _code(replace(scan, beam=beams, points=points)) == "SCAN_BEAMS"


@pytest.mark.parametrize(
    "spoil",
    [
        lambda scan: {"intensity": scan.intensity[:-1]},
        lambda scan: {"beam": scan.beam[:-1]},
        lambda scan: {"points": scan.points[:, :2]},
        lambda scan: {"points": scan.points.astype(int)},
        lambda scan: {"beam": scan.beam.astype(float)},
    ],
)
def test_arrays_that_do_not_match_are_refused(scan, spoil):
    assert _code(replace(scan, **spoil(scan))) == "SCAN_MISMATCHED"


@pytest.mark.parametrize(
    "change",
    [
        {"elevation_min": 5.0},
        {"elevation_min": COARSE.elevation_max},
        {"elevation_max": np.nan},
        {"range_min": 200.0},
        {"range_max": -1.0},
        {"columns": 0},
        {"rows": 1},
    ],
)
def test_a_pattern_that_no_scanner_has_is_refused(scan, change):
    assert _code(replace(scan, pattern=replace(COARSE, **change))) == "SCAN_PATTERN"


def test_a_pattern_far_larger_than_the_scan_allocates_nothing(scan):
    huge = replace(COARSE, columns=1 << 30, rows=1 << 30)
    tracemalloc.start()
    try:
        assert _code(replace(scan, pattern=huge)) == "SCAN_FEW_RETURNS"
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()


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


def test_too_few_returns_are_refused(scan):
    assert _code(_part(scan, slice(None, None, 10))) == "SCAN_FEW_RETURNS"


def test_limits_are_the_callers(scan):
    assert _code(scan, Limits(median_range=(10.0, 60.0))) == "SCAN_EXTENT"
    assert _code(scan, Limits(extent=(10.0, 60.0))) == "SCAN_EXTENT"


def test_a_plane_and_a_line_are_no_room(scan):
    down = COARSE.directions()[:, 2] < -0.1
    beams = np.flatnonzero(down).astype(np.int32)
    rays = COARSE.directions(beams)
    floor = replace(scan, points=rays * (-1.3 / rays[:, 2:]), beam=beams, intensity=np.ones(len(beams), np.float32))
    assert "in one plane" in _failure(floor).message and _code(floor) == "SCAN_FLAT"
    row = _part(scan, scan.beam // COARSE.columns == 40)
    assert _code(row, Limits(return_share=0.0)) == "SCAN_FLAT"
    one = _part(scan, slice(0, 1))
    assert _code(one) == "SCAN_FEW_RETURNS" and _code(one, Limits(return_share=0.0)) == "SCAN_EXTENT", (
        "it has no extent"
    )


def _taken(x, seed, name, noise=0.003, odometry=None):
    """A scan in a bare corridor, which looks the same from every spot."""
    corridor = Scene(box((-30, -1, 0), (30, 1, 2.5)))
    taken = corridor.take(transforms.from_euler(0, 0, 0, (x, 0, 1.3)), COARSE, noise, seed, name)
    return replace(taken, odom_from_base=transforms.planar(x if odometry is None else odometry, 0, 0))


def test_the_same_scan_under_another_name_is_refused():
    first = validate(_taken(0.0, 0, "S01")).fingerprint
    failure = _failure(_taken(0.0, 0, "S02"), None, [first])
    assert failure.code == "SCAN_REPEATED" and failure.evidence["repeats"] == "S01"


def test_nearly_the_same_scan_after_a_drive_is_refused():
    scan = _taken(0.0, 0, "S01")
    again = replace(scan, scan_id="S02", points=scan.points * np.float32(1 + 1e-5))
    first = validate(scan).fingerprint
    assert _code(replace(again, odom_from_base=transforms.planar(2, 0, 0)), None, [first]) == "SCAN_REPEATED"
    assert _code(replace(again, odom_from_base=transforms.planar(0, 0, 0.5)), None, [first]) == "SCAN_REPEATED"


def test_a_new_scan_from_the_same_spot_or_further_down_a_corridor_is_none_again():
    first = validate(_taken(0.0, 0, "S01")).fingerprint
    assert validate(_taken(0.0, 1, "S02"), None, [first]).dropped == 0
    assert validate(_taken(2.0, 2, "S03"), None, [first]).dropped == 0


def test_a_scan_is_not_compared_with_itself():
    scan = _taken(0.0, 0, "S01")
    assert validate(scan, None, [validate(scan).fingerprint]).dropped == 0


def test_every_code_is_documented_and_every_message_says_what_to_expect_and_do(scan):
    spoiled = [
        _spoiled(scan, 200, np.nan),
        _part(scan, slice(0, 0)),
        replace(scan, points=scan.points * np.float32(1000)),
        replace(scan, points=scan.points * np.float32([1, -1, 1])),
        replace(scan, intensity=scan.intensity[:-1]),
    ]
    for bad in spoiled:
        failure = _failure(bad)
        assert failure.code in validation.__doc__ and "expected" in failure.message and failure.evidence
