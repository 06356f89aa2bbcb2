"""Missions with doors that do not stay open."""

from dataclasses import replace

import numpy as np

from behaviours.settings import BuildingSettings, Settings
from mission.phase import Phase
from perception.findings import Door, DoorFindings
from tests.scenarios.play import Play
from tests.scenarios.site import row, star


def test_a_door_that_cannot_be_passed_is_left_for_later_tried_once_more_and_refused() -> None:
    """Of three doors around the hall one is shut. The other rooms come first, then it gets its second chance."""
    play = Play(star())
    play.base.closed = {"A-B"}
    assert play.run() == "incomplete"
    assert sorted(play.rooms) == ["A", "C", "D"]
    assert {status for status, _ in play.rooms.values()} == {"complete"}
    (refused,) = (edge for edge in play.survey.building.doors if edge.state != "passed")
    assert (refused.state, refused.reason, refused.attempts) == ("refused", "NAV_BLOCKED", 2)
    tried = [event for event in play.events.of("drive") if event["purpose"] == "door"]
    assert [event["result"] for event in tried].count("NAV_BLOCKED") == 2
    assert tried[-1]["result"] == "NAV_BLOCKED", "the second try comes when no other door is left"
    assert np.allclose(play.base.pose[:2], (0, 0))


def test_a_deferred_door_that_has_opened_meanwhile_is_passed() -> None:
    """It was shut when its turn came, and somebody opened it before the end: nothing is missing then."""
    play = Play(star())
    play.base.closed = {"A-B"}

    def opens(play: Play, ticks: int) -> None:
        if len(play.rooms) == 3:
            play.base.closed.clear()

    play.each_tick = opens
    assert play.run() == "complete"
    assert sorted(play.rooms) == ["A", "B", "C", "D"]
    assert play.doors == ["passed"] * 3


def test_a_door_that_closes_behind_the_robot_keeps_it_from_home_and_from_the_other_rooms() -> None:
    """In a side room the only door falls shut. The robot finishes there, tries what is left, and ends where it is."""
    play = Play(star())

    def falls_shut(play: Play, ticks: int) -> None:
        if len(play.rooms) == 2:
            play.base.closed = set(play.site.passages)

    play.each_tick = falls_shut
    assert play.run() == "incomplete"
    assert len(play.rooms) == 2
    assert {status for status, _ in play.rooms.values()} == {"complete"}
    assert sorted(play.doors) == ["passed", "refused", "refused"]
    assert play.events.of("drive")[-1]["purpose"] == "start"
    assert play.events.of("drive")[-1]["result"] == "NAV_BLOCKED"
    assert play.events.codes[-1] == "NAV_BLOCKED"
    assert len(play.site.rooms_at(*play.base.pose[:2]) - {"A"}) == 1, "still behind the door"


def test_a_robot_shut_in_in_the_last_room_has_scanned_all_and_says_that_it_is_not_home() -> None:
    """Every room is done when the door falls shut: the survey is complete, the drive home is not."""
    play = Play(row(2))

    def falls_shut(play: Play, ticks: int) -> None:
        if "B" in play.rooms:
            play.base.closed = {"A-B"}

    play.each_tick = falls_shut
    assert play.run() == "complete"
    assert (play.events.of("drive")[-1]["purpose"], play.events.codes[-1]) == ("start", "NAV_BLOCKED")
    state = play.executive.course.state
    assert (state.phase, state.code) == (Phase.DONE, "NAV_BLOCKED")
    assert state.message.startswith("the robot did not come home: ")


def test_the_only_door_shut_leaves_one_room_and_an_incomplete_building() -> None:
    """Its second chance comes at once, because no other door is there."""
    play = Play(row(2))
    play.base.closed = {"A-B"}
    assert play.run() == "incomplete"
    assert play.rooms == {"A": ("complete", "lambda_mu")}
    assert play.doors == ["refused"]
    assert play.calls["drive"] == 1 + 2 + 1


def test_no_more_rooms_are_begun_than_allowed() -> None:
    """A building larger than the mission may be: it ends in order and says that doors are left."""
    play = Play(row(3), settings=replace(Settings(), building=BuildingSettings(max_rooms=2)))
    assert play.run() == "incomplete"
    assert sorted(play.rooms) == ["A", "B"]
    assert play.events.codes == ["MAX_ROOMS"]
    assert sorted(play.doors) == ["passed", "unexplored"]


def test_doors_that_cannot_be_looked_for_do_not_end_the_mission() -> None:
    """The search for doors fails in the first room: the robot goes home, and nothing pretends to be complete."""
    play = Play(row(2))
    play.script.fail("find_doors", "PERC_TIMEOUT")
    assert play.run() == "incomplete"
    assert play.rooms == {"A": ("partial", "PERC_TIMEOUT")}
    assert play.events.codes == ["PERC_TIMEOUT"]


def test_an_opening_in_doubt_is_looked_at_from_nearby_and_then_entered() -> None:
    """Past a half open leaf nobody sees anything: the robot drives before it, scans again, and then it is a door."""
    play = Play(row(2))
    doubted = next(iter(play.site.passages.values())).seen_from("A")
    play.script.answer("find_doors", DoorFindings((), ((doubted, "depth"),), (doubted,)))
    assert play.run() == "complete"
    assert sorted(play.rooms) == ["A", "B"]
    assert "suspect" in [drive["purpose"] for drive in play.events.of("drive")]


def test_an_opening_that_stays_in_doubt_is_looked_at_only_once() -> None:
    """A second look did not help: the robot does not stare at it for ever."""
    play = Play(row(1))
    niche = Door(0.0, 2.0, (0.0, 1.0), 0.9, 0.9, 2.0, 1.0)
    play.script.answer("find_doors", DoorFindings((), ((niche, "depth"),), (niche,)), calls=range(1, 20))
    play.run()
    assert [drive["purpose"] for drive in play.events.of("drive")].count("suspect") == 1
