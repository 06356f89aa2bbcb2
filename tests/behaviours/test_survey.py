"""What the mission knows of the building: immutable values that leaves replace."""

from dataclasses import replace

import numpy as np

from behaviours.survey import Cycle, Survey
from drivers.interfaces import BaseState
from perception import transforms
from perception.building import Building
from perception.findings import Door, LabelCounts
from perception.stopping import StopDecision
from tests.behaviours.bench import scan, survey_of


def cycle(scan_id: str) -> Cycle:
    return Cycle(scan_id, LabelCounts(1, 1, 1), StopDecision(False, "", 1.0, 1.0, None))


def two_joined_rooms_and_one_apart() -> Survey:
    building, _ = Building().add_room((0.0, 0.0))
    building = building.observe_doors("R1", [Door(3.0, 0.0, (1.0, 0.0), 0.9, 0.9, 2.1, 0.9)])
    building, _ = building.add_room((4.0, 0.0), "D1")
    building, _ = building.add_room((50.0, 0.0))
    return survey_of(scan("S01"), scan("S02", 3.0, room_id="R2"), scan("S03", 50.0, room_id="R3"), building=building)


def test_a_registered_scan_is_where_the_base_stands_and_ends_the_distance_driven() -> None:
    survey = survey_of(scan("S01"), scan("S02", 2.0, 1.0)).with_drive(((3.0, 1.0, 0.0),), 1.0)
    assert (survey.driven, survey.position) == (1.0, (3.0, 1.0))
    survey = survey.with_scan(scan("S03", 3.1, 1.0))
    assert (survey.driven, survey.position) == (0.0, (3.1, 1.0))


def test_a_scan_that_finds_its_place_later_is_not_where_the_base_stands() -> None:
    before = survey_of(scan("S01"), scan("S03", 1.0))
    survey = before.with_earlier_scan(scan("S02", 2.0))
    assert [record.scan_id for record in survey.scans] == ["S01", "S02", "S03"]
    assert (survey.track, survey.driven) == (before.track, before.driven)


def test_before_the_first_scan_the_base_is_at_the_origin() -> None:
    assert Survey().position == (0.0, 0.0)


def test_the_cycle_of_the_newest_scan_counts_once_however_often_it_is_assessed() -> None:
    survey = survey_of(scan("S01"))
    assert survey.cycle_number("R1") == 1
    assessed = replace(survey, cycles={"R1": (cycle("S01"),)})
    assert assessed.cycle_number("R1") == 1
    assert assessed.with_scan(scan("S02")).cycle_number("R1") == 2
    assert Survey().cycle_number("R1") == 1


def test_scans_near_a_room_are_its_own_and_those_of_rooms_that_a_door_joins_it_with() -> None:
    survey = two_joined_rooms_and_one_apart()
    assert [record.scan_id for record in survey.scans_near("R1")] == ["S01", "S02"]
    assert [record.scan_id for record in survey.scans_near("R3")] == ["S03"]
    assert [record.scan_id for record in survey.room_scans("R2")] == ["S02"]


def test_odometry_alone_carries_the_last_registered_pose_on() -> None:
    odom_from_map = transforms.planar(-4.0, 7.0, 2.0)
    truth = transforms.planar(1.0, 2.0, 0.5)
    last = replace(scan("S01"), map_from_base=truth, odom_from_base=odom_from_map @ truth)
    now = transforms.planar(3.0, -1.0, -0.7)
    base = BaseState(odom_from_map @ now, None, False, False, 1.0, "idle", 0.0)
    guess = survey_of(last).believed_pose(base)
    assert guess is not None
    assert np.allclose(guess, now)
    assert Survey().believed_pose(base) is None


def test_what_odometry_says_in_another_frame_leads_nowhere() -> None:
    """It began anew: the base is believed where it was last, unless it localises itself."""
    survey = Survey().with_scan(scan("S01")).with_drive(((1.0, 2.0, 0.5),), 2.0)
    anew = BaseState(np.eye(4), None, False, False, 1.0, "idle", 0.0, odom_frame="another")
    assert survey.knows_place(replace(anew, odom_frame=""))
    assert not survey.knows_place(anew)
    assert Survey().knows_place(anew)
    guess = survey.believed_pose(anew)
    assert guess is not None
    assert np.allclose(guess, transforms.planar(1.0, 2.0, 0.5))
    assert survey.believed_pose(replace(anew, map_from_base=np.eye(4))) is not None


def test_changes_leave_the_old_survey_as_it_was() -> None:
    survey = survey_of(scan("S01"))
    before = dict(vars(survey))
    survey.with_scan(scan("S02")).with_drive(((1.0, 0.0, 0.0),), 1.0).next_goal()
    assert all(vars(survey)[name] is value for name, value in before.items())


def test_an_adjusted_survey_has_the_new_poses_with_the_base_under_them_and_remembers_the_old() -> None:
    """A turn about the map's origin and a shift: scanner and base go along as one body."""
    survey = survey_of(scan("S01"), scan("S02", 2.0, 1.0))
    correction = transforms.planar(0.003, -0.004, 0.001)
    poses = {
        "S01": survey.scans[0].map_from_scanner,
        "S02": correction @ survey.scans[1].map_from_scanner,
    }
    first, second = survey.adjusted(poses, {"S02": 0.002}).scans
    assert np.allclose(first.map_from_base, survey.scans[0].map_from_base)
    assert (first.residual, first.moved_m) == (None, 0.0)
    assert np.allclose(second.map_from_base, correction @ survey.scans[1].map_from_base)
    assert second.residual == 0.002
    assert second.moved_m == transforms.difference(second.registration.map_from_scanner, poses["S02"])[0] > 0.003


def test_doors_between_known_rooms_close_loops_when_they_are_more_than_it_takes_to_join_them() -> None:
    building, _ = Building().add_room((0.0, 0.0))
    assert (Survey().loops, Survey(building=building).loops) == (0, 0)
    doors = [Door(3.0, y, (1.0, 0.0), 0.9, 0.9, 2.1, 0.9) for y in (-2.0, 2.0)]
    building = building.observe_doors("R1", doors)
    assert Survey(building=building).loops == 0
    building, _ = building.add_room((4.0, -2.0), "D1")
    assert Survey(building=building).loops == 0
    beyond = [Door(3.2, y, (-1.0, 0.0), 0.9, 0.9, 2.1, 0.9) for y in (-2.0, 2.0)]
    assert Survey(building=building.observe_doors("R2", beyond)).loops == 1
