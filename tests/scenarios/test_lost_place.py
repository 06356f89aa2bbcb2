"""Bases that begin anew, and robots that were moved while nobody led them: a scan tells where they stand, or nobody."""

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from mission.operator import Word
from perception.failure import Failure
from tests.scenarios.lasting import LastingBase
from tests.scenarios.play import Play
from tests.scenarios.saga import Saga
from tests.scenarios.scripted import EVER
from tests.scenarios.site import row

LOST = Failure("REG_AMBIGUOUS", "as the script wants it")


def rebooting(play: Play, operation: str, at: tuple[float, float, float] | None = None, call: int = 2) -> None:
    """The base begins anew in the tick after the second call of an operation, or the ``call``-th."""
    done: list[int] = []

    def each_tick(play: Play, ticks: int) -> None:
        if play.calls[operation] == call and not done:
            done.append(ticks)
            play.base.reboot(at)

    play.each_tick = each_tick


def assert_all_scans_are_in_place(play: Play) -> None:
    for scan in play.survey.scans:
        assert np.allclose(scan.map_from_base, play.scanner.taken[scan.scan_id])
    # Odometry of another frame is worth nothing, and nobody takes it for a guess.
    assert all(metres < 0.01 for metres, _ in play.perception.guess_errors)


def test_a_base_that_begins_anew_standing_finds_its_place_before_it_moves() -> None:
    """Between two scans of a room: one scan more, registered without a word of odometry, and the mission goes on."""
    whole, play = Play(row(2)), Play(row(2))
    assert whole.run() == "complete"
    rebooting(play, "label_space")
    assert play.run() == "complete"
    assert "hold(LEASE_LOST)" in play.phases
    assert play.calls["take"] == whole.calls["take"] + 1
    (looked,) = play.perception.of_stage("register_globally")
    assert looked["error_m"] == play.settings.registration.global_search_m
    assert_all_scans_are_in_place(play)
    assert play.rooms == whole.rooms


def test_a_base_that_begins_anew_driving_finds_its_place_and_goes_on_to_where_it_was_sent() -> None:
    whole, play = Play(row(2)), Play(row(2))
    assert whole.run() == "complete"
    rebooting(play, "drive", at=(2.0, 0.5, 1.0), call=1)
    assert play.run() == "complete"
    assert play.events.codes == ["NAV_INTERRUPTED"]
    broken, again = play.base.goals[:2]
    assert (broken.x, broken.y) == (again.x, again.y)
    assert again.goal_id != broken.goal_id
    assert again.map_from_base is not None
    assert play.calls["take"] == whole.calls["take"] + 1
    assert_all_scans_are_in_place(play)


def test_a_scan_after_the_base_began_anew_is_itself_what_tells_the_place() -> None:
    """It stood before a scan of the cycle anyway: none is taken for the place alone."""
    whole, play = Play(row(2)), Play(row(2))
    assert whole.run() == "complete"
    done: list[int] = []

    def each_tick(play: Play, ticks: int) -> None:
        if len(play.events.of("drive")) == 1 and not done:
            done.append(ticks)
            play.base.reboot()

    play.each_tick = each_tick
    assert play.run() == "complete"
    assert play.calls["take"] == whole.calls["take"]
    assert play.calls["register_globally"] == 1
    assert_all_scans_are_in_place(play)


def test_a_scan_that_only_told_the_place_is_no_cycle_of_the_room() -> None:
    """Nothing was labelled after it, so it says nothing of how much there is left to see."""
    play = Play(row(1))
    rebooting(play, "label_space", call=1)
    play.base.occupied = {row(1).views("A")[0]}
    assert play.run() == "complete"
    assert play.events.codes == ["NAV_BLOCKED"]
    assert list(play.scanner.taken) == ["S01", "S02", "S03"]
    (cycles,) = play.survey.cycles.values()
    assert [cycle.scan_id for cycle in cycles] == ["S01", "S03"]
    assert_all_scans_are_in_place(play)


def test_a_base_that_begins_anew_while_its_place_is_looked_for_is_looked_for_again() -> None:
    """What the scan finds is where it stood before that: no drive may set out from there."""
    whole, play = Play(row(2)), Play(row(2))
    assert whole.run() == "complete"
    reboots = {("label_space", 2), ("register_globally", 1)}

    def each_tick(play: Play, ticks: int) -> None:
        for operation, call in list(reboots):
            if play.calls[operation] == call:
                reboots.remove((operation, call))
                play.base.reboot()

    play.each_tick = each_tick
    assert play.run() == "complete"
    assert reboots == set()
    assert play.events.codes == ["NAV_INTERRUPTED"]
    assert play.calls["take"] == whole.calls["take"] + 2
    assert_all_scans_are_in_place(play)


def test_a_base_that_dies_three_times_on_one_way_still_arrives() -> None:
    """Each death costs a drive that it broke off, and another one ordered before its new process was the mission's."""
    whole, play = Play(row(2)), Play(row(2))
    assert whole.run() == "complete"
    for call in range(1, 6):
        play.script.fail("drive", "NAV_INTERRUPTED" if call % 2 else "LEASE_LOST", [call])
    assert play.run() == "complete"
    assert play.events.codes == ["NAV_INTERRUPTED", "LEASE_LOST"] * 2 + ["NAV_INTERRUPTED"]
    assert len({(goal.x, goal.y) for goal in play.base.goals[:6]}) == 1
    assert play.rooms == whole.rooms


def lost(attended: bool, drive: int = 2) -> Play:
    """A base that begins anew in mid-drive, on its way to the door, and no scan finds its place after that."""
    play = Play(row(2), attended=attended)
    play.script.answer("register_globally", LOST, EVER)
    rebooting(play, "drive", at=(2.0, 0.5, 1.0), call=drive)
    return play


def test_a_place_that_is_not_found_is_asked_for_and_nothing_moves_without_it() -> None:
    play = lost(attended=True)
    assert play.run() == "incomplete"
    asked = play.events.of("asked")
    assert [question["options"] for question in asked] == [["again", "end"]]
    assert "lost its place" in asked[0]["text"]
    assert [row["by"] for row in play.events.of("answered")] == ["default"]
    assert len(play.base.goals) == 2, "no goal after the one that broke off"
    assert play.rooms == {"A": ("complete", "lambda_mu")}, "what was finished stays so"
    assert [(edge.state, edge.reason) for edge in play.survey.building.doors] == [("refused", "REG_AMBIGUOUS")]


def test_somebody_who_puts_the_robot_back_lets_it_find_its_place() -> None:
    play = lost(attended=True)
    play.script.answer("register_globally", LOST, [1])
    play.script.answer("register_globally", None, range(2, 100))
    reboot = play.each_tick

    def each_tick(play: Play, ticks: int) -> None:
        reboot(play, ticks)
        for question in play.desk.open:
            play.desk.answer(question.question_id, "again")

    play.each_tick = each_tick
    assert play.run() == "complete"
    assert play.calls["register_globally"] == 2
    assert_all_scans_are_in_place(play)


def test_without_a_place_or_anybody_to_ask_the_mission_ends_on_the_spot() -> None:
    """On the way to a view: the room that it was for stays partial and says why."""
    play = lost(attended=False, drive=1)
    assert play.run() == "incomplete"
    assert play.rooms == {"A": ("partial", "REG_AMBIGUOUS")}
    assert len(play.base.goals) == 1
    assert play.calls["take"] == 2, "one look around, and no door or way home is tried after it"
    assert play.base.pose == (2.0, 0.5, 1.0)


# --- over the lives of an executive ----------------------------------------------------------------------------------


def between_lives(folder: Path, befalls: Callable[[LastingBase], None], instant: int) -> Saga:
    """A mission whose executive dies at its n-th write; then something befalls the base, and it is resumed."""
    folder.mkdir(parents=True)
    saga = Saga(folder, row(2))
    assert saga.live(instant, after=instant % 2 == 0) == "killed"
    befalls(saga.base)
    assert saga.live() == "complete", instant
    assert saga.survey.scans
    assert list(saga.scanner.taken) == sorted(set(saga.scanner.taken))
    for scan in saga.survey.scans:
        assert np.allclose(scan.map_from_base, saga.scanner.taken[scan.scan_id])
    return saga


def is_carried_by_hand(base: LastingBase) -> None:
    """Switched off for it: its agent begins anew."""
    x, y, _ = base.pose
    base.reboot((x / 2, y / 2, 2.0))


def is_pushed(base: LastingBase) -> None:
    """The agent is up, odometry counts on, and the drive it was on is over."""
    x, y, _ = base.pose
    base.pose = (x / 2 + 0.3, y / 2, 2.0)


@pytest.mark.parametrize("befalls", [LastingBase.reboot, is_carried_by_hand])
def test_a_mission_is_resumed_though_its_base_began_anew(befalls: Callable, tmp_path: Path) -> None:
    whole = Saga(tmp_path, row(2))
    assert whole.live() == "complete"
    for instant in range(2, whole.writes, 7):
        between_lives(tmp_path / str(instant), befalls, instant)


def test_a_robot_that_was_pushed_in_between_looks_around_before_it_moves(tmp_path: Path) -> None:
    whole = Saga(tmp_path, row(2))
    assert whole.live() == "complete"
    looked = 0
    for instant in range(8, 30, 2):
        saga = between_lives(tmp_path / str(instant), is_pushed, instant)
        looked += len(saga.scanner.taken) > len(whole.scanner.taken)
    assert looked > 2


def test_what_a_life_found_out_about_the_place_the_next_one_knows(tmp_path: Path) -> None:
    """Killed again and again, the base begun anew each time: every life tells the ones before it as they were.

    Each life lasts for as long as it takes to look around and to drive.
    """
    tmp_path.joinpath("saga").mkdir()
    saga = Saga(tmp_path / "saga", row(2))
    lives = 1
    while (end := saga.live(dies_at=17, after=lives % 2 == 0)) == "killed":
        saga.base.reboot()
        lives += 1
    assert (end, lives > 5, len(saga.survey.scans) > 0) == ("complete", True, True)
    for scan in saga.survey.scans:
        assert np.allclose(scan.map_from_base, saga.scanner.taken[scan.scan_id])


def test_nothing_moves_and_nothing_is_scanned_for_the_place_before_the_operator_says_so(tmp_path: Path) -> None:
    saga = Saga(tmp_path, row(2))
    assert saga.live(dies_at=30) == "killed"
    saga.base.reboot()
    before = len(saga.base.goals), len(saga.scanner.taken)
    seen = []

    def watch(word: Word, ticks: int) -> None:
        seen.append((len(saga.base.goals), len(saga.scanner.taken)))
        (word.pause if ticks < 10 else word.resume)()

    assert saga.live(each_tick=watch) == "complete"
    assert set(seen[:9]) == {before}
