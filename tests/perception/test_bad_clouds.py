"""No cloud whatever crashes a stage or is taken for a room that it is not: each is refused by name, or its result is
sane."""

import inspect
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers import scan_file
from mission import stages
from mission.stages.scan_library import Library
from mission.store import RunFolder
from perception import transforms, validation
from perception.failure import FailureError
from perception.findings import Alignment, Registration, RoomShape
from perception.intake import misfits, repeats
from perception.scan import BeamPattern, Scan
from perception.validation import Limits
from tests.perception import rooms

MOUNT = transforms.from_euler(0, 0, 0, (0, 0, 1.3))
PATTERN = BeamPattern.with_step(np.deg2rad(2.0), (np.deg2rad(-40), np.deg2rad(60)), (0.5, 120.0))
ANYTHING = Limits(
    bad_share=1.0,
    extent=(0.0, np.inf),
    median_range=(0.0, np.inf),
    return_share=0.0,
    empty_sector=7.0,
    cut_sector=7.0,
    cut_rows=1.0,
    flatness=0.0,
)
"""A validator that is asleep: the stages behind it must not rely on it to stay alive."""
FAMILIES = ("SCAN_", "ALIGN_", "REG_", "SEGMENT_", "MAP_", "VOXELS_", "NBV_", "DOORS_", "CONTOUR_")
ROOM = rooms.two_rooms(rooms.CABINET)
GOOD = replace(ROOM.take(transforms.planar(2.6, 2.6, 0.3) @ MOUNT, PATTERN, scan_id="S01"), base_from_scanner=MOUNT)
NEXT = replace(
    ROOM.take(transforms.planar(4.2, 1.8, 0.1) @ MOUNT, PATTERN, seed=1, scan_id="S02"), base_from_scanner=MOUNT
)
ENCODED = scan_file.encode(GOOD)
SOME = settings(
    max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow]
)


def with_points(points: np.ndarray, beams: np.ndarray | None = None) -> Scan:
    """A scan of any points, on the beams that look nearest to them unless others are given."""
    points = np.asarray(points, np.float32)
    if beams is None:
        with np.errstate(all="ignore"):
            beams = np.maximum(PATTERN.beams_towards(np.nan_to_num(points, posinf=1.0, neginf=-1.0)), 0)
        beams, first = np.unique(beams, return_index=True)
        points = points[first]
    return replace(GOOD, points=points, beam=beams.astype(np.int32), intensity=np.ones(len(points), np.float32))


def rays() -> np.ndarray:
    return PATTERN.directions()


def on_plane(normal: tuple[float, float, float], offset: float) -> Scan:
    along = rays() @ np.asarray(normal, np.float32)
    hit = np.flatnonzero(along > 0.02)
    return with_points(rays()[hit] * (offset / along[hit])[:, None], hit)


def some_replaced(value: float, share: float) -> Scan:
    points = GOOD.points.copy()
    points[np.random.default_rng(0).random(len(points)) < share] = value
    return replace(GOOD, points=points)


BAD = {
    "no points": with_points(np.empty((0, 3))),
    "one point": with_points([[2.0, 0.0, 0.0]]),
    "two points": with_points([[2.0, 0.0, 0.0], [0.0, 2.0, 0.0]]),
    "one point over and over": with_points(np.full((500, 3), 2.0), np.arange(500)),
    "every point twice": with_points(np.repeat(GOOD.points, 2, axis=0)[: len(GOOD.beam)], GOOD.beam),
    "only the origin": with_points(np.zeros((500, 3)), np.arange(500)),
    "only NaN": with_points(np.full((500, 3), np.nan), np.arange(500)),
    "only infinity": with_points(np.full((500, 3), -np.inf), np.arange(500)),
    "one hundredth NaN": some_replaced(np.nan, 0.01),
    "one hundredth infinite": some_replaced(np.inf, 0.01),
    "one hundredth at 1e9": some_replaced(1e9, 0.01),
    "all at 1e30": replace(GOOD, points=GOOD.points * np.float32(1e30)),
    "all at 1e-30": replace(GOOD, points=GOOD.points * np.float32(1e-30)),
    "in one line": with_points(np.linspace(1, 50, 3000)[:, None] * np.ones(3)),
    "on the floor alone": on_plane((0.0, 0.0, -1.0), 1.3),
    "on one wall alone": on_plane((1.0, 0.0, 0.0), 3.0),
    "on a sphere": with_points(rays() * 4.0, np.arange(PATTERN.size)),
    "noise in the air": with_points(
        rays() * np.random.default_rng(2).uniform(1, 9, (PATTERN.size, 1)), np.arange(PATTERN.size)
    ),
    "in millimetres": replace(GOOD, points=GOOD.points * np.float32(1000)),
    "in feet": replace(GOOD, points=GOOD.points / np.float32(0.3048)),
    "mirrored": replace(GOOD, points=GOOD.points * np.float32([1, -1, 1])),
    "upside down": replace(GOOD, points=GOOD.points * np.float32([1, -1, -1])),
    "shuffled": replace(GOOD, points=np.random.default_rng(3).permutation(GOOD.points)),
}
REFUSED_AT_ONCE = set(BAD) - {"on a sphere", "noise in the air"}


def library(folder: Path, bad: Scan, limits: Limits | None = None) -> Library:
    run = RunFolder.at(folder)
    for scan in (replace(bad, scan_id="B01"), NEXT):
        scan_file.write(run.scan_file(scan.scan_id), scan)
    return Library(run, limits)


def every_stage(library: Library, but: tuple[str, ...] = ()) -> dict[str, object]:
    """What each stage makes of the bad scan B01: its result, or the failure it is refused with."""
    here, there = MOUNT.tolist(), (transforms.planar(1.6, -0.8, -0.2) @ MOUNT).tolist()
    scan, both = {"scan_id": "B01"}, [("S02", there), ("B01", here)]
    room = {"room_id": "R1", "cycle": 1}
    guess = {"guess": here, "reference": [("S02", there)], "error_m": 0.5, "error_rad": 0.2}
    outline = {"seed": (0.0, 0.0), "doors": (), "others": (), "previous": None}
    corners = np.array([[-2.6, -2.6], [3.4, -2.6], [3.4, 2.4], [-2.6, 2.4]])
    shape = RoomShape(corners, 0.0, 3.0, np.column_stack([corners, np.roll(corners, -1, axis=0)]))
    drawn = {"pose": here, "shape": shape, "doors": (), "previous": None, "track": [(0.0, 0.0, 0.0)]}
    calls = {
        "validate_scan": scan,
        "align_scan": scan,
        "anchor_scan": scan,
        "register_scan": scan | guess,
        "register_globally": scan | guess,
        "segment_room": room | outline | {"scans": [("B01", here)]},
        "build_map": room | scan | drawn,
        "label_space": room | {"shape": shape, "scans": both, "voxel": 0.2, "labeller": "range"},
        "find_doors": {"room_id": "R1", "shape": shape, "scans": both},
    }
    results: dict[str, object] = {}
    for stage, arguments in calls.items():
        if stage in but:
            continue
        try:
            results[stage] = stages.run(library, stage, arguments)
        except FailureError as error:
            results[stage] = error.failure
            assert error.failure.code.startswith(FAMILIES) and error.failure.message, (stage, error)
    return results


def assert_sane(results: dict[str, object]) -> None:
    """What was not refused makes sense by itself."""
    for result in results.values():
        if isinstance(result, Registration):
            assert np.isfinite(result.map_from_scanner).all()
            rotation = result.map_from_scanner[:3, :3]
            np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-5)
        if isinstance(result, Alignment):
            assert max(abs(result.roll), abs(result.pitch)) < np.deg2rad(7)
            assert 0.9 < result.scanner_height < 1.7, "the mounting is known to be 1.3 m high"
        if isinstance(result, RoomShape):
            assert np.isfinite(result.contour).all() and 0 < result.area < 1e4
            assert result.floor_z < result.ceiling_z


@pytest.mark.parametrize("name", sorted(REFUSED_AT_ONCE))
def test_a_bad_cloud_is_refused_by_its_own_name_before_anything_believes_it(tmp_path, name):
    results = every_stage(library(tmp_path, BAD[name]))
    codes = {getattr(result, "code", None) for result in results.values()}
    assert len(codes) == 1, f"every stage that needs the scan says the same: {results}"
    assert codes.pop() in validation.__doc__


@pytest.mark.parametrize("name", sorted(set(BAD) - REFUSED_AT_ONCE))
def test_what_passes_validation_is_no_room_to_a_later_stage(tmp_path, name):
    results = every_stage(library(tmp_path, BAD[name]))
    assert_sane(results)
    for stage in ("register_scan", "register_globally"):
        assert results[stage].code.startswith("REG_"), "it is of no place, least of all of this one"


def test_the_good_cloud_passes_every_stage(tmp_path):
    results = every_stage(library(tmp_path, GOOD))
    assert_sane(results)
    assert not [result for result in results.values() if hasattr(result, "code")]


@pytest.mark.parametrize("name", sorted(REFUSED_AT_ONCE))
def test_stages_live_through_bad_clouds_that_nobody_validated(tmp_path, name):
    assert_sane(every_stage(library(tmp_path, BAD[name], ANYTHING), but=("register_globally",)))


@SOME
@given(
    kind=st.sampled_from([np.nan, np.inf, -np.inf, 1e9, -1e9, 0.0, 1e-12]),
    share=st.floats(0.0, 1.0),
    axis=st.sampled_from([0, 1, 2, slice(None)]),
    seed=st.integers(0, 99),
)
def test_points_gone_wrong_are_left_out_or_refused(kind, share, axis, seed):
    points = GOOD.points.copy()
    chosen = np.flatnonzero(np.random.default_rng(seed).random(len(points)) < share**4)
    points[chosen, axis] = kind
    spoiled = replace(GOOD, points=points)
    try:
        verdict = validation.validate(spoiled)
    except FailureError as error:
        assert error.failure.code in validation.__doc__
        return
    kept = spoiled.without(verdict.bad)
    truth = np.delete(GOOD.points, verdict.bad, axis=0)
    # A coordinate that became nothing may leave the point within a degree of its beam; then it is nearly right.
    tolerance = 2.1 * PATTERN.azimuth_step * np.linalg.norm(truth, axis=1)
    assert (np.linalg.norm(kept.points - truth, axis=1) <= tolerance).all()


@SOME
@given(st.integers(0, len(ENCODED) - 1), st.binary(min_size=1, max_size=64))
def test_a_mutated_file_is_never_taken_for_a_scan(tmp_path, place, data):
    mutated = (ENCODED[:place] + data + ENCODED[place + len(data) :])[: len(ENCODED)]
    if mutated != ENCODED:
        refuse(tmp_path, mutated)


@SOME
@given(st.integers(0, len(ENCODED) - 1))
def test_a_truncated_file_is_named_as_such(tmp_path, length):
    assert refuse(tmp_path, ENCODED[:length]) == "SCAN_TRUNCATED"


def refuse(folder: Path, data: bytes) -> str:
    run = RunFolder.at(folder)
    run.scan_file("B01").write_bytes(data)
    with pytest.raises(FailureError) as error:
        stages.run(Library(run), "validate_scan", {"scan_id": "B01"})
    assert error.value.failure.code in scan_file.__doc__
    return error.value.failure.code


def test_every_code_of_the_table_is_raised_somewhere():
    source = "".join(inspect.getsource(module) for module in (validation, misfits, repeats))
    table = [line.split()[0] for line in validation.__doc__.splitlines() if line.startswith("SCAN_")]
    assert len(table) > 10 and all(f'"{code}"' in source for code in table)
