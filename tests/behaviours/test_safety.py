"""Leaves that hold the mission: what for, for how long, and what they ask."""

from dataclasses import replace
from typing import Any

import pytest
from py_trees.common import Status

from behaviours import safety
from behaviours.keys import Key
from behaviours.settings import BuildingSettings, Settings
from perception.failure import Failure
from tests.behaviours.bench import Bench, HandJob, get, put, standing, tick

RUN, YES, NO = Status.RUNNING, Status.SUCCESS, Status.FAILURE
SETTINGS = Settings(building=BuildingSettings(base_lost_s=3.0, base_return_s=60.0, release_s=100.0))


class Asked:
    """An operator who answers when the test says so."""

    def __init__(self) -> None:
        self.questions: list[tuple[str, tuple[str, ...], str]] = []
        self.jobs: list[HandJob] = []

    def ask(self, question_id: str, text: str, options: tuple[str, ...], default: str, deadline: float) -> HandJob:
        self.questions.append((question_id, options, default))
        self.jobs.append(HandJob())
        return self.jobs[-1]


def held(leaf: safety.Hold, owner: str = "") -> tuple[Bench, Asked]:
    bench, asked = Bench(), Asked()
    bench.services = replace(bench.services, settings=SETTINGS, operator=asked, owner=owner)
    bench.set_up(leaf)
    return bench, asked


def sense(leaf: safety.Hold, command: str = "run", **telemetry: Any) -> Status:
    put(BASE=standing(**telemetry), COMMAND=command)
    return tick(leaf)


def code() -> str | None:
    hold: Failure | None = get(Key.HOLD)
    return None if hold is None else hold.code


TROUBLES = [
    (safety.HoldForEmergencyStop, {"emergency_stop": True}, {}),
    (safety.HoldForLostBase, {"age": 3.1}, {"age": 3.0}),
    (safety.HoldForLease, {"owner": "somebody"}, {}),
    (safety.HoldForLease, {"owner": "somebody"}, {"owner": ""}),
    (safety.HoldForBattery, {"battery": 0.09}, {"battery": 0.1}),
]


@pytest.mark.parametrize(("kind", "trouble", "fine"), TROUBLES)
def test_it_holds_for_trouble_and_for_nothing_else(kind: Any, trouble: Any, fine: Any) -> None:
    leaf = kind("hold")
    held(leaf)
    assert sense(leaf, **fine) == NO
    assert code() is None
    assert sense(leaf, **trouble) == RUN
    assert code() == leaf.code


@pytest.mark.parametrize("kind", [kind for kind, *_ in TROUBLES])
def test_before_the_first_telemetry_there_is_nothing_to_hold_for(kind: Any) -> None:
    leaf = kind("hold")
    held(leaf)
    put(BASE=None)
    assert tick(leaf) == NO


def test_a_base_that_comes_back_lets_the_work_go_on_by_itself() -> None:
    leaf = safety.HoldForLostBase("hold")
    _, asked = held(leaf)
    assert [sense(leaf, age=5.0), sense(leaf, age=9.0), sense(leaf, age=0.1)] == [RUN, RUN, NO]
    assert (code(), asked.questions) == (None, [])


def test_a_released_emergency_stop_waits_for_the_operators_word() -> None:
    leaf = safety.HoldForEmergencyStop("hold")
    _, asked = held(leaf)
    assert [sense(leaf, emergency_stop=True), sense(leaf), sense(leaf)] == [RUN, RUN, RUN]
    assert asked.questions == [("ESTOP-1", ("resume", "end"), "end")]
    assert get(Key.QUESTION) is not None
    asked.jobs[0].done("resume")
    assert sense(leaf) == NO
    assert (code(), get(Key.QUESTION)) == (None, None)
    assert sense(leaf) == NO


def test_a_stop_pressed_again_withdraws_the_question() -> None:
    leaf = safety.HoldForEmergencyStop("hold")
    _, asked = held(leaf)
    sense(leaf, emergency_stop=True)
    sense(leaf)
    assert sense(leaf, emergency_stop=True) == RUN
    assert (asked.jobs[0].cancelled, get(Key.QUESTION)) == (1, None)
    sense(leaf)
    assert [name for name, *_ in asked.questions] == ["ESTOP-1", "ESTOP-2"]


def test_trouble_that_lasts_too_long_is_asked_about_and_ends_the_mission_by_default() -> None:
    leaf = safety.HoldForLostBase("hold")
    bench, asked = held(leaf)
    assert sense(leaf, age=5.0) == RUN
    bench.clock.sleep(60.0)
    assert sense(leaf, age=65.0) == RUN
    assert asked.questions == []
    bench.clock.sleep(0.1)
    assert sense(leaf, age=65.1) == RUN
    assert asked.questions == [("BASE_LOST-1", ("wait", "end"), "end")]
    asked.jobs[0].done("end")
    assert sense(leaf, age=66.0) == YES
    assert bench.codes == ["BASE_LOST"]


def test_whoever_says_wait_is_asked_again_only_after_the_whole_time() -> None:
    leaf = safety.HoldForLostBase("hold")
    bench, asked = held(leaf)
    sense(leaf, age=5.0)
    bench.clock.sleep(61.0)
    sense(leaf, age=66.0)
    asked.jobs[0].done("wait")
    assert sense(leaf, age=66.0) == RUN
    bench.clock.sleep(59.0)
    assert sense(leaf, age=125.0) == RUN
    assert len(asked.questions) == 1
    bench.clock.sleep(2.0)
    sense(leaf, age=127.0)
    assert len(asked.questions) == 2


def test_trouble_that_ends_while_it_is_asked_about_needs_no_answer() -> None:
    leaf = safety.HoldForLostBase("hold")
    bench, asked = held(leaf)
    sense(leaf, age=5.0)
    bench.clock.sleep(61.0)
    sense(leaf, age=66.0)
    assert sense(leaf, age=0.0) == NO
    assert (asked.jobs[0].cancelled, get(Key.QUESTION)) == (1, None)


def test_what_begins_to_charge_goes_on_only_when_it_may_go_on_for_a_while() -> None:
    leaf = safety.HoldForBattery("hold")
    held(leaf)
    assert [sense(leaf, battery=share) for share in (0.09, 0.2, 0.24, 0.25)] == [RUN, RUN, RUN, NO]


def test_a_base_that_forgot_its_owner_is_asked_for_again_now_and_then() -> None:
    leaf = safety.HoldForLease("hold")
    bench, _ = held(leaf, owner="me")
    assert sense(leaf, owner="me") == NO
    for _ in range(5):
        assert sense(leaf, owner="") == RUN
        bench.clock.sleep(0.5)
    assert [name for name, _, _ in bench.calls] == ["acquire", "acquire"]
    assert sense(leaf, owner="me") == NO


def test_a_base_of_somebody_else_is_never_fought_over() -> None:
    leaf = safety.HoldForLease("hold")
    bench, _ = held(leaf, owner="me")
    assert sense(leaf, owner="bob@console") == RUN
    assert "bob@console" in leaf.feedback_message
    assert bench.calls == []


def test_two_holds_do_not_clear_each_others_reason() -> None:
    """A graver one takes over, and the other one is stopped after it has said its code."""
    grave, other = safety.HoldForEmergencyStop("grave"), safety.HoldForLostBase("other")
    held(grave)
    held(other)
    sense(other, age=5.0)
    sense(grave, emergency_stop=True, age=5.0)
    other.stop(Status.INVALID)
    assert code() == "ESTOP"


def test_a_full_disk_is_waited_for() -> None:
    leaf = safety.HoldForDisk("hold")
    bench, _ = held(leaf)
    assert sense(leaf) == NO
    bench.free_gb = 0.2
    assert sense(leaf) == RUN
    assert code() == "DISK_FULL"
    assert "0.20 GB are free" in leaf.feedback_message
    bench.free_gb = 2.0
    assert sense(leaf) == NO


@pytest.mark.parametrize(("command", "expected"), [("run", NO), ("pause", RUN), ("abort", NO)])
def test_a_pause_is_that_very_word(command: str, expected: Status) -> None:
    leaf = safety.Paused("pause?")
    Bench().set_up(leaf)
    put(COMMAND=command)
    assert tick(leaf) == expected


def test_a_base_that_moves_without_a_drive_is_told_to_stand_and_waited_for() -> None:
    leaf = safety.HoldForRogueBase("hold")
    bench, asked = held(leaf)
    found = []
    for moving in (True, True, True, True, False):
        found.append(sense(leaf, moving=moving))
        bench.clock.sleep(3.0)
    assert found == [NO, NO, RUN, RUN, NO]
    assert (code(), asked.questions) == (None, [])
    assert [name for name, *_ in bench.calls] == ["stop", "stop"]


def test_a_base_that_drives_or_rolls_out_as_it_was_told_is_none_to_hold_for() -> None:
    leaf = safety.HoldForRogueBase("hold")
    bench, _ = held(leaf)
    bench.services.interlock.set_out("drive")
    for _ in range(5):
        assert sense(leaf, moving=True) == NO
        bench.clock.sleep(3.0)
    bench.services.interlock.arrive("drive")
    assert [sense(leaf, moving=True), sense(leaf, moving=False), sense(leaf, moving=True)] == [NO, NO, NO]
    assert bench.calls == []


def test_a_drive_that_is_paused_explains_no_motion_though_no_mission_time_passes() -> None:
    leaf = safety.HoldForRogueBase("hold")
    bench, _ = held(leaf)
    bench.services.interlock.set_out("drive")
    found = [sense(leaf, "pause", moving=True) for _ in range(leaf.rolls_out_ticks + 1)]
    assert found == [NO] * leaf.rolls_out_ticks + [RUN]
    assert [name for name, *_ in bench.calls] == ["stop"]
