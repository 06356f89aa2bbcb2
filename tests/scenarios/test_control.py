"""Missions that are paused, held and asked about: whatever the moment, the robot stands still and nothing is lost."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

import pytest

from behaviours.settings import OperatorSettings, Settings
from tests.scenarios.play import Play
from tests.scenarios.scripted import EVER, FOR_GOOD, TWICE, Way
from tests.scenarios.site import row

EachTick = Callable[[Play, int], None]

PAUSE_TICKS = 7
"""Longer than the longest thing that a script does, so that its outcome is there before the mission goes on."""


@dataclass(frozen=True)
class Traces:
    """What a mission did, and what came of it."""

    ticks: int
    seconds: float
    phases: tuple[str, ...]
    scans: tuple[str, ...]
    deeds: tuple[object, ...]

    @classmethod
    def of(cls, play: Play) -> "Traces":
        poses = [(scan.scan_id, scan.room_id, scan.base_pose) for scan in play.survey.scans]
        goals = [(goal.goal_id, goal.x, goal.y) for goal in play.base.goals]
        stages = [name for name, _ in play.perception.requests]
        deeds = (poses, goals, stages, play.rooms, play.doors, dict(play.calls))
        scans = tuple(scan.scan_id for scan in play.survey.scans)
        return cls(play.ticks, play.clock.now(), tuple(play.phases), scans, deeds)


@cache
def undisturbed(rooms: int) -> Traces:
    play = Play(row(rooms))
    assert play.run() == "complete"
    return Traces.of(play)


def pause_at(tick: int, for_ticks: int = PAUSE_TICKS) -> EachTick:
    def each_tick(play: Play, ticks: int) -> None:
        if ticks == tick:
            play.word.pause()
        if ticks == tick + for_ticks:
            play.word.resume()

    return each_tick


# --- pause and abort ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("first", range(4))
def test_a_pause_at_any_tick_changes_nothing_but_the_time(first: int) -> None:
    """Paused and resumed at every single tick of a mission: the same scans and goals, once each, and no motion."""
    expected = undisturbed(1)
    for tick in range(first + 1, expected.ticks, 4):
        begun: dict[int, int] = {}
        act = pause_at(tick)

        def each_tick(play: Play, ticks: int, act: EachTick = act, begun: dict[int, int] = begun) -> None:
            begun[ticks] = len(play.script.jobs)
            act(play, ticks)

        play = Play(row(1), each_tick=each_tick)
        assert play.run() == "complete", f"at tick {tick}"
        assert Traces.of(play).deeds == expected.deeds, f"at tick {tick}"
        assert "paused" in play.phases
        assert play.clock.now() <= expected.seconds, "mission time does not pass in a pause"
        paused = range(tick + 1, tick + PAUSE_TICKS + 1)
        assert {dict(play.base.beats)[ticks] for ticks in paused} == {False}, f"at tick {tick}"
        assert len({begun[ticks] for ticks in range(tick, tick + PAUSE_TICKS + 1)}) == 1, f"at tick {tick}"


def test_no_deadline_passes_in_a_pause() -> None:
    """A drive is paused for longer than drives may take."""
    settings = Settings()
    settings = replace(settings, driving=replace(settings.driving, timeout_s=60.0))

    def each_tick(play: Play, ticks: int) -> None:
        if play.calls["drive"] == 1 and "paused" not in play.phases:
            play.word.pause()
        if play.course.state.phase == "paused" and play.script.clock.now() > 2000.0:
            play.word.resume()

    play = Play(row(2), settings=settings, each_tick=each_tick)
    assert play.run() == "complete"
    assert "NAV_TIMEOUT" not in play.events.codes


@pytest.mark.parametrize("first", range(2))
def test_an_abort_of_a_paused_mission_ends_it_at_once(first: int) -> None:
    for tick in range(first + 1, undisturbed(1).ticks, 2):

        def each_tick(play: Play, ticks: int, tick: int = tick) -> None:
            if ticks == tick:
                play.word.pause()
            if ticks == tick + 2:
                play.word.abort()

        play = Play(row(1), each_tick=each_tick)
        assert play.run() == "aborted", f"at tick {tick}"
        assert play.ticks <= tick + 5
        assert play.phases[-2:] == ["paused", "aborted"]


def test_the_base_may_move_only_while_no_scan_is_taken() -> None:
    """The interlock: from the order of a scan to its end no beat allows motion."""
    scanning: dict[int, bool] = {}

    def note(play: Play, ticks: int) -> None:
        scanning[ticks] = any(job.what == "take" and not job.over for job in play.script.jobs)

    play = Play(row(2), each_tick=note)
    assert play.run() == "complete"
    allowed = dict(play.base.beats)
    assert sum(scanning.values()) > 5
    assert not any(allowed[tick] for tick, taken in scanning.items() if taken)
    assert any(allowed.values())


def test_the_phases_of_a_mission_in_which_all_goes_well() -> None:
    assert undisturbed(2).phases == ("running", "returning", "done")


# --- emergency stop and lost base -----------------------------------------------------------------------------------


def press(tick: int, release: int, word: str | None = "resume") -> EachTick:
    """The red button is pressed and released, and the operator says whether to go on."""

    def each_tick(play: Play, ticks: int) -> None:
        play.base.emergency_stop = tick <= ticks < release
        for question in play.desk.open:
            if word is not None:
                play.desk.answer(question.question_id, word)

    return each_tick


@pytest.mark.parametrize("first", range(2))
def test_an_emergency_stop_at_any_tick_that_is_released_costs_no_scan(first: int) -> None:
    expected = undisturbed(1)
    for tick in range(first + 1, expected.ticks - 2, 2):
        play = Play(row(1), attended=True, each_tick=press(tick, tick + 5))
        assert play.run() == "complete", f"at tick {tick}"
        assert Traces.of(play).scans == expected.scans, f"at tick {tick}"
        assert "hold(ESTOP)" in play.phases
        held = range(tick + 1, tick + 5)
        assert {dict(play.base.beats)[ticks] for ticks in held} == {False}


@pytest.mark.parametrize("word", ["end", None])
def test_a_released_stop_without_leave_to_go_on_ends_the_mission(word: str | None) -> None:
    play = Play(row(2), attended=True, each_tick=press(20, 25, word))
    assert play.run() == "safety_stop"
    assert [question.by for question in play.desk.questions] == ["operator" if word else "default"]


def test_a_stop_that_is_never_released_ends_the_mission_within_its_bound() -> None:
    play = Play(row(2), attended=True, each_tick=press(20, FOR_GOOD, None))
    assert play.run() == "safety_stop"
    settings = play.settings
    bound = settings.building.release_s + settings.operator.patience_s
    assert play.clock.now() < 20 * 10.0 + bound + 60.0


@pytest.mark.parametrize("first", range(2))
def test_a_base_that_is_lost_at_any_tick_and_comes_back_is_driven_on(first: int) -> None:
    """Silent for half a minute: nobody has to do anything."""
    for tick in range(first + 1, undisturbed(1).ticks - 2, 2):

        def each_tick(play: Play, ticks: int, tick: int = tick) -> None:
            away = tick <= ticks < tick + 4
            since = play.base.silent_since
            play.base.silent_since = (play.script.clock.now() if since is None else since) if away else None

        play = Play(row(1), each_tick=each_tick)
        assert play.run() == "complete", f"at tick {tick}"
        assert Traces.of(play).scans == undisturbed(1).scans, f"at tick {tick}"
        assert "hold(BASE_LOST)" in play.phases


# --- questions ------------------------------------------------------------------------------------------------------


def refused(play: Play, calls: range = EVER) -> Play:
    for stage in ("register_scan", "register_globally"):
        play.script.fail(stage, "REG_DEGENERATE", calls)
    return play


def answering(word: str) -> EachTick:
    def each_tick(play: Play, ticks: int) -> None:
        for question in play.desk.open:
            play.desk.answer(question.question_id, word)

    return each_tick


def test_an_operator_who_helps_saves_the_room() -> None:
    """Two scans in a row find no place; the operator puts something right and says "again"."""
    play = refused(Play(row(1), attended=True, each_tick=answering("again")), TWICE)
    assert play.run() == "complete"
    assert play.phases[:3] == ["running", "asking", "running"]
    (question,) = play.desk.questions
    assert (question.question_id, question.answer, question.by) == ("Q001", "again", "operator")
    assert "R1" in question.text


def test_a_question_that_nobody_answers_takes_its_default_at_its_deadline() -> None:
    settings = replace(Settings(), operator=OperatorSettings(patience_s=300.0))
    play = refused(Play(row(1), attended=True, settings=settings))
    assert play.run() == "incomplete"
    (question,) = play.desk.questions
    assert (question.answer, question.by) == ("go on", "default")
    asked, answered = play.events.of("asked")[0], play.events.of("answered")[0]
    assert 300.0 <= answered["t"] - asked["t"] <= 310.0
    assert {status for status, _ in play.rooms.values()} == {"partial"}


def test_an_unattended_mission_asks_nobody() -> None:
    play = refused(Play(row(1)))
    assert play.run() == "incomplete"
    assert {(question.answer, question.by) for question in play.desk.questions} == {("go on", "default")}
    asked, answered = play.events.of("asked")[0], play.events.of("answered")[0]
    assert asked["t"] == answered["t"]


def test_an_operator_who_always_says_again_is_not_asked_for_ever() -> None:
    play = refused(Play(row(1), attended=True, each_tick=answering("again")))
    assert play.run() == "incomplete"
    assert len(play.desk.questions) == play.settings.operator.rounds - 1


def test_a_door_that_somebody_opens_when_asked_is_passed() -> None:
    def each_tick(play: Play, ticks: int) -> None:
        for question in play.desk.open:
            play.base.closed.clear()
            play.desk.answer(question.question_id, "again")

    play = Play(row(2), attended=True, each_tick=each_tick)
    play.base.closed.add("A-B")
    assert play.run() == "complete"
    assert play.scans_of("B") > 0


def test_the_base_may_not_move_while_a_question_is_open() -> None:
    asked: list[int] = []

    def note(play: Play, ticks: int) -> None:
        if play.course.state.phase == "asking":
            asked.append(ticks)

    play = refused(Play(row(1), attended=True, each_tick=note))
    play.run()
    assert asked
    assert not any(dict(play.base.beats)[tick] for tick in asked)


# --- charge ---------------------------------------------------------------------------------------------------------


def discharge(at: int, to: float, charged_after: int = FOR_GOOD) -> EachTick:
    def each_tick(play: Play, ticks: int) -> None:
        if ticks == at:
            play.base.battery = to
        if any(goal.x == goal.y == 0.0 for goal in play.base.goals) and play.calls["drive"]:
            charged_after_ticks.append(ticks)
        if len(charged_after_ticks) > charged_after:
            play.base.battery = 0.95

    charged_after_ticks: list[int] = []
    return each_tick


def test_a_low_battery_sends_the_robot_home_after_the_scan_and_back_to_work() -> None:
    play = Play(row(2), each_tick=discharge(30, 0.2, charged_after=12))
    assert play.run() == "complete"
    assert play.phases.count("returning") == 2
    purposes = [event["purpose"] for event in play.events.of("drive")]
    assert "back" in purposes
    assert purposes.count("start") == 2
    assert Traces.of(play).scans == undisturbed(2).scans


def test_a_charger_that_does_not_charge_ends_the_mission_at_the_start_with_the_reason() -> None:
    play = Play(row(2), each_tick=discharge(30, 0.2))
    assert play.run() == "incomplete"
    assert ("partial", "BATTERY_LOW") in play.rooms.values()
    assert play.base.pose[:2] == (0.0, 0.0)


def test_a_critical_battery_holds_and_goes_on_when_it_is_charged_where_it_stands() -> None:
    def each_tick(play: Play, ticks: int) -> None:
        play.base.battery = {20: 0.05, 40: 0.3}.get(ticks, play.base.battery)

    play = Play(row(2), each_tick=each_tick)
    assert play.run() == "complete"
    assert "hold(BATTERY_CRITICAL)" in play.phases


def test_a_base_that_somebody_pushes_holds_the_mission_until_it_stands() -> None:
    def each_tick(play: Play, ticks: int) -> None:
        play.base.is_pushed = 20 <= ticks < 30

    play = Play(row(2), each_tick=each_tick)
    assert play.run() == "complete"
    assert play.phases.count("hold(BASE_ROGUE)") == 1
    assert "stop" in play.base.commands[:-1]
    assert Traces.of(play).scans == undisturbed(2).scans


def test_a_base_that_is_pushed_in_a_pause_of_its_drive_is_told_to_stand_too() -> None:
    def each_tick(play: Play, ticks: int) -> None:
        if play.calls["drive"] == 1 and not paused:
            play.word.pause()
            paused.append(ticks)
        play.base.is_pushed = bool(paused) and paused[0] + 5 <= ticks < paused[0] + 80
        if paused and ticks == paused[0] + 100:
            play.word.resume()

    paused: list[int] = []
    play = Play(row(2), each_tick=each_tick)
    assert play.run() == "complete"
    where = play.phases.index("hold(BASE_ROGUE)")
    assert play.phases[where - 1 : where + 3] == ["paused", "hold(BASE_ROGUE)", "paused", "running"]
    assert "stop" in play.base.commands[:-1]
    assert Traces.of(play).scans == undisturbed(2).scans


def test_a_charged_robot_whose_way_back_is_blocked_goes_on_with_what_it_can_reach() -> None:
    play = Play(row(2), each_tick=discharge(30, 0.2, charged_after=12))
    play.script.fail("drive", "NAV_BLOCKED", (4,))
    assert play.run() == "incomplete"
    assert [event["purpose"] for event in play.events.of("drive")] == ["view", "door", "start", "back", "start"]
    assert ("partial", "NAV_BLOCKED") in play.rooms.values()
    assert play.course.state.code == ""


def test_a_hold_in_mid_drive_costs_the_drive_nothing_of_its_deadline() -> None:
    settings = Settings()
    held_s = 1.2 * settings.driving.timeout_s

    def each_tick(play: Play, ticks: int) -> None:
        under_way = any(job.what == "drive" and not job.over for job in play.script.jobs)
        if under_way and not began:
            began.append(play.clock.now())
        charged = not began or play.clock.now() > began[0] + held_s
        play.base.battery = 0.9 if charged else 0.05

    began: list[float] = []
    play = Play(row(1), each_tick=each_tick)
    play.script.answer("drive", Way(seconds=lambda seconds: seconds + held_s))
    assert play.run() == "complete"
    assert play.phases.count("hold(BATTERY_CRITICAL)") == 1
    assert play.events.codes == []


def test_a_robot_that_cannot_come_home_to_charge_says_where_it_ended_and_why() -> None:
    play = Play(row(2), each_tick=discharge(30, 0.2))
    play.script.fail("drive", "NAV_BLOCKED", (3, 4, 5))
    assert play.run() == "incomplete"
    assert [event["purpose"] for event in play.events.of("drive")][2:] == ["start", "start", "start"]
    assert str(play.course.state).startswith("INCOMPLETE(NAV_BLOCKED): the robot did not come home")


@pytest.mark.parametrize("first", range(1, 30, 4))
def test_a_disk_that_is_full_for_a_while_costs_no_scan(first: int) -> None:
    def fill(play: Play, ticks: int) -> None:
        play.floor.free = 0.1 if first <= ticks < first + 5 else 100.0

    play, quiet = Play(row(1), each_tick=fill), Play(row(1))
    assert play.run() == quiet.run() == "complete"
    assert "hold(DISK_FULL)" in play.phases
    assert list(play.scanner.taken) == list(quiet.scanner.taken)
