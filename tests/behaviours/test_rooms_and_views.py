"""Leaves that begin and end rooms, walk through doors, and choose views."""

from dataclasses import replace

import pytest
from py_trees.behaviour import Behaviour
from py_trees.common import Status

from behaviours.keys import Key
from behaviours.rooms import BeginRoom, ChooseDoor, ChooseSuspect, DeferDoor, FindDoors, GiveUpRoom
from behaviours.survey import Avoided, Labelled, Survey, Target
from behaviours.viewing import AssessRoom, AvoidView, ChooseView
from perception.building import Building
from perception.failure import Failure
from perception.findings import Candidate, Door, DoorFindings, LabelCounts, ViewChoice
from tests.behaviours.bench import Bench, get, put, scan, survey_of, tick
from tests.scenarios.site import row

EAST = Door(3.0, 0.0, (1.0, 0.0), 0.9, 0.9, 2.1, 0.9, 0.2)
VIEW = ViewChoice((Candidate(1.0, 2.0, 500, 3.0), Candidate(0.0, 2.0, 300, 2.0)), 40)


def first_room(*doors: Door) -> Survey:
    building, room_id = Building().add_room((0.0, 0.0))
    survey = survey_of(scan("S01"), building=building.observe_doors(room_id, doors))
    return survey.with_shape(room_id, row(1).shape("A"))


def ticked(leaf: Behaviour, survey: Survey, **values: object) -> tuple[Bench, Status]:
    bench = Bench()
    bench.set_up(leaf)
    put(SURVEY=survey, **{"ROOM": "R1", **values})
    return bench, tick(leaf)


# --- rooms ----------------------------------------------------------------------------------------------------------


def test_the_first_room_is_around_the_start() -> None:
    ticked(BeginRoom("begin"), Survey(), DOOR=None, AVOID=(Avoided(0, 0, 1),))
    room = get(Key.SURVEY).building.room("R1")
    assert (room.seed, room.entry_door, room.status) == ((0.0, 0.0), None, "open")
    assert get(Key.AVOID) == (), "views of another room are nothing to avoid here"


def test_the_next_room_lies_behind_the_door_the_base_stands_in() -> None:
    ticked(BeginRoom("begin"), first_room(EAST), DOOR="D1")
    building = get(Key.SURVEY).building
    assert building.room("R2").seed == pytest.approx((3.8, 0.0))
    assert (building.edge("D1").state, building.edge("D1").rooms) == ("passed", ("R1", "R2"))
    assert get(Key.ROOM) == "R2"


def test_a_room_is_given_up_with_the_failure_that_stood_in_the_way() -> None:
    bench, _ = ticked(GiveUpRoom("give up"), first_room(), FAILURE=Failure("REG_DEGENERATE", "slides"))
    room = get(Key.SURVEY).building.room("R1")
    assert (room.status, room.reason) == ("partial", "REG_DEGENERATE")
    assert bench.events == [{"kind": "room_ended", "room_id": "R1", "status": "partial", "reason": "REG_DEGENERATE"}]


def test_a_room_that_was_given_up_keeps_its_first_reason() -> None:
    survey = first_room()
    survey = replace(survey, building=survey.building.end_room("R1", "partial", "SCAN_FAILED"))
    bench, status = ticked(GiveUpRoom("give up"), survey, FAILURE=Failure("DOORS_NO_ROOM", "no contour"))
    assert status == Status.SUCCESS
    assert get(Key.SURVEY).building.room("R1").reason == "SCAN_FAILED"
    assert bench.events == []


# --- doors ----------------------------------------------------------------------------------------------------------


def test_doors_that_were_found_are_in_the_graph_and_in_the_journal_with_those_refused() -> None:
    leaf = FindDoors("find")
    bench, _ = ticked(leaf, first_room())
    niche = replace(EAST, x=-3.0, normal=(-1.0, 0.0))
    bench.job.done(DoorFindings((EAST,), ((niche, "free_depth"),)))
    assert tick(leaf) == Status.SUCCESS
    assert [edge.rooms for edge in get(Key.SURVEY).building.doors] == [("R1", None)]
    (event,) = bench.events
    assert ([door["x"] for door in event["found"]], event["refused"][0]["gate"]) == ([3.0], "free_depth")


def test_a_room_without_a_contour_has_no_walls_to_look_for_doors_in() -> None:
    bench, status = ticked(FindDoors("find"), replace(first_room(), shapes={}))
    assert status == Status.FAILURE
    assert bench.codes == ["DOORS_NO_ROOM"]


def test_the_target_is_under_the_door_with_any_heading() -> None:
    ticked(ChooseDoor("choose"), first_room(EAST))
    assert get(Key.DOOR) == "D1"
    target = get(Key.TARGET)
    assert (target.x, target.y) == pytest.approx((3.1, 0.0))
    assert (target.yaw, target.purpose) == (None, "door")


def test_no_door_left_is_said_with_a_code() -> None:
    bench, status = ticked(ChooseDoor("choose"), first_room())
    assert status == Status.FAILURE
    assert get(Key.FAILURE).code == "NO_DOOR_LEFT"
    assert bench.codes == [], "the ordinary end of a mission is no trouble"


def test_no_opening_in_doubt_is_said_with_a_code_and_each_is_looked_at_once() -> None:
    doubtful = replace(first_room(), suspects=(EAST,))
    assert ticked(ChooseSuspect("choose"), doubtful)[1] == Status.SUCCESS
    bench, status = ticked(ChooseSuspect("choose"), get(Key.SURVEY))
    assert (status, get(Key.FAILURE).code, bench.codes) == (Status.FAILURE, "NO_SUSPECT_LEFT", [])


def test_a_door_is_deferred_once_and_then_refused() -> None:
    leaf = DeferDoor("defer")
    bench, _ = ticked(leaf, first_room(EAST), DOOR="D1", FAILURE=Failure("NAV_BLOCKED", "shut"))
    assert get(Key.SURVEY).building.edge("D1").state == "deferred"
    tick(leaf)
    edge = get(Key.SURVEY).building.edge("D1")
    assert (edge.state, edge.reason) == ("refused", "NAV_BLOCKED")
    assert bench.codes == []


# --- views ----------------------------------------------------------------------------------------------------------


def test_views_are_avoided_until_their_time_and_no_longer() -> None:
    leaf = ChooseView("choose")
    bench = Bench()
    bench.set_up(leaf)
    bench.clock.sleep(100.0)
    put(
        SURVEY=first_room(),
        ROOM="R1",
        COUNTS=Labelled("S01", LabelCounts(1, 2, 3)),
        AVOID=(Avoided(1, 1, 99.0), Avoided(2, 2, 101.0)),
    )
    tick(leaf)
    assert bench.calls[-1][2]["avoid"] == [(2, 2, bench.services.settings.driving.avoid_radius_m)]
    assert get(Key.AVOID) == (Avoided(2, 2, 101.0),)


def test_a_view_that_could_not_be_reached_is_avoided_for_a_while() -> None:
    bench = Bench()
    leaf = AvoidView("avoid")
    bench.set_up(leaf)
    bench.clock.sleep(50.0)
    put(TARGET=Target("G001", 1.0, 2.0, None, "view"), AVOID=(Avoided(0, 0, 60.0),))
    assert tick(leaf) == Status.SUCCESS
    assert get(Key.AVOID) == (Avoided(0, 0, 60.0), Avoided(1.0, 2.0, 650.0))


def assessed(survey: Survey, counts: LabelCounts, view: ViewChoice = VIEW, **values: object) -> Survey:
    labelled = Labelled(survey.scans[-1].scan_id, counts)
    _, status = ticked(AssessRoom("assess"), survey, COUNTS=labelled, VIEW=view, **values)
    assert status == Status.SUCCESS
    found: Survey = get(Key.SURVEY)
    return found


def test_a_room_that_wants_more_has_the_best_view_as_its_target() -> None:
    survey = assessed(first_room(), LabelCounts(900, 8100, 1000))
    assert survey.building.room("R1").status == "open"
    target = get(Key.TARGET)
    assert (target.x, target.y, target.yaw, target.purpose) == (1.0, 2.0, None, "view")


def test_small_rates_complete_the_room_and_leave_no_target() -> None:
    survey = assessed(first_room(), LabelCounts(900, 8100, 1000))
    survey = assessed(survey.with_scan(scan("S02")), LabelCounts(920, 8180, 900))
    room = survey.building.room("R1")
    assert (room.status, room.reason) == ("complete", "lambda_mu")
    assert get(Key.TARGET) is None


def test_assessing_the_same_scan_again_does_not_count_as_progress_that_stopped() -> None:
    """After a blocked way the room is assessed once more; λ is still that of the first cycle, not zero."""
    counts = LabelCounts(900, 8100, 1000)
    survey = assessed(assessed(first_room(), counts), counts)
    (cycle,) = survey.cycles["R1"]
    assert cycle.decision.growing_rate == 1.0
    assert survey.building.room("R1").status == "open"


@pytest.mark.parametrize(
    ("avoid", "expected"), [((), ("complete", "no_candidate")), ((Avoided(1, 1, 9),), ("partial", "views_blocked"))]
)
def test_no_candidate_is_complete_but_views_given_up_are_not(
    avoid: tuple[Avoided, ...], expected: tuple[str, str]
) -> None:
    survey = assessed(first_room(), LabelCounts(900, 8100, 1000), ViewChoice((), 0), AVOID=avoid)
    room = survey.building.room("R1")
    assert (room.status, room.reason) == expected
