"""The leaf that reconsiders all poses together."""

import math

import numpy as np
from py_trees.common import Status

from behaviours.adjusting import MAPS_BEAR_M, OptimisePoses
from behaviours.conditions import LoopIsClosed
from behaviours.keys import Key
from behaviours.survey import Survey
from perception import transforms
from perception.building import Building
from perception.findings import Door, PoseAdjustment
from tests.behaviours.bench import Bench, get, put, scan, survey_of, tick


def looped() -> Survey:
    """Two rooms that two doors join, a scan in each."""
    building, _ = Building().add_room((0.0, 0.0))
    doors = [Door(3.0, y, (1.0, 0.0), 0.9, 0.9, 2.1, 0.9) for y in (-2.0, 2.0)]
    building, _ = building.observe_doors("R1", doors).add_room((4.0, -2.0), "D1")
    beyond = [Door(3.2, y, (-1.0, 0.0), 0.9, 0.9, 2.1, 0.9) for y in (-2.0, 2.0)]
    return survey_of(scan("S01"), scan("S02", 4.0, room_id="R2"), building=building.observe_doors("R2", beyond))


def adjustment(survey: Survey, moved_m: float, reason: str = "") -> PoseAdjustment:
    shift = transforms.planar(0.0 if reason else moved_m, 0.0, 0.0)
    poses = {record.scan_id: shift @ record.map_from_scanner for record in survey.scans}
    residuals = dict.fromkeys(poses, 0.002)
    return PoseAdjustment(poses, residuals, 1, (), 0.003, 0.001, 0.0 if reason else moved_m, reason)


def optimised(moved_m: float, most_m: float, reason: str = "") -> tuple[Bench, Survey, Survey]:
    """The bench, and the survey before and after."""
    bench, leaf, survey = Bench(), OptimisePoses("adjust", most_m), looped()
    bench.set_up(leaf)
    put(SURVEY=survey)
    assert tick(leaf) == Status.RUNNING
    _, (stage,), sent = bench.calls[-1]
    assert stage == "optimise_poses" and [name for name, _ in sent["scans"]] == ["S01", "S02"]
    bench.job.done(adjustment(survey, moved_m, reason))
    assert tick(leaf) == Status.SUCCESS
    return bench, survey, get(Key.SURVEY)


def shift_of(before: Survey, after: Survey) -> float:
    return float(np.linalg.norm(after.scans[1].map_from_scanner[:3, 3] - before.scans[1].map_from_scanner[:3, 3]))


def test_poses_and_residuals_are_taken_into_the_survey_and_the_figures_into_the_journal() -> None:
    bench, before, after = optimised(0.008, MAPS_BEAR_M)
    assert np.isclose(shift_of(before, after), 0.008)
    assert [record.residual for record in after.scans] == [0.002, 0.002]
    (event,) = bench.events
    assert (event["kind"], event["taken"], event["moved_m"], event["loops"]) == ("poses_optimised", True, 0.008, 1)


def test_an_adjustment_that_the_maps_do_not_bear_waits_while_they_are_in_use() -> None:
    bench, before, after = optimised(0.04, MAPS_BEAR_M)
    assert after.scans == before.scans
    assert not bench.events[0]["taken"] and "maps are in use" in bench.events[0]["reason"]
    _, before, after = optimised(0.04, math.inf)
    assert np.isclose(shift_of(before, after), 0.04)


def test_a_refused_adjustment_moves_nothing_but_leaves_the_residuals() -> None:
    bench, before, after = optimised(0.0, math.inf, "a scan would move by a metre")
    assert shift_of(before, after) == 0.0
    assert [record.residual for record in after.scans] == [0.002, 0.002]
    assert (bench.events[0]["taken"], bench.events[0]["reason"]) == (False, "a scan would move by a metre")


def test_a_loop_is_new_until_the_poses_were_adjusted_to_it() -> None:
    bench, question = Bench(), LoopIsClosed("closed?")
    bench.set_up(question)
    put(SURVEY=survey_of(scan("S01")))
    assert tick(question) == Status.FAILURE
    put(SURVEY=looped())
    assert tick(question) == Status.SUCCESS
    _, _, after = optimised(0.001, MAPS_BEAR_M)
    put(SURVEY=after)
    assert tick(question) == Status.FAILURE
