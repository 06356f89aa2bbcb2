"""One mission over several lives of its executive, which may die at any durable write; on the virtual clock."""

import json
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from py_trees.blackboard import Blackboard

from behaviours.services import Services
from behaviours.settings import Settings
from mission.chronicle import Chronicle
from mission.clock import MissionClock
from mission.executive import TICK, Executive
from mission.journal import DurableJournal, JsonLines, plain
from mission.ledger import Ledger
from mission.operator import Desk, Word
from mission.remembering import heeding, remembering
from mission.state import describe
from tests.scenarios.lasting import LastingBase, LastingScanner
from tests.scenarios.monitor import Monitor
from tests.scenarios.play import TICK_S
from tests.scenarios.scripted import FreeFloor, Script, ScriptedPerception
from tests.scenarios.site import Site
from trees.building import create_root

_LEAVE_AT_TICK = 3
"""When the operator of a resumed mission says that it may go on."""


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
        with self._executive(MortalLedger(self.folder / "mission.db", dies_at, after), each_tick) as executive:
            try:
                outcome = executive.run()
                self.monitor.assert_at_rest(executive.ledger.jobs())
            except Dies:
                outcome = "killed"
                self.monitor.assert_kept()
            finally:
                self.writes = executive.ledger.writes
                self.survey = executive.survey
        return outcome

    @contextmanager
    def _executive(
        self, ledger: MortalLedger, each_tick: Callable[[Word, int], None] | None
    ) -> Iterator[MortalExecutive]:
        """As ``mission run`` builds it, in a process of its own; a mission that is resumed waits for leave to go on."""
        Blackboard.clear()
        with ExitStack() as stack:
            stack.enter_context(closing(ledger))
            clock = MissionClock(source=self.script.clock.now, wait=self._wait, begin=ledger.newest_time())
            mirror = stack.enter_context(closing(JsonLines(self.folder / "events.jsonl", clock)))
            journal = DurableJournal(ledger, mirror, clock)
            chronicle = Chronicle(ledger, clock)
            word = Word()
            if chronicle.telling:
                word.pause()

            def after_tick(ticks: int) -> None:
                journal.commit()
                self.monitor.ticked(ticks)
                if ticks == _LEAVE_AT_TICK:
                    word.resume()
                if each_tick is not None:
                    each_tick(word, ticks)

            services = remembering(self.monitor.watch(self._services(clock, journal)), chronicle)
            command = self.monitor.hearing(heeding(word, chronicle))
            root = create_root(self.settings)
            executive = MortalExecutive(root, services, clock, command, after_tick, recall=chronicle.tell)
            executive.ledger = ledger
            self.monitor.executive = executive
            yield executive

    def _services(self, clock: MissionClock, journal: DurableJournal) -> Services:
        desk = Desk(clock, journal, False)
        return Services(self.scanner, self.base, self.perception, clock, journal, FreeFloor(), self.settings, desk)

    def _wait(self, seconds: float) -> None:
        self.script.clock.sleep(seconds * TICK_S / TICK)

    @property
    def result(self) -> object:
        """What must not depend on who died when: all scans with their poses, rooms, doors, goals, the map."""
        figures = describe(self.survey)
        goals = [(goal.goal_id, round(goal.x, 9), round(goal.y, 9)) for goal in self.base.goals]
        return json.loads(json.dumps([figures, goals, list(self.scanner.taken)], default=plain))
