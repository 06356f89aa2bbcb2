"""Leaves that give a scan its place."""

import math

import numpy as np
import pytest
from py_trees.common import Status

from behaviours.keys import Key
from behaviours.mapping import AnchorScan, PlaceScanSetAside, RegisterGlobally, RegisterScan, SetScanAside, guess
from behaviours.scanning import AlignScan, FetchScan, TakeScan, ValidateScan
from behaviours.survey import Survey
from perception import transforms
from perception.failure import FailureError
from perception.findings import Alignment
from tests.behaviours.bench import (
    LEVEL,
    MOUNT,
    Bench,
    current,
    get,
    placed,
    put,
    receipt,
    scan,
    standing,
    survey_of,
    tick,
)


def arguments(bench: Bench) -> dict[str, object]:
    name, _, sent = bench.calls[-1]
    assert name == "submit"
    return sent


# --- scanning -------------------------------------------------------------------------------------------------------


def test_each_order_has_a_name_of_its_own_even_when_the_last_one_failed() -> None:
    bench, leaf = Bench(), TakeScan("take")
    bench.set_up(leaf)
    put(SURVEY=Survey(), BASE=standing())
    for number in (1, 2):
        assert tick(leaf) == Status.RUNNING
        assert bench.calls[-1][1][0] == f"S0{number}"
        bench.job.failed("SCAN_FAILED")
        assert tick(leaf) == Status.FAILURE


def test_while_a_scan_is_taken_no_drive_moves_the_base() -> None:
    bench, leaf = Bench(), TakeScan("take")
    bench.set_up(leaf)
    put(SURVEY=Survey(), BASE=standing())
    interlock = bench.services.interlock
    interlock.set_out("a drive")
    tick(leaf)
    assert not interlock.lets_drive(bench.clock.now())
    bench.job.done(receipt("S01"))
    tick(leaf)
    assert interlock.lets_drive(bench.clock.now())


@pytest.mark.parametrize(("code", "turns_on"), [("AGENT_UNREACHABLE", True), ("SCAN_FAILED", False)])
def test_a_scan_that_nobody_tells_of_any_more_keeps_the_base_for_as_long_as_it_may_take(
    code: str, turns_on: bool
) -> None:
    bench, leaf = Bench(), TakeScan("take")
    bench.set_up(leaf)
    put(SURVEY=Survey(), BASE=standing())
    interlock, began = bench.services.interlock, bench.clock.now()
    interlock.set_out("a drive")
    tick(leaf)
    bench.clock.sleep(10.0)
    bench.job.failed(code)
    assert tick(leaf) == Status.FAILURE
    leaf.stop(Status.INVALID)
    limit = bench.services.settings.scanning.timeout_s
    free = [interlock.lets_drive(began + seconds) for seconds in (10.0, limit - 0.1, limit)]
    assert free == [not turns_on, not turns_on, True]
    tick(leaf)
    bench.job.done(receipt("S02"))
    tick(leaf)
    assert interlock.lets_drive(bench.clock.now()), "a scan after it is the scanner's own word that it is over"


def test_the_first_scan_has_no_guess_whatever_the_base_believes() -> None:
    bench, leaf = Bench(), TakeScan("take")
    bench.set_up(leaf)
    put(SURVEY=Survey(), BASE=standing(map_from_base=np.eye(4)))
    tick(leaf)
    assert get(Key.SCAN).map_from_base_guess is None


@pytest.mark.parametrize("localised", [True, False])
def test_the_guess_is_the_bases_own_localisation_or_else_odometry(localised: bool) -> None:
    bench, leaf = Bench(), TakeScan("take")
    bench.set_up(leaf)
    own = transforms.planar(2.2, 0.1, 0.0)
    put(
        SURVEY=survey_of(scan("S01")).with_drive(((2.0, 0.0, 0.0),), 2.0),
        BASE=standing(2.0, map_from_base=own if localised else None),
    )
    tick(leaf)
    assert np.allclose(get(Key.SCAN).map_from_base_guess, own if localised else transforms.planar(2.0, 0.0, 0.0))
    assert get(Key.SCAN).guess_distance == 2.0


def test_the_beam_step_is_ordered_in_radians() -> None:
    bench, leaf = Bench(), TakeScan("take")
    bench.set_up(leaf)
    put(SURVEY=Survey(), BASE=standing())
    tick(leaf)
    assert bench.calls[-1][1][1].step == pytest.approx(math.radians(bench.services.settings.scanning.step_deg))


def test_a_scan_gathers_what_each_stage_found() -> None:
    bench = Bench()
    leaves = [TakeScan("take"), FetchScan("fetch"), ValidateScan("validate"), AlignScan("align")]
    bench.set_up(*leaves)
    put(SURVEY=Survey(), BASE=standing())
    valid = type("Valid", (), {"points": 900, "base_from_scanner": MOUNT, "median_range": 3.0})
    file = type("File", (), {"name": "S01.scan"})
    for leaf, value in zip(leaves, (receipt("S01"), file, valid, LEVEL), strict=True):
        assert tick(leaf) == Status.RUNNING
        bench.job.done(value)
        assert tick(leaf) == Status.SUCCESS
    found = get(Key.SCAN)
    assert (found.scan_id, found.points, found.alignment) == ("S01", 900, LEVEL)
    assert [event["file"] for event in bench.events] == ["S01.scan"]


# --- registration ---------------------------------------------------------------------------------------------------


def test_the_guess_puts_the_levelled_scanner_where_the_base_believes_it_stands() -> None:
    tilt = Alignment(transforms.from_euler(0.02, -0.01, 0, (0, 0, 1.29)), 0.02, -0.01, 1.29, 3.0, 0.0, 0.3)
    base = transforms.planar(3.0, 4.0, 1.0)
    taken = current("S02", base)
    found = guess(type(taken)(**{**vars(taken), "alignment": tilt}))
    assert np.allclose(found[:2, 3], (3.0, 4.0))
    assert found[2, 3] == pytest.approx(1.29)
    assert np.allclose(found[:3, :3], (base @ tilt.level_from_scanner)[:3, :3])


def test_a_scan_without_odometry_has_no_guess() -> None:
    with pytest.raises(FailureError, match="REG_NO_GUESS"):
        guess(current("S01", None))


def test_the_tolerated_error_grows_with_the_distance_driven() -> None:
    asked = []
    for distance in (0.0, 10.0):
        bench, leaf = Bench(), RegisterScan("register")
        bench.set_up(leaf)
        put(SURVEY=survey_of(scan("S01")), SCAN=current("S02", np.eye(4), distance), ROOM="R1")
        tick(leaf)
        asked.append(arguments(bench))
    trust = Bench().services.settings.registration
    assert asked[0]["error_m"] == trust.guess_error_m
    assert asked[1]["error_m"] == pytest.approx(trust.guess_error_m + 10 * trust.guess_error_m_per_m)
    assert asked[1]["error_rad"] == pytest.approx(
        math.radians(trust.guess_error_deg + 10 * trust.guess_error_deg_per_m)
    )


def test_features_search_further_and_trust_no_heading() -> None:
    bench, leaf = Bench(), RegisterGlobally("globally")
    bench.set_up(leaf)
    put(SURVEY=survey_of(scan("S01")), SCAN=current("S02", np.eye(4)), ROOM="R1")
    tick(leaf)
    assert (arguments(bench)["error_m"], arguments(bench)["error_rad"]) == (3.0, math.pi)


@pytest.mark.parametrize(("leaf", "known"), [(AnchorScan("anchor"), ()), (RegisterScan("icp"), (scan("S01"),))])
def test_an_accepted_pose_is_in_the_survey_and_in_the_journal(leaf: RegisterScan, known: tuple) -> None:
    bench = Bench()
    bench.set_up(leaf)
    put(SURVEY=survey_of(*known), SCAN=current("S02", np.eye(4)), ROOM="R1")
    tick(leaf)
    bench.job.done(placed(2.0, 1.0))
    assert tick(leaf) == Status.SUCCESS
    record = get(Key.SURVEY).scans[-1]
    assert (record.scan_id, record.room_id, record.base_pose) == ("S02", "R1", (2.0, 1.0, 0.0))
    (event,) = bench.events
    assert (event["kind"], event["scan_id"], event["overlap"]) == ("registered", "S02", 0.7)


def test_a_scan_set_aside_waits_with_its_own_guess() -> None:
    bench, leaf = Bench(), SetScanAside("aside")
    bench.set_up(leaf)
    waiting = current("S02", transforms.planar(1, 2, 0))
    put(SURVEY=survey_of(scan("S01")), SCAN=waiting)
    assert tick(leaf) == Status.SUCCESS
    assert get(Key.SURVEY).set_aside == (waiting,)


@pytest.mark.parametrize("ending", ["placed", "refused", "interrupted"])
def test_trying_a_scan_set_aside_again_leaves_the_current_scan_as_it_was(ending: str) -> None:
    bench, leaf = Bench(), PlaceScanSetAside("again")
    bench.set_up(leaf)
    waiting, bridging = current("S02", transforms.planar(4, 0, 0)), current("S03", transforms.planar(2, 0, 0))
    put(SURVEY=survey_of(scan("S01"), scan("S03", 2.0), set_aside=(waiting,)), SCAN=bridging, ROOM="R1")
    assert tick(leaf) == Status.RUNNING
    assert arguments(bench)["scan_id"] == "S02"
    if ending == "interrupted":
        leaf.stop(Status.INVALID)
    else:
        bench.job.done(placed(4.0)) if ending == "placed" else bench.job.failed("REG_LOW_OVERLAP")
        tick(leaf)
    assert get(Key.SCAN).scan_id == "S03"
    assert get(Key.SURVEY).set_aside == ()
    assert len(get(Key.SURVEY).scans) == (3 if ending == "placed" else 2)
    assert get(Key.SURVEY).scans[-1].scan_id == "S03"
