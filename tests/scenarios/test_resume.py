"""The executive dies at every instant that matters, and the mission that is resumed is the one that never died."""

from pathlib import Path

import pytest

from mission.chronicle import Chronicle
from mission.clock import MissionClock
from mission.journal import read_events
from mission.ledger import Ledger
from mission.operator import Word
from perception.failure import FailureError
from tests.scenarios.saga import Saga
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
