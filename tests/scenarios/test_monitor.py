"""The watch over every scenario sees each promise that is broken: here each is broken once."""

from collections.abc import Callable
from dataclasses import replace

import pytest

from behaviours import safety
from behaviours.rooms import GiveUpRoom
from behaviours.scanning import FetchScan, TakeScan
from behaviours.services import Interlock
from behaviours.survey import Survey
from drivers.interfaces import ScanSettings
from drivers.jobs import Done
from mission import executive
from mission.ledger import Ledger
from mission.phase import Phase
from perception.building import Building
from tests.scenarios.play import Play
from tests.scenarios.scripted import EVER
from tests.scenarios.site import row

Patch = pytest.MonkeyPatch


def moves_while_it_scans(patch: Patch, play: Play) -> None:
    patch.setattr(Interlock, "free", True)


def moves_in_a_hold(patch: Patch, play: Play) -> None:
    patch.setattr(executive, "DRIVING", frozenset(Phase))
    play.each_tick = lambda play, ticks: setattr(play.floor, "free", 0.0 if 8 <= ticks < 14 else 100.0)


def moves_with_the_red_button_pressed(patch: Patch, play: Play) -> None:
    patch.setattr(safety.HoldForEmergencyStop, "trouble", lambda self, base: None)
    play.each_tick = lambda play, ticks: setattr(play.base, "emergency_stop", 12 <= ticks < 14)


def skips_a_beat(patch: Patch, play: Play) -> None:
    beat = play.base.beat
    play.executive._services.base.beat = lambda tick, may_move: None if tick == 5 else beat(tick, may_move)


def takes_a_scan_twice(patch: Patch, play: Play) -> None:
    start = TakeScan.start

    def twice(self: TakeScan) -> object:
        job = start(self)
        self.services.scanner.take("S01", ScanSettings(0.1), self.read("base").odom_from_base)
        return job

    patch.setattr(TakeScan, "start", twice)


def leaves_a_job_behind(patch: Patch, play: Play) -> None:
    patch.setattr(TakeScan, "terminate", lambda self, status: self.services.interlock.release(self.name))
    play.abort_at = 3


def does_not_stop_the_base(patch: Patch, play: Play) -> None:
    patch.setattr(type(play.executive), "_stand_still", lambda self: None)
    patch.setattr(safety.EndMission, "start", lambda self: _Done())


def places_a_scan_that_never_came_home(patch: Patch, play: Play) -> None:
    patch.setattr(FetchScan, "start", lambda self: _Done())
    patch.setattr(FetchScan, "finish", lambda self, value: executive.Status.SUCCESS)


def gives_up_without_a_reason(patch: Patch, play: Play) -> None:
    end_room = Building.end_room
    patch.setattr(Building, "end_room", lambda self, room, status, reason: end_room(self, room, status, ""))
    patch.setattr(GiveUpRoom, "say", lambda self, words: None)
    play.script.fail("segment_room", "PERC_DIED", EVER)


def forgets_a_scan_it_placed(patch: Patch, play: Play) -> None:
    patch.setattr(Survey, "with_scan", lambda self, scan: replace(self, scans=(scan,), track=(scan.base_pose,)))


def leaves_a_job_without_an_end_in_the_ledger(patch: Patch, play: Play) -> None:
    end = Ledger.end
    patch.setattr(Ledger, "end", lambda self, seq, *rest: None if seq == 4 else end(self, seq, *rest))


class _Done:
    def poll(self) -> Done[str]:
        return Done("S01.scan")

    def cancel(self) -> None:
        """There is nothing to cancel."""


BREACHES = [
    moves_while_it_scans, moves_in_a_hold, moves_with_the_red_button_pressed, skips_a_beat, takes_a_scan_twice,
    leaves_a_job_behind, does_not_stop_the_base, places_a_scan_that_never_came_home, gives_up_without_a_reason,
    forgets_a_scan_it_placed, leaves_a_job_without_an_end_in_the_ledger,
]  # fmt: skip


@pytest.mark.parametrize("breach", BREACHES, ids=lambda breach: breach.__name__)
def test_no_mission_that_breaks_a_promise_passes_for_a_good_one(
    breach: Callable[[Patch, Play], None], monkeypatch: Patch
) -> None:
    play = Play(row(1))
    breach(monkeypatch, play)
    with pytest.raises(AssertionError):
        play.run()


def test_a_mission_that_keeps_them_all_passes() -> None:
    Play(row(1)).run()
