"""The tick loop: 10 Hz, guarded, and on every way out the leaves are stopped and the base stands still."""

import logging
from collections.abc import Callable, Iterator
from functools import partial

from py_trees.behaviour import Behaviour
from py_trees.blackboard import Blackboard
from py_trees.common import Status

from behaviours.keys import Key
from behaviours.services import Services
from behaviours.survey import Survey
from drivers.jobs import Running

log = logging.getLogger("mission")

TICK = 0.1
"""Seconds of the wall from one tick to the next."""

_STOP_PATIENCE = 50
"""Ticks that the base is given to confirm that it stands still when the mission ends."""


class Executive:
    """Ticks a mission's tree until it has an outcome.

    Args:
        root: the tree, not yet set up.
        services: what its leaves are handed.
        sleep: waits so many seconds; a scripted clock in tests.
        command: what the operator wants now, ``run`` or ``abort``.
        after_tick: called after each tick with the number of ticks so far.
    """

    def __init__(
        self,
        root: Behaviour,
        services: Services,
        sleep: Callable[[float], None],
        command: Callable[[], str] = lambda: "run",
        after_tick: Callable[[int], None] = lambda _: None,
    ) -> None:
        self.root = root
        self._services = services
        self._sleep = sleep
        self._command = command
        self._after_tick = after_tick
        self._paths = dict(_named_paths(root))
        self._shown: dict[Behaviour, Status] = {}
        self.changed = False
        """Whether the last tick changed the survey."""

    def run(self) -> str:
        """Tick to the end; the outcome is ``complete``, ``incomplete``, ``aborted``, ``safety_stop`` or ``fault``."""
        _wipe_blackboard()
        outcome = "fault"
        try:
            for node in self.root.iterate():
                node.setup(services=self._services)
            outcome = self._tick_to_the_end()
        except Exception as error:
            log.exception("the tick failed")
            note = {"leaf": "tick", "code": "TICK_EXCEPTION", "message": repr(error)}
            _attempt(lambda: self._services.journal.record("failure", **note))
        finally:
            self._come_to_rest()
        return outcome

    @property
    def survey(self) -> Survey:
        survey = Blackboard.get(Key.SURVEY)
        assert isinstance(survey, Survey)
        return survey

    def _tick_to_the_end(self) -> str:
        ticks = 0
        while True:
            Blackboard.set(Key.COMMAND, self._command())
            before = self.survey
            self.root.tick_once()
            ticks += 1
            self.changed = self.survey is not before
            self._record_transitions()
            self._after_tick(ticks)
            ended = Blackboard.get(Key.OUTCOME) if Blackboard.exists(Key.OUTCOME) else None
            if ended is not None:
                return verdict(self.survey) if ended == "finished" else str(ended)
            if self.root.status != Status.RUNNING:
                return "fault"
            self._sleep(TICK)

    def _record_transitions(self) -> None:
        """One event for each node whose status is another than after the tick before."""
        for node, path in self._paths.items():
            before = self._shown.get(node, Status.INVALID)
            if node.status != before:
                self._services.journal.record(
                    "node",
                    node=node.name,
                    path=path,
                    before=before.value,
                    after=node.status.value,
                    feedback=node.feedback_message,
                )
                self._shown[node] = node.status

    def _come_to_rest(self) -> None:
        """Stop every node and the base, whichever of them, or the journal, is what failed."""
        for node in self.root.iterate():
            # Each by itself: after an exception in mid-tick a parent may not know that its child runs.
            _attempt(partial(node.stop, Status.INVALID))
        _attempt(self._stand_still)
        _attempt(self._record_transitions)

    def _stand_still(self) -> None:
        stop = self._services.base.stop()
        for _ in range(_STOP_PATIENCE):
            if not isinstance(stop.poll(), Running):
                break
            self._sleep(TICK)


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


def _attempt(act: Callable[[], object]) -> None:
    try:
        act()
    except Exception:
        log.exception("on the way out")


def _named_paths(node: Behaviour, above: str = "") -> Iterator[tuple[Behaviour, str]]:
    path = f"{above}/{node.name}"
    yield node, path
    for child in node.children:
        yield from _named_paths(child, path)
