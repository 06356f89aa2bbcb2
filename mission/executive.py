"""The tick loop: 10 Hz, guarded, and on every way out the leaves are stopped and the base stands still."""

import logging
import time
from array import array
from collections.abc import Callable, Iterator
from functools import partial
from typing import Protocol

from py_trees.behaviour import Behaviour
from py_trees.blackboard import Blackboard
from py_trees.common import Status

from behaviours.keys import Key
from behaviours.services import Services
from behaviours.survey import Survey, Target
from drivers.jobs import Running
from mission.attempt import attempt
from mission.phase import DRIVING, NOTHING, Course, Phase, State, under_way
from perception.failure import Failure, FailureError

log = logging.getLogger("mission")

TICK = 0.1
"""Seconds of the wall from one tick to the next."""

_ON_THE_WAY_OUT = "on the way out"
_STOP_PATIENCE = 50
"""Ticks that the base is given to confirm that it stands still when the mission ends."""


class TickClock(Protocol):
    """Waits from tick to tick, and holds the mission's time in a pause."""

    def sleep(self, seconds: float) -> None:
        """Wait until so many seconds after the last wait was over, if that is still to come."""
        ...

    def stand_still(self, still: bool) -> None: ...


class Executive:
    """Ticks a mission's tree until it has an outcome.

    Args:
        root: the tree, not yet set up.
        services: what its leaves are handed.
        clock: waits so many seconds of the wall; scripted in tests.
        command: what the operator wants now, ``run``, ``pause`` or ``abort``.
        after_tick: called after each tick with the number of ticks so far.
        course: keeps the mission's phases.
        way_on: told while it is paused: how to go on.
        recall: handed the tree's tick before the first live one; ticks it through what a resumed mission did before.
    """

    def __init__(
        self,
        root: Behaviour,
        services: Services,
        clock: TickClock,
        command: Callable[[], str] = lambda: "run",
        after_tick: Callable[[int], None] = lambda _: None,
        course: Course | None = None,
        way_on: str = "",
        recall: Callable[[Callable[[], None]], None] = lambda _tick: None,
    ) -> None:
        self.root = root
        self.course = course or Course()
        self._services = services
        self._clock = clock
        self._command = command
        self._after_tick = after_tick
        self._pause = State(Phase.PAUSED, message=way_on)
        self._recall = recall
        self._paths = list(_named_paths(root))
        self._shown = [Status.INVALID] * len(self._paths)
        self.durations = array("d")
        """Seconds of the wall that each tick took, all that is called from it included."""
        self._worked = array("d")
        self.changed = False
        """Whether the last tick changed the survey or the phase."""

    def run(self) -> str:
        """Tick to the end; the outcome is ``complete``, ``incomplete``, ``aborted``, ``safety_stop`` or ``fault``."""
        _wipe_blackboard()
        outcome, cause = "fault", NOTHING
        try:
            for node in self.root.iterate():
                node.setup(services=self._services)
            outcome = self._tick_to_the_end()
            cause = self.survey.stranded or NOTHING
        except Exception as error:
            cause = self._note(error)
        except KeyboardInterrupt as error:
            cause = self._note(error)
            raise
        finally:
            self._come_to_rest()
            attempt(_ON_THE_WAY_OUT, lambda: self.course.enter(State.at_the_end(outcome, cause)))
        return outcome

    @property
    def survey(self) -> Survey:
        survey = Blackboard.get(Key.SURVEY)
        assert isinstance(survey, Survey)
        return survey

    def tick_ms(self) -> dict[str, float]:
        """Milliseconds that a tick took: median, 99th percentile and longest of the wall, and the thread's own work."""
        found = {"p50": _quantile(self.durations, 0.5), "p99": _quantile(self.durations, 0.99)}
        found |= {"max": _quantile(self.durations, 1.0), "work_p99": _quantile(self._worked, 0.99)}
        return {name: round(1000 * seconds, 2) for name, seconds in found.items()}

    def _note(self, error: BaseException) -> Failure:
        """Put on record what the tick could not survive: a failure that has a name, or an error of the program."""
        if isinstance(error, FailureError):
            log.error("the tick failed: %s", error)
            cause = error.failure
        else:
            log.error("the tick failed", exc_info=error)
            cause = Failure("TICK_EXCEPTION", repr(error))
        note = {"leaf": "tick", "code": cause.code, "message": cause.message}
        attempt(_ON_THE_WAY_OUT, lambda: self._services.journal.record("failure", **note))
        return cause

    def _tick_to_the_end(self) -> str:
        Blackboard.set(Key.COMMAND, "run")
        self._recall(self.root.tick_once)
        self.course.enter(State(Phase.RUNNING))
        while True:
            began, at_work = time.perf_counter(), time.thread_time()
            ended = self._tick()
            self._after_tick(len(self.durations) + 1)
            self.durations.append(time.perf_counter() - began)
            self._worked.append(time.thread_time() - at_work)
            if ended is not None:
                return verdict(self.survey) if ended == "finished" else ended
            if self.root.status != Status.RUNNING:
                return "fault"
            self._clock.sleep(TICK)

    def _tick(self) -> str | None:
        """One tick of the tree, and the beat that lets the base move until the next; how the mission ended, if so."""
        command = self._command()
        Blackboard.set(Key.COMMAND, command)
        before = self.survey
        self.root.tick_once()
        # Whatever is aborted keeps its phase until it has ended.
        moved_on = command != "abort" and self.course.enter(self._state(command))
        state = self.course.state
        self._clock.stand_still(command == "pause" and state.phase is Phase.PAUSED)
        lets_drive = self._services.interlock.lets_drive(self._services.clock.now())
        may_move = command == "run" and state.phase in DRIVING and lets_drive
        self._services.base.beat(len(self.durations) + 1, may_move)
        self.changed = moved_on or self.survey is not before
        self._record_transitions()
        ended = _on_blackboard(Key.OUTCOME)
        return None if ended is None else str(ended)

    def _state(self, command: str) -> State:
        """The phase as the blackboard tells it after a tick."""
        hold, question, target = (_on_blackboard(key) for key in (Key.HOLD, Key.QUESTION, Key.TARGET))
        held = State(Phase.HOLD, hold.code, hold.message) if isinstance(hold, Failure) else None
        paused = self._pause if command == "pause" else None
        asked = None if question is None else str(question)
        return under_way(held, paused, asked, isinstance(target, Target) and target.purpose == "start")

    def _record_transitions(self) -> None:
        """One event for each node whose status is another than after the tick before."""
        for place, (node, path) in enumerate(self._paths):
            before = self._shown[place]
            if node.status is not before:
                self._services.journal.record(
                    "node",
                    node=node.name,
                    path=path,
                    before=before.value,
                    after=node.status.value,
                    feedback=node.feedback_message,
                )
                self._shown[place] = node.status

    def _come_to_rest(self) -> None:
        """Stop every node and the base, whichever of them, or the journal, is what failed."""
        for node in self.root.iterate():
            # Each by itself: after an exception in mid-tick a parent may not know that its child runs.
            attempt(_ON_THE_WAY_OUT, partial(node.stop, Status.INVALID))
        attempt(_ON_THE_WAY_OUT, self._stand_still)
        attempt(_ON_THE_WAY_OUT, self._record_transitions)

    def _stand_still(self) -> None:
        stop = self._services.base.stop()
        for _ in range(_STOP_PATIENCE):
            if not isinstance(stop.poll(), Running):
                break
            self._clock.sleep(TICK)


def verdict(survey: Survey) -> str:
    """``complete`` when every room is, and no door was left that could not be passed."""
    building = survey.building
    rooms_done = bool(building.rooms) and all(room.status == "complete" for room in building.rooms)
    return "complete" if rooms_done and not building.unfinished_doors() else "incomplete"


def active_branch(root: Behaviour) -> list[Behaviour]:
    """The running nodes from the root to its running leaf."""
    branch = []
    node: Behaviour | None = root
    while node is not None and node.status == Status.RUNNING:
        branch.append(node)
        node = next((child for child in node.children if child.status == Status.RUNNING), None)
    return branch


def _wipe_blackboard() -> None:
    """It is global to the process: nothing of an earlier mission may be taken for this one's."""
    for key in Key:
        Blackboard.unset(key)
    Blackboard.set(Key.SURVEY, Survey())


def _quantile(values: "array[float]", share: float) -> float:
    ordered = sorted(values)
    return ordered[min(int(share * len(ordered)), len(ordered) - 1)] if ordered else 0.0


def _on_blackboard(key: Key) -> object:
    return Blackboard.get(key) if Blackboard.exists(key) else None


def _named_paths(node: Behaviour, above: str = "") -> Iterator[tuple[Behaviour, str]]:
    path = f"{above}/{node.name}"
    yield node, path
    for child in node.children:
        yield from _named_paths(child, path)
