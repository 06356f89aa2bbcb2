"""Plays the real tree and the real executive with scripted drivers, and checks what must hold however it ends."""

import json
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from py_trees.behaviour import Behaviour

from behaviours.services import Clock, Services
from behaviours.settings import Settings
from behaviours.survey import Survey
from mission.chronicle import Chronicle
from mission.clock import MissionClock
from mission.executive import TICK, Executive
from mission.journal import plain
from mission.ledger import Ledger
from mission.operator import Desk, Word
from mission.phase import Course
from mission.remembering import remembering
from mission.run import record_phase
from perception.building import Room
from tests.scenarios.monitor import Monitor
from tests.scenarios.scripted import FreeFloor, Script, ScriptedBase, ScriptedPerception, ScriptedScanner
from tests.scenarios.site import Site
from trees.building import create_root

TICK_S = 10.0
"""Mission seconds from tick to tick: nothing a script does is quicker."""

OWNER = "this mission"

_IN_MEMORY = Path(":memory:")


class Events(list[dict[str, Any]]):
    """A journal in memory; every figure must have a place in the event log."""

    def __init__(self, clock: Clock) -> None:
        super().__init__()
        self._clock = clock

    def record(self, kind: str, /, **figures: object) -> None:
        self.append(json.loads(json.dumps({"t": self._clock.now(), "kind": kind, **figures}, default=plain)))

    def of(self, kind: str) -> list[dict[str, Any]]:
        return [event for event in self if event["kind"] == kind]

    @property
    def codes(self) -> list[str]:
        """Codes of all failures in their order."""
        return [event["code"] for event in self.of("failure")]


@dataclass
class Play:
    """A mission to be played: change its parts, then :meth:`run` it once.

    Args:
        attended: whether an operator is there to answer, at ``desk``; else every default is taken at once.
        each_tick: called after each tick with the play and the number of ticks so far; the place for what happens
            to the building, to the robot, or to the operator's mind while the mission runs.
    """

    site: Site
    script: Script = field(default_factory=Script)
    settings: Settings = field(default_factory=Settings)
    each_tick: Callable[["Play", int], None] = lambda _play, _ticks: None
    abort_at: int | None = None
    most_ticks: int = 3000
    attended: bool = False
    root: Behaviour = field(init=False)
    ticks: int = 0

    def __post_init__(self) -> None:
        self.clock = MissionClock(source=self.script.clock.now, wait=self._wait)
        self.events = Events(self.clock)
        self.word = Word()
        self.desk = Desk(self.clock, self.events, self.attended)
        self.base = ScriptedBase(self.site, self.script, OWNER)
        self.scanner = ScriptedScanner(self.base, self.script)
        self.perception = ScriptedPerception(self.site, self.scanner, self.script)
        self.floor = FreeFloor()
        self.root = create_root(self.settings)
        self.monitor = Monitor(self.most_ticks)
        self.ledger = Ledger(_IN_MEMORY)
        services = Services(
            self.scanner, self.base, self.perception, self.clock, self.events, self.floor, self.settings, self.desk,
            owner=OWNER,
        )  # fmt: skip
        self.course = Course(lambda before, after: record_phase(self.events, before, after))
        self.executive = Executive(
            self.root,
            remembering(self.monitor.watch(services), Chronicle(self.ledger, self.clock)),
            self.clock,
            self.monitor.hearing(self._command),
            self._after_tick,
            self.course,
            "resume goes on",
        )
        self.monitor.executive = self.executive

    def run(self) -> str:
        outcome = self.executive.run()
        self.assert_at_rest()
        return outcome

    @property
    def phases(self) -> list[str]:
        """Every phase in its order, a hold with its code."""
        return [f"{row['after']}({row['code']})" if row["code"] else row["after"] for row in self.events.of("phase")]

    @property
    def survey(self) -> Survey:
        return self.executive.survey

    @property
    def calls(self) -> dict[str, int]:
        return self.script.calls

    @property
    def rooms(self) -> dict[str, tuple[str, str]]:
        """Status and reason of each room by its name on the site."""
        return {self.name_of(room): (room.status, room.reason) for room in self.survey.building.rooms}

    @property
    def doors(self) -> list[str]:
        return [edge.state for edge in self.survey.building.doors]

    def name_of(self, room: Room) -> str:
        return self.site.room_at(*room.seed)

    def scans_of(self, name: str) -> int:
        return sum(
            len(self.survey.room_scans(room.id)) for room in self.survey.building.rooms if self.name_of(room) == name
        )

    def assert_at_rest(self) -> None:
        """What holds on every way out; in one life nothing is logged twice."""
        self.monitor.assert_at_rest(self.ledger.jobs())
        registered = self.monitor.registered
        assert len(registered) == len(set(registered)), "the log tells of a scan twice"

    def _wait(self, seconds: float) -> None:
        self.script.clock.sleep(seconds * TICK_S / TICK)

    def _command(self) -> str:
        return "abort" if self.abort_at is not None and self.ticks + 1 >= self.abort_at else self.word()

    def _after_tick(self, ticks: int) -> None:
        self.ticks = ticks
        self.monitor.ticked(ticks)
        self.each_tick(self, ticks)


def with_driving(**values: object) -> Settings:
    """Settings that differ in how the base is driven."""
    settings = Settings()
    return replace(settings, driving=replace(settings.driving, **values))
