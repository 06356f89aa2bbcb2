"""The watch over every scenario sees each promise that is broken: here each is broken once."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from behaviours import safety
from behaviours.keys import Key
from behaviours.rooms import GiveUpRoom
from behaviours.scanning import FetchScan, StandStill, TakeScan
from behaviours.services import Interlock
from behaviours.survey import Survey
from drivers.interfaces import ScanSettings
from drivers.jobs import Done
from mission import executive
from mission.ledger import Ledger
from mission.phase import Phase
from perception.failure import Failure
from perception.transforms import planar
from tests.drivers.wire_fakes import make_goal
from tests.scenarios.kept import Kept
from tests.scenarios.play import Play
from tests.scenarios.scripted import EVER
from tests.scenarios.site import row

Patch = pytest.MonkeyPatch
Breach = Callable[[Patch, Play], None]

WHILE = range(12, 14)
"""Ticks for which something is wrong that forbids to move; the base drives then, where nothing does."""


def moves_while_it_scans(patch: Patch, play: Play) -> None:
    patch.setattr(Interlock, "lets_drive", lambda self, now: True)


def moves_in_a_hold(patch: Patch, play: Play) -> None:
    patch.setattr(Interlock, "lets_drive", lambda self, now: True)
    patch.setattr(executive, "DRIVING", frozenset(Phase))
    play.each_tick = lambda play, ticks: setattr(play.floor, "free", 0.0 if 8 <= ticks < 14 else 100.0)


def moves_with_the_red_button_pressed(patch: Patch, play: Play) -> None:
    patch.setattr(safety.HoldForEmergencyStop, "trouble", lambda self, base: None)
    play.each_tick = lambda play, ticks: setattr(play.base, "emergency_stop", ticks in WHILE)


def moves_though_the_base_is_lost(patch: Patch, play: Play) -> None:
    patch.setattr(safety.HoldForLostBase, "trouble", lambda self, base: None)
    play.each_tick = lambda play, ticks: setattr(play.base, "silent_since", -1000.0 if ticks in WHILE else None)


def moves_a_base_that_is_not_its_own(patch: Patch, play: Play) -> None:
    patch.setattr(safety.HoldForLease, "trouble", lambda self, base: None)
    owner = play.base.owner
    play.each_tick = lambda play, ticks: setattr(play.base, "owner", "somebody" if ticks in WHILE else owner)


def moves_without_charge(patch: Patch, play: Play) -> None:
    patch.setattr(safety.HoldForBattery, "trouble", lambda self, base: None)
    play.each_tick = lambda play, ticks: setattr(play.base, "battery", 0.01 if ticks in WHILE else 0.9)


def moves_in_a_pause(patch: Patch, play: Play) -> None:
    beat = play.executive._services.base.beat
    patch.setattr(play.executive._services.base, "beat", lambda tick, may_move: beat(tick, True))
    play.each_tick = lambda play, ticks: (play.word.pause if ticks in WHILE else play.word.resume)()


def skips_a_beat(patch: Patch, play: Play) -> None:
    beat = play.executive._services.base.beat
    patch.setattr(
        play.executive._services.base, "beat", lambda tick, may_move: None if tick == 5 else beat(tick, may_move)
    )


def never_ends(patch: Patch, play: Play) -> None:
    play.each_tick = lambda play, ticks: play.word.pause()


def takes_a_scan_twice(patch: Patch, play: Play) -> None:
    _also_begins(patch, lambda take: take.services.scanner.take("S01", ScanSettings(0.1), planar(0, 0, 0)))


def drives_during_a_scan(patch: Patch, play: Play) -> None:
    _also_begins(patch, lambda take: take.services.base.drive(replace(make_goal("G9"), map_from_base=None)))


def takes_a_scan_of_a_base_that_rolls(patch: Patch, play: Play) -> None:
    patch.setattr(StandStill, "step", lambda self: executive.Status.SUCCESS)


def _also_begins(patch: Patch, job: Callable[[TakeScan], object]) -> None:
    start = TakeScan.start

    def both(self: TakeScan) -> object:
        taken = start(self)
        job(self)
        return taken

    patch.setattr(TakeScan, "start", both)


def leaves_a_job_behind(patch: Patch, play: Play) -> None:
    patch.setattr(TakeScan, "terminate", lambda self, status: self.services.interlock.release(self.name))
    play.abort_at = 3


def does_not_stop_the_base(patch: Patch, play: Play) -> None:
    patch.setattr(type(play.executive), "_stand_still", lambda self: None)
    patch.setattr(safety.EndMission, "start", lambda self: _Done())


def leaves_a_node_running(patch: Patch, play: Play) -> None:
    patch.setattr(type(play.executive), "_come_to_rest", lambda self: self._stand_still())
    play.abort_at = 3


def never_says_that_it_has_ended(patch: Patch, play: Play) -> None:
    patch.setattr(play.course, "enter", lambda state: False)


def places_a_scan_that_never_came_home(patch: Patch, play: Play) -> None:
    patch.setattr(FetchScan, "start", lambda self: _Done())
    patch.setattr(FetchScan, "finish", lambda self, value: executive.Status.SUCCESS)


def gives_up_without_a_reason(patch: Patch, play: Play) -> None:
    read = GiveUpRoom.read
    patch.setattr(GiveUpRoom, "read", lambda self, key: Failure("", "") if key is Key.FAILURE else read(self, key))
    play.script.fail("segment_room", "PERC_DIED", EVER)


def forgets_a_scan_it_placed(patch: Patch, play: Play) -> None:
    patch.setattr(Survey, "with_scan", lambda self, scan: replace(self, scans=(scan,), track=(scan.base_pose,)))


def leaves_a_job_without_an_end_in_the_ledger(patch: Patch, play: Play) -> None:
    end = Ledger.end
    patch.setattr(Ledger, "end", lambda self, seq, *rest: None if seq == 4 else end(self, seq, *rest))


def forgets_to_log_a_change_of_a_node(patch: Patch, play: Play) -> None:
    _loses(patch, play, "node", lambda figures: figures["after"] == "SUCCESS")


def forgets_to_log_the_end_of_a_node(patch: Patch, play: Play) -> None:
    _loses(patch, play, "node", lambda figures: figures["node"] == play.root.name and figures["after"] == "INVALID")


def forgets_to_log_the_end_of_a_room(patch: Patch, play: Play) -> None:
    _loses(patch, play, "room_ended", lambda _: True)


def forgets_to_log_a_pose(patch: Patch, play: Play) -> None:
    _loses(patch, play, "registered", lambda _: True)


def _loses(patch: Patch, play: Play, kind: str, which: Callable[[dict], bool]) -> None:
    """Events of a kind never reach the log."""
    journal = play.executive._services.journal
    record = journal.record

    def loses(of: str, /, **figures: object) -> None:
        if of != kind or not which(figures):
            record(of, **figures)

    patch.setattr(journal, "record", loses)


def calls_a_whole_mission_incomplete(patch: Patch, play: Play) -> None:
    patch.setattr(executive, "verdict", lambda survey: "incomplete")


def calls_a_mission_with_an_open_room_complete(patch: Patch, play: Play) -> None:
    patch.setattr(executive, "verdict", lambda survey: "complete")
    play.script.fail("segment_room", "PERC_DIED", EVER)


def aborts_by_itself(patch: Patch, play: Play) -> None:
    patch.setattr(play.executive, "_command", lambda: "abort")


def faults_without_an_error(patch: Patch, play: Play) -> None:
    patch.setattr(type(play.executive), "_note", lambda self, error: executive.NOTHING)
    play.each_tick = lambda play, ticks: play.desk.answer()  # type: ignore[call-arg]


class _Done:
    def poll(self) -> Done[str]:
        return Done("S01.scan")

    def cancel(self) -> None:
        """There is nothing to cancel."""


BREACHES: dict[Breach, str] = {
    moves_while_it_scans: r"beat \d+ let the base move during \[take S01\]",
    moves_in_a_hold: r"let the base move in the phase hold",
    moves_with_the_red_button_pressed: "let the base move with the emergency stop pressed",
    moves_though_the_base_is_lost: "let the base move though the base is lost",
    moves_a_base_that_is_not_its_own: "let the base move though the base is not its own",
    moves_without_charge: "let the base move without charge",
    moves_in_a_pause: "let the base move though the word is pause",
    skips_a_beat: "tick 5 had no beat",
    never_ends: "this mission does not end",
    takes_a_scan_twice: "take S01 was ordered twice",
    drives_during_a_scan: r"drive G9 was ordered during \[take S01\]",
    takes_a_scan_of_a_base_that_rolls: "S02 was ordered while the base moves",
    leaves_a_job_behind: "a job runs on",
    leaves_a_node_running: "a node was not stopped",
    does_not_stop_the_base: "the base was not told to stop at the end",
    never_says_that_it_has_ended: "the mission has no end",
    places_a_scan_that_never_came_home: "a scan has a pose that was never brought home",
    gives_up_without_a_reason: "R1: no reason",
    forgets_a_scan_it_placed: "the scans with a pose are not those in the log",
    forgets_to_log_a_pose: "the scans with a pose are not those in the log",
    forgets_to_log_a_change_of_a_node: "a change of a node is not in the log",
    forgets_to_log_the_end_of_a_node: "the end of a node is not in the log",
    forgets_to_log_the_end_of_a_room: "the log tells another end of a room",
    leaves_a_job_without_an_end_in_the_ledger: "a job has no end in the ledger",
    calls_a_whole_mission_incomplete: "incomplete without a shortfall",
    calls_a_mission_with_an_open_room_complete: "R1 is partial",
    aborts_by_itself: "aborted by nobody",
    faults_without_an_error: "a fault without an error",
}
"""What a mission does that it must not, and what is said of it."""


@pytest.mark.parametrize("breach", BREACHES, ids=lambda breach: breach.__name__)
def test_a_mission_that_breaks_a_promise_is_told_which(breach: Breach, monkeypatch: Patch) -> None:
    play = Play(row(1), most_ticks=500)
    breach(monkeypatch, play)
    with pytest.raises(AssertionError, match=BREACHES[breach]):
        play.run()


def test_a_mission_that_keeps_them_all_passes() -> None:
    Play(row(1)).run()


def test_a_mission_with_a_run_folder_is_watched_too(monkeypatch: Patch, tmp_path: Path) -> None:
    monkeypatch.setattr(Interlock, "lets_drive", lambda self, now: True)
    with pytest.raises(AssertionError, match=BREACHES[moves_while_it_scans]):
        Kept(tmp_path).fly()
