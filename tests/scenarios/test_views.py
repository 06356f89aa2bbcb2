"""Missions in which the way to a view is blocked, or there is no view."""

from dataclasses import replace

import numpy as np
import pytest

from behaviours.settings import Settings
from perception.findings import ViewChoice
from tests.scenarios.play import Play, with_driving
from tests.scenarios.scripted import EVER, HANG
from tests.scenarios.site import row

BEST, SECOND, THIRD, FOURTH = row(1).views("A")


def places(play: Play) -> list[tuple[float, float]]:
    """Where the scans that have a place were taken."""
    return [(float(scan.base_pose[0]), float(scan.base_pose[1])) for scan in play.survey.scans]


def test_a_blocked_view_gives_way_to_the_next_best() -> None:
    """Somebody stands at the best view. The robot stops half-way, asks again from there, and scans the second best."""
    play = Play(row(1))
    play.base.occupied = {BEST}
    assert play.run() == "complete"
    assert np.allclose(places(play), [(0, 0), SECOND])
    assert [event["result"] for event in play.events.of("drive")] == ["NAV_BLOCKED", "arrived", "arrived"]
    asked = play.perception.of_stage("choose_view")
    assert [len(arguments["avoid"]) for arguments in asked] == [0, 1, 1]
    assert asked[0]["cycle"] == asked[1]["cycle"] == 1
    assert np.allclose(asked[1]["pose"][:2], np.array(BEST) / 2), "seen from where the base stopped"
    assert play.base.goals[1].map_from_base is None, "registration knows of the scan, not of where the base stopped"


def test_an_avoided_view_comes_back_after_its_time() -> None:
    """The best view is occupied at first and free later. Once ten minutes are over it is chosen after all."""
    play = Play(row(1), settings=with_driving(avoid_s=100.0))
    play.perception.seen = [5000, 7000, 9000, 9100]
    play.base.occupied = {BEST}

    def leaves_later(play: Play, ticks: int) -> None:
        if play.calls["take"] >= 2:
            play.base.occupied.clear()

    play.each_tick = leaves_later
    assert play.run() == "complete"
    assert np.allclose(places(play), [(0, 0), SECOND, BEST, THIRD])
    avoided = [len(arguments["avoid"]) for arguments in play.perception.of_stage("choose_view")]
    assert avoided == [0, 1, 0, 0, 0]


def test_a_room_whose_views_are_all_blocked_stays_partial() -> None:
    """One view after the other is given up, until none is left: that is not the same as a room without candidates."""
    play = Play(row(1))
    play.base.occupied = {BEST, SECOND, THIRD, FOURTH}
    assert play.run() == "incomplete"
    assert play.rooms == {"A": ("partial", "views_blocked")}
    assert play.events.codes.count("NAV_BLOCKED") == 4
    assert play.calls["choose_view"] == 5


def test_a_room_whose_scans_are_used_up_while_a_view_promises_more_is_not_complete() -> None:
    settings = Settings()
    play = Play(row(2), settings=replace(settings, room=replace(settings.room, max_scans=1)))
    assert play.run() == "incomplete"
    assert set(play.rooms.values()) == {("partial", "max_scans")}
    assert len(play.rooms) == 2, "it goes on with the next room"


def test_views_are_tried_no_more_often_than_the_settings_say() -> None:
    """Two attempts are allowed; the room is given up with what stood in the way."""
    play = Play(row(1), settings=with_driving(view_attempts=2))
    play.script.fail("drive", "NAV_NO_PATH", EVER)
    assert play.run() == "incomplete"
    assert play.rooms == {"A": ("partial", "NAV_NO_PATH")}
    assert play.calls["choose_view"] == 2


def test_no_candidate_ends_the_room_with_that_reason() -> None:
    """A closet: nothing in it meets the three requirements, and nobody stood in the way. It is done, and says why."""
    play = Play(row(1))
    play.perception.choose_view = lambda **_: ViewChoice((), 0)
    assert play.run() == "complete"
    assert play.rooms == {"A": ("complete", "no_candidate")}
    assert play.calls["take"] == 1


def test_a_drive_that_never_ends_is_cancelled_and_another_view_is_tried() -> None:
    """The base neither arrives nor gives up. After the deadline its goal is cancelled; what it drove is not known."""
    play = Play(row(1))
    play.script.answer("drive", HANG, [1])

    def creeps(play: Play, ticks: int) -> None:
        if play.calls["drive"] == 1 and play.base.pose == (0.0, 0.0, 0.0):
            play.base.pose = (0.0, 1.0, 0.0)

    play.each_tick = creeps
    assert play.run() == "complete"
    assert play.events.codes == ["NAV_TIMEOUT"]
    assert [job.cancelled for job in play.script.jobs if job.what == "drive"] == [True, False, False]
    assert play.base.goals[1].map_from_base is None, "odometry says that the base has moved"
    assert play.events.of("drive")[0]["distance"] == pytest.approx(1.0)
