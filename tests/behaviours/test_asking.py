"""Questions of the work, and what is done about charge."""

from dataclasses import replace

import pytest
from py_trees.common import Status

from behaviours.asking import Ask
from behaviours.charging import BatteryIsGood, WaitForCharge
from behaviours.driving import RenewGoal
from behaviours.keys import Key
from behaviours.survey import Survey, Target
from perception.failure import Failure
from tests.behaviours.bench import Bench, get, put, standing, survey_of, tick
from tests.behaviours.test_safety import Asked

RUN, YES, NO = Status.RUNNING, Status.SUCCESS, Status.FAILURE


def asking() -> tuple[Ask, Asked]:
    bench, asked = Bench(), Asked()
    bench.services = replace(bench.services, operator=asked)
    leaf = Ask("ask", "Room {room} cannot be finished", "Look at it.")
    bench.set_up(leaf)
    put(SURVEY=Survey(), ROOM="R2", FAILURE=Failure("REG_DEGENERATE", "a bare corridor"))
    return leaf, asked


@pytest.mark.parametrize(("answer", "expected"), [("again", YES), ("go on", NO)])
def test_the_answer_decides_and_the_question_is_closed(answer: str, expected: Status) -> None:
    leaf, asked = asking()
    assert tick(leaf) == RUN
    assert "R2" in get(Key.QUESTION)
    assert "REG_DEGENERATE" in get(Key.QUESTION)
    asked.jobs[0].done(answer)
    assert tick(leaf) == expected
    assert get(Key.QUESTION) is None


def test_questions_are_numbered_by_the_survey() -> None:
    leaf, asked = asking()
    for _ in range(2):
        tick(leaf)
        asked.jobs[-1].done("again")
        tick(leaf)
    assert [name for name, *_ in asked.questions] == ["Q001", "Q002"]
    assert {(options, default) for _, options, default in asked.questions} == {(("again", "go on"), "go on")}


def test_an_interrupted_question_is_withdrawn() -> None:
    leaf, asked = asking()
    tick(leaf)
    leaf.stop(Status.INVALID)
    assert (asked.jobs[0].cancelled, get(Key.QUESTION)) == (1, None)


def test_a_leaf_that_asks_nothing_leaves_the_question_of_another() -> None:
    leaf, _ = asking()
    put(QUESTION="somebody else's")
    leaf.stop(Status.INVALID)
    assert get(Key.QUESTION) == "somebody else's"


@pytest.mark.parametrize(("battery", "expected"), [(0.24, NO), (0.25, YES), (None, YES)])
def test_a_battery_is_good_down_to_the_setting(battery: float | None, expected: Status) -> None:
    leaf = BatteryIsGood("good?")
    Bench().set_up(leaf)
    put(BASE=None if battery is None else standing(battery=battery))
    assert tick(leaf) == expected


def test_a_charge_is_waited_for_until_it_is_enough() -> None:
    leaf = WaitForCharge("wait")
    Bench().set_up(leaf)
    found = []
    for battery in (0.2, 0.79, 0.8):
        put(BASE=standing(battery=battery))
        found.append(tick(leaf))
    assert found == [RUN, RUN, YES]


def test_a_charger_that_does_not_charge_is_a_named_failure() -> None:
    leaf, bench = WaitForCharge("wait"), Bench()
    bench.set_up(leaf)
    put(BASE=standing(battery=0.2))
    assert tick(leaf) == RUN
    bench.clock.sleep(bench.services.settings.battery.charging_s + 1)
    assert tick(leaf) == NO
    assert bench.codes == ["BATTERY_LOW"]


def test_a_goal_is_renewed_once_telemetry_had_its_say() -> None:
    leaf, bench = RenewGoal("renew"), Bench()
    bench.set_up(leaf)
    put(SURVEY=survey_of(goals_given=3), TARGET=Target("G003", 1.0, 2.0, None, "view"))
    assert tick(leaf) == RUN
    bench.clock.sleep(leaf.settle_s)
    assert tick(leaf) == YES
    assert get(Key.TARGET) == Target("G004", 1.0, 2.0, None, "view")
    assert get(Key.SURVEY).goals_given == 4
