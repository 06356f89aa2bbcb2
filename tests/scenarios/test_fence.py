"""A fence round the start: what lies beyond is none of the mission's, and who is out there stands still."""

from dataclasses import replace

import numpy as np
import pytest

from behaviours.settings import BuildingSettings, Settings
from drivers.interfaces import BaseState
from perception import transforms
from perception.building import contains
from tests.scenarios.play import Play
from tests.scenarios.site import LONG, WIDE, row

AROUND_A = ((-4.0, -5.0), (LONG / 2 + 0.1, -5.0), (LONG / 2 + 0.1, WIDE), (-4.0, WIDE))
"""Room A alone, of a row that goes on along x; the mission starts in its middle."""


def fenced(rooms: int = 2, **options: object) -> Play:
    settings = Settings()
    return Play(row(rooms), settings=replace(settings, building=BuildingSettings(fence=AROUND_A)), **options)


def test_a_door_that_leads_out_is_none_of_the_missions() -> None:
    """Nobody asks about it, nobody drives under it, and the mission is complete without what is behind."""
    play = fenced(attended=True)
    assert play.run() == "complete"
    assert list(play.rooms) == ["A"]
    (door,) = play.survey.building.doors
    assert (door.state, door.reason) == ("forbidden", "GEOFENCE")
    assert play.events.of("asked") == [] and play.events.codes == []
    start = play.survey.scans[0].map_from_base
    beyond = [goal for goal in play.base.goals if not contains(np.array(AROUND_A), inside(start, goal.x, goal.y))]
    assert beyond == []


def inside(start: np.ndarray, x: float, y: float) -> np.ndarray:
    """A place of the map as the robot saw it at the start."""
    return (transforms.inverse(start) @ [x, y, 0.0, 1.0])[:2]


def test_the_maps_are_told_of_the_fence() -> None:
    play = fenced(1)
    play.run()
    first = play.perception.of_stage("build_map")[0]
    start = play.survey.scans[0].map_from_base
    corners = [inside(start, *corner) for corner in first["fence"]]
    assert np.allclose(corners, AROUND_A)
    without = Play(row(1))
    without.run()
    assert without.perception.of_stage("build_map")[0]["fence"] is None


@pytest.mark.parametrize("attended", [True, False])
def test_who_is_outside_stands_still_until_it_is_brought_back_and_told(attended: bool) -> None:
    """Somebody pushes it out, and back after a while; without an operator the mission ends there."""
    play = fenced(attended=attended)
    pushed: list[int] = []

    def each_tick(play: Play, ticks: int) -> None:
        if len(play.events.of("drive")) == 1 and not pushed:
            pushed.append(ticks)
            play.base.push(20.0)
        if pushed and ticks == pushed[0] + 12:
            play.base.push(-20.0)
        for question in play.desk.open:
            play.desk.answer(question.question_id, question.options[0])

    play.each_tick = each_tick
    assert play.run() == ("complete" if attended else "safety_stop")
    assert "hold(GEOFENCE)" in play.phases
    (asked,) = play.events.of("asked")
    assert "GEOFENCE: The trouble is over" in asked["text"]


def test_where_the_base_was_in_another_missions_map_holds_nobody() -> None:
    """Its own localisation is of the map it was given last, which before the first drive is none of this mission's."""
    play = fenced()
    state = play.base.state

    def with_an_old_place() -> BaseState | None:
        base = state()
        old = None if play.base.goals else transforms.planar(99.0, 0.0, 0.0)
        return base and replace(base, map_from_base=old)

    play.base.state = with_an_old_place
    assert play.run() == "complete"
    assert "hold(GEOFENCE)" not in play.phases
