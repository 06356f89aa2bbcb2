"""The executive dies at every instant that matters, and the mission that is resumed is the one that never died."""

from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest
from py_trees.common import Status

from behaviours.mapping import RegisterGlobally
from behaviours.services import Services
from behaviours.settings import Settings
from drivers.interfaces import BaseState
from mission.chronicle import Chronicle
from mission.clock import MissionClock
from mission.journal import DurableJournal, read_events
from mission.ledger import Ledger
from mission.operator import Word
from perception.failure import Failure, FailureError
from perception.grids import Grid
from tests.scenarios import saga as saga_of
from tests.scenarios.saga import Saga
from tests.scenarios.scripted import HANG, FreeFloor
from tests.scenarios.site import row


def rooms(folder: Path, count: int = 2) -> Saga:
    folder.mkdir(parents=True, exist_ok=True)
    return Saga(folder, row(count))


def test_killed_before_or_after_any_write_and_resumed_it_is_the_mission_that_nobody_killed(tmp_path: Path) -> None:
    whole = rooms(tmp_path / "whole")
    assert whole.live() == "complete"
    assert whole.writes > 80
    for instant in range(1, whole.writes + 1):
        saga = rooms(tmp_path / str(instant))
        assert saga.live(instant, after=instant % 2 == 0) == "killed"
        assert saga.live() == "complete", instant
        assert saga.result == whole.result, instant


def test_killed_again_and_again_it_still_comes_to_the_same_end(tmp_path: Path) -> None:
    whole, saga = rooms(tmp_path / "whole"), rooms(tmp_path / "saga")
    assert whole.live() == "complete"
    lives = 1
    while (end := saga.live(dies_at=3, after=lives % 2 == 0)) == "killed":
        lives += 1
    assert (end, lives > 20) == ("complete", True)
    assert saga.result == whole.result


def test_the_ladders_of_the_first_life_are_not_climbed_again(tmp_path: Path) -> None:
    def troubled(folder: Path) -> Saga:
        saga = rooms(folder)
        saga.script.fail("take", "SCAN_FAILED", range(2, 4)).fail("register_scan", "REG_DEGENERATE", range(3, 4))
        return saga

    whole = troubled(tmp_path / "whole")
    assert whole.live() == "complete"
    for instant in range(1, whole.writes + 1, 6):
        saga = troubled(tmp_path / str(instant))
        assert saga.live(instant, after=True) == "killed"
        assert saga.live() == "complete"
        assert saga.result == whole.result, instant


def test_nothing_moves_and_nothing_is_scanned_before_the_operator_says_so(tmp_path: Path) -> None:
    saga = rooms(tmp_path)
    assert saga.live(dies_at=40) == "killed"
    goals, scans = len(saga.base.goals), len(saga.scanner.taken)
    seen = []

    def watch(word: Word, ticks: int) -> None:
        seen.append((len(saga.base.goals), len(saga.scanner.taken), word()))
        if ticks < 10:
            word.pause()
        else:
            word.resume()

    assert saga.live(each_tick=watch) == "complete"
    assert {(g, s) for g, s, word in seen[:9]} == {(goals, scans)}
    assert all(not may_move for _, may_move in saga.base.beats[-len(seen) :][:9])


def test_what_was_told_is_not_journalled_again(tmp_path: Path) -> None:
    saga = rooms(tmp_path)
    assert saga.live(dies_at=60) == "killed"
    assert saga.live() == "complete"
    registered = [event["scan_id"] for event in read_events(tmp_path / "events.jsonl") if event["kind"] == "registered"]
    assert len(registered) == len(set(registered)) == len(saga.scanner.taken)


@pytest.mark.parametrize("first", range(4))
def test_an_aborted_mission_is_taken_up_where_it_was_left(tmp_path: Path, first: int) -> None:
    """Whatever it was about, and also when the one that took it up is killed: what it did since is told the next."""
    whole = rooms(tmp_path / "whole")
    assert whole.live() == "complete"
    for instant in range(5 + 2 * first, 62, 8):
        saga = rooms(tmp_path / str(instant))

        def abort(word: Word, ticks: int, at: int = instant) -> None:
            if ticks == at:
                word.abort()

        assert saga.live(each_tick=abort) == "aborted"
        assert saga.live(dies_at=4) == "killed"
        assert saga.live() == "complete"
        assert list(saga.scanner.taken) == sorted(set(saga.scanner.taken)) == list(whole.scanner.taken)


def test_another_tree_than_the_one_that_began_is_refused(tmp_path: Path) -> None:
    saga = rooms(tmp_path)
    assert saga.live(dies_at=60) == "killed"
    saga.perception.seen = [9000, 9200]
    ledger = Ledger(tmp_path / "mission.db")
    chronicle = Chronicle(ledger, MissionClock())
    with pytest.raises(FailureError, match="RESUME_DIVERGED"):
        chronicle.begin("drive", "G999", lambda: pytest.fail("it acted"))
    ledger.close()


def test_how_far_a_drive_came_that_was_given_up_each_life_knows(tmp_path: Path) -> None:
    saga = rooms(tmp_path)

    def abort(word: Word, ticks: int) -> None:
        if any(job.what == "drive" and not job.over for job in saga.script.jobs):
            word.abort()

    assert saga.live(each_tick=abort) == "aborted"
    saga.base.push(0.8)  # so far it had come
    driven = []
    for dies_at in (10, None):
        saga.live(dies_at=dies_at)
        broken_off = next(event for event in read_events(tmp_path / "events.jsonl") if event["kind"] == "drive")
        driven.append((broken_off["result"], round(broken_off["distance"], 6), saga.survey.track[1:2]))
    assert driven[0][:2] == ("NAV_INTERRUPTED", 0.8)
    assert driven[0] == driven[1]


def test_a_hold_between_two_drives_is_told_as_it_was_lived(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """It lasts longer than a drive may, just where the next drive is about to be ordered."""
    saga = rooms(tmp_path)
    saga.script.fail("register_scan", "REG_DEGENERATE").fail("register_globally", "REG_DEGENERATE")
    fail, held = RegisterGlobally.fail, [1000]

    def hold(leaf: RegisterGlobally, why: Failure) -> Status:
        saga.base.battery = 0.05
        return fail(leaf, why)

    def each_tick(word: Word, ticks: int) -> None:
        if saga.base.battery < 0.1:
            held[0] -= 10
            saga.base.battery = 0.05 if held[0] > 0 else 0.9

    monkeypatch.setattr(RegisterGlobally, "fail", hold)
    assert saga.live(each_tick=each_tick) == "complete"
    monkeypatch.undo()
    saga.base.battery = 0.9
    before = saga.result
    assert saga.live() == "complete"
    assert saga.result == before


def test_the_telling_of_a_drive_that_timed_out_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """In life it took a moment to read the robot map, which the deadline was just exceeded by."""
    settings = Settings()
    settings = replace(settings, driving=replace(settings.driving, timeout_s=908.01))
    saga = Saga(tmp_path, row(2), settings=settings)
    saga.script.fail("drive", "AGENT_UNREACHABLE").answer("drive", HANG, (2,))

    class SlowFloor(FreeFloor):
        def robot_map(self, map_id: str) -> Grid:
            saga.script.clock.sleep(0.02)
            return super().robot_map(map_id)

    monkeypatch.setattr(saga_of, "FreeFloor", SlowFloor)
    outcome = saga.live()
    before = saga.result
    with closing(Ledger(tmp_path / "mission.db")) as ledger:
        assert [job.kind for job in ledger.jobs() if job.how == "cancelled"] == ["drive"]
    assert saga.live() == outcome
    assert saga.result == before


class Owning(Saga):
    """A mission that has the lease under a name, as real ones have."""

    def _services(self, clock: MissionClock, journal: DurableJournal) -> Services:
        return replace(super()._services(clock, journal), owner="this mission")


def test_a_telling_that_outlasts_the_lease_is_no_divergence(tmp_path: Path) -> None:
    """Nobody beats while a mission is told, so a base may think its owner dead before that is over."""
    saga = Owning(tmp_path, row(2))
    saga.base.owner = "this mission"
    assert saga.live(dies_at=60) == "killed"
    state, asked = saga.base.state, []

    def forgetful() -> BaseState | None:
        asked.append(saga.base.owner)
        if len(asked) == 20:
            saga.base.owner = ""
        return state()

    saga.base.state = forgetful  # type: ignore[method-assign]
    assert saga.live() == "complete"
    assert "" in asked
