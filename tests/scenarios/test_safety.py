"""Missions that are ended from outside, at any moment, and missions that a bug ends: the base always stands still."""

from collections.abc import Callable

import pytest

from tests.scenarios.play import Play
from tests.scenarios.scripted import EVER, HANG
from tests.scenarios.site import row


def ticks_of_a_happy_mission() -> int:
    play = Play(row(2))
    play.run()
    return play.ticks


def during(operation: str, act: Callable[[Play], None]) -> Callable[[Play, int], None]:
    """Something that happens once, while the second job of this kind runs."""

    def each_tick(play: Play, ticks: int) -> None:
        jobs = [job for job in play.script.jobs if job.what == operation]
        if len(jobs) == 2 and not jobs[1].over:
            act(play)

    return each_tick


@pytest.mark.parametrize("first", range(4))
def test_an_abort_at_any_tick_ends_the_mission_at_rest(first: int) -> None:
    """The operator changes her mind at every single tick of a mission of two rooms, one mission for each.

    (``Play.run`` checks each time: no node runs, no job is left, the base was told to stop, the journal is whole.)
    """
    total = ticks_of_a_happy_mission()
    assert total > 50
    for tick in range(first + 1, total + 1, 4):
        play = Play(row(2), abort_at=tick)
        assert play.run() == "aborted", f"at tick {tick}"
        assert play.ticks <= tick + 2, f"at tick {tick}"
        assert all(job.over for job in play.script.jobs)


def test_an_abort_while_driving_cancels_the_drive() -> None:
    """The job is cancelled by the leaf itself, before the base is told to stop."""
    play = Play(row(2), each_tick=during("drive", lambda play: setattr(play, "abort_at", 0)))
    assert play.run() == "aborted"
    assert [job.cancelled for job in play.script.jobs if job.what == "drive"] == [False, True]


def test_an_aborted_scan_leaves_what_was_registered_before() -> None:
    """Abort during the second scan: the first one stays in the survey, the second has no place."""
    play = Play(row(2), each_tick=during("take", lambda play: setattr(play, "abort_at", 0)))
    assert play.run() == "aborted"
    assert [scan.scan_id for scan in play.survey.scans] == ["S01"]
    assert play.rooms == {"A": ("open", "")}


@pytest.mark.parametrize("operation", ["take", "drive", "label_space", "find_doors"])
def test_an_emergency_stop_ends_the_mission_whatever_it_is_doing(operation: str) -> None:
    """Somebody presses the red button."""
    play = Play(row(2), each_tick=during(operation, lambda play: setattr(play.base, "emergency_stop", True)))
    assert play.run() == "safety_stop"
    assert play.script.jobs[-1].what == "stop"


def test_an_operator_who_aborts_is_obeyed_in_an_emergency_stop_too() -> None:
    """Both at once: nobody has to find the red button first to get the mission to an end."""

    def both(play: Play) -> None:
        play.base.emergency_stop, play.abort_at = True, 0

    assert Play(row(1), each_tick=during("drive", both)).run() == "aborted"


def test_a_base_that_falls_silent_for_good_ends_the_mission_within_its_bound() -> None:
    """No telemetry for longer than is tolerable: the base stops by itself then, and is waited for, but not for ever."""

    def falls_silent(play: Play) -> None:
        if play.base.silent_since is None:
            play.base.silent_since = play.script.clock.now()

    play = Play(row(2), each_tick=during("drive", falls_silent))
    play.script.fail("stop", "AGENT_UNREACHABLE", EVER)
    assert play.run() == "safety_stop"
    assert play.base.silent_since is not None
    assert play.script.clock.now() - play.base.silent_since < 150.0
    assert play.events.codes[-2:] == ["BASE_LOST", "AGENT_UNREACHABLE"]
    assert play.phases[-2:] == ["hold(BASE_LOST)", "aborted(SAFETY_STOP)"]


def test_a_base_that_never_spoke_gets_no_scan_that_would_have_no_place() -> None:
    """There is no odometry: no scan is taken, and the room says why."""
    play = Play(row(1))
    play.base.state = lambda: None  # type: ignore[method-assign]
    assert play.run() == "incomplete"
    assert play.rooms == {"A": ("partial", "BASE_LOST")}
    assert play.calls["take"] == 0


def test_a_base_that_does_not_confirm_its_stop_does_not_keep_the_mission_from_ending() -> None:
    """The order to stop is never answered. The mission has ended all the same, and the order stands."""
    play = Play(row(1), abort_at=5)
    play.script.answer("stop", HANG, EVER)
    assert play.executive.run() == "aborted"
    assert play.base.commands[-1] == "stop"


BUGS = {
    "a value of the wrong type": ("label_space", "nonsense", "LEAF_EXCEPTION"),
    "a shape that is none": ("segment_room", 42, "LEAF_EXCEPTION"),
    "no alignment at all": ("align_scan", 42, "LEAF_EXCEPTION"),
    "a receipt that is none": ("take", object(), "DRIVER_EXCEPTION"),
}


@pytest.mark.parametrize(("operation", "value", "code"), BUGS.values(), ids=BUGS)
def test_a_bug_in_a_leaf_ends_the_room_and_not_the_mission(operation: str, value: object, code: str) -> None:
    """A leaf chokes on what it is given, each time: that is a failure with a name, and the robot still goes home."""
    play = Play(row(1))
    play.script.answer(operation, value, EVER)
    assert play.run() == "incomplete"
    assert set(play.rooms.values()) == {("partial", code)}
    assert code in play.events.codes


def test_a_driver_that_raises_when_polled_does_not_keep_its_job() -> None:
    """The drive's own job breaks: the leaf fails, and the job is cancelled, because the base may still be driving."""

    def broken() -> None:
        raise OSError("the link is gone")

    def breaks(play: Play, ticks: int) -> None:
        for job in play.script.jobs[-1:]:
            if job.what == "drive":
                job.poll = broken  # type: ignore[assignment]

    play = Play(row(1), each_tick=breaks)
    assert play.run() == "incomplete"
    drives = [job for job in play.script.jobs if job.what == "drive"]
    assert drives
    assert all(job.cancelled for job in drives)


def test_an_exception_that_escapes_the_tick_is_a_fault_and_the_base_stands_still() -> None:
    """Something around the tree breaks while the base drives."""

    def breaks(play: Play) -> None:
        raise RuntimeError("no space left for the display")

    play = Play(row(2), each_tick=during("drive", breaks))
    assert play.run() == "fault"
    assert play.events.codes[-1] == "TICK_EXCEPTION"
    assert [job.cancelled for job in play.script.jobs if job.what == "drive"] == [False, True]


@pytest.mark.parametrize("kind", ["node", "registered", "drive", "declined", "room_ended"])
def test_a_journal_that_cannot_be_written_is_a_fault_and_the_base_stands_still(kind: str) -> None:
    """The disk is full. Nothing can be put on record any more, not even that; the robot stops all the same."""
    play = Play(row(2))
    write, is_full = play.events.record, []

    def record(of: str, /, **figures: object) -> None:
        is_full.extend([True] if of == kind else [])
        if is_full:
            raise OSError(28, "No space left on device")
        write(of, **figures)

    play.events.record = record  # type: ignore[method-assign]
    assert play.executive.run() == "fault"
    assert play.base.commands[-1] == "stop"
    assert all(job.over for job in play.script.jobs)


def test_an_interrupted_process_still_stops_the_base() -> None:
    """A second Ctrl-C tears through everything; on its way out the leaves are stopped and the base is told."""

    def interrupts(play: Play) -> None:
        raise KeyboardInterrupt

    play = Play(row(2), each_tick=during("drive", interrupts))
    with pytest.raises(KeyboardInterrupt):
        play.run()
    play.assert_at_rest()
