"""The executive dies at every instant that matters, and the mission that is resumed is the one that never died."""

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from behaviours.services import Services
from behaviours.settings import Settings
from mission.chronicle import Chronicle
from mission.clock import MissionClock
from mission.executive import TICK, Executive
from mission.journal import DurableJournal, JsonLines, plain, read_events
from mission.ledger import Ledger
from mission.operator import Desk, Word
from mission.remembering import heeding, remembering
from mission.state import describe
from perception.failure import FailureError
from tests.scenarios.lasting import LastingBase, LastingScanner
from tests.scenarios.monitor import Monitor
from tests.scenarios.play import TICK_S
from tests.scenarios.scripted import FreeFloor, Script, ScriptedPerception
from tests.scenarios.site import Site, row
from trees.building import create_root


class Dies(BaseException):
    """Nothing catches a kill -9."""


class MortalLedger(Ledger):
    """Its process dies at its n-th durable write, just before or just after it; no word reaches anybody after that."""

    def __init__(self, path: Path, dies_at: int | None = None, after: bool = False) -> None:
        super().__init__(path)
        self.writes = 0
        self.dead = False
        self._dies_at = dies_at
        self._after = after

    def begin(self, kind: str, name: str, world: str, at: float, acts: bool = True) -> int:
        self._live_through(before=True)
        seq = super().begin(kind, name, world, at, acts)
        self._live_through(before=False)
        return seq

    def end(self, seq: int, how: str, outcome: str, at: float) -> None:
        self._live_through(before=True)
        super().end(seq, how, outcome, at)
        self._live_through(before=False)

    def _live_through(self, before: bool) -> None:
        self.writes += before
        if self.dead or (self.writes == self._dies_at and before is not self._after):
            self.dead = True
            raise Dies


class MortalExecutive(Executive):
    ledger: MortalLedger

    def _come_to_rest(self) -> None:
        if not self.ledger.dead:
            super()._come_to_rest()


@dataclass
class Saga:
    """One mission over as many lives of its executive as it takes; the agents outlive them all."""

    folder: Path
    site: Site
    script: Script = field(default_factory=Script)
    settings: Settings = field(default_factory=Settings)

    def __post_init__(self) -> None:
        self.base = LastingBase(self.site, self.script)
        self.scanner = LastingScanner(self.base, self.script)
        self.perception = ScriptedPerception(self.site, self.scanner, self.script)
        self.monitor = Monitor()

    def live(
        self, dies_at: int | None = None, after: bool = False, each_tick: Callable[[Word, int], None] | None = None
    ) -> str:
        """One life; the outcome, or ``killed``."""
        self.base.beats.clear()  # each life counts its ticks from one
        ledger = MortalLedger(self.folder / "mission.db", dies_at, after)
        clock = MissionClock(source=self.script.clock.now, wait=lambda s: self.script.clock.sleep(s * TICK_S / TICK))
        chronicle = Chronicle(ledger, clock)
        mirror = JsonLines(self.folder / "events.jsonl", clock)
        journal = DurableJournal(ledger, mirror, clock)
        word = Word()
        if chronicle.telling:
            word.pause()
        services = remembering(
            self.monitor.watch(
                Services(
                    self.scanner, self.base, self.perception, clock, journal, FreeFloor(), self.settings,
                    Desk(clock, journal, False),
                )
            ),
            chronicle,
        )  # fmt: skip

        def after_tick(ticks: int) -> None:
            journal.commit()
            self.monitor.ticked(ticks)
            if ticks == 3:
                word.resume()
            if each_tick is not None:
                each_tick(word, ticks)
            assert ticks < 3000

        root = create_root(self.settings)
        command = self.monitor.hearing(heeding(word, chronicle))
        executive = MortalExecutive(root, services, clock, command, after_tick, recall=chronicle.tell)
        executive.ledger = ledger
        self.monitor.executive = executive
        try:
            outcome = executive.run()
            self.monitor.assert_at_rest(ledger.jobs())
        except Dies:
            outcome = "killed"
            self.monitor.assert_kept()
        finally:
            self.writes = ledger.writes
            self.survey = executive.survey
            mirror.close()
            ledger.close()
        return outcome

    @property
    def result(self) -> object:
        """What must not depend on who died when: all scans with their poses, rooms, doors, goals, the map."""
        figures = describe(self.survey)
        goals = [(goal.goal_id, round(goal.x, 9), round(goal.y, 9)) for goal in self.base.goals]
        return json.loads(json.dumps([figures, goals, list(self.scanner.taken)], default=plain))


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
    while saga.live(dies_at=3, after=lives % 2 == 0) == "killed":
        lives += 1
    assert lives > 20
    assert saga.result == whole.result


def test_the_ladders_of_the_first_life_are_not_climbed_again(tmp_path: Path) -> None:
    def troubled(folder: Path) -> Saga:
        saga = rooms(folder)
        saga.script.fail("take", "SCAN_FAILED", range(2, 4)).fail("register_scan", "REG_DEGENERATE", range(3, 4))
        return saga

    whole = troubled(tmp_path / "whole")
    outcome = whole.live()
    for instant in range(1, whole.writes + 1, 6):
        saga = troubled(tmp_path / str(instant))
        saga.live(instant, after=True)
        assert saga.live() == outcome
        assert saga.result == whole.result, instant


def test_nothing_moves_and_nothing_is_scanned_before_the_operator_says_so(tmp_path: Path) -> None:
    saga = rooms(tmp_path)
    saga.live(dies_at=40)
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
    saga.live(dies_at=60)
    saga.live()
    registered = [event["scan_id"] for event in read_events(tmp_path / "events.jsonl") if event["kind"] == "registered"]
    assert len(registered) == len(set(registered)) == len(saga.scanner.taken)


def test_an_aborted_mission_is_taken_up_where_it_was_left(tmp_path: Path) -> None:
    whole = rooms(tmp_path / "whole")
    assert whole.live() == "complete"
    for instant in range(4, 60, 7):
        saga = rooms(tmp_path / str(instant))

        def abort(word: Word, ticks: int, at: int = instant) -> None:
            if ticks == at:
                word.abort()

        assert saga.live(each_tick=abort) == "aborted"
        assert saga.live() == "complete"
        assert list(saga.scanner.taken) == sorted(set(saga.scanner.taken))


def test_another_tree_than_the_one_that_began_is_refused(tmp_path: Path) -> None:
    saga = rooms(tmp_path)
    saga.live(dies_at=60)
    saga.perception.seen = [9000, 9200]
    ledger = Ledger(tmp_path / "mission.db")
    chronicle = Chronicle(ledger, MissionClock())
    with pytest.raises(FailureError, match="RESUME_DIVERGED"):
        chronicle.begin("drive", "G999", lambda: pytest.fail("it acted"))
    ledger.close()
