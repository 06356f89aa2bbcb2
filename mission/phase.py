"""What a mission is doing, in one word: one state machine that the display, the journal and every reply show alike."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum

from perception.failure import Failure


class Phase(StrEnum):
    """The ten words; see ``docs/operations.md`` for what an operator may do in each."""

    PREFLIGHT = "preflight"
    RUNNING = "running"
    PAUSED = "paused"
    HOLD = "hold"
    ASKING = "asking"
    RETURNING = "returning"
    DONE = "done"
    INCOMPLETE = "incomplete"
    ABORTED = "aborted"
    FAULT = "fault"


ENDED = frozenset({Phase.DONE, Phase.INCOMPLETE, Phase.ABORTED, Phase.FAULT})
UNDER_WAY = frozenset({Phase.RUNNING, Phase.PAUSED, Phase.HOLD, Phase.ASKING, Phase.RETURNING})
DRIVING = frozenset({Phase.RUNNING, Phase.RETURNING})
"""The only phases in which the base may move."""

TRANSITIONS: Mapping[Phase, frozenset[Phase]] = {
    # Nothing is finished before it began, or while the robot must stand still: what ends there is no success.
    **dict.fromkeys((Phase.PREFLIGHT, Phase.PAUSED, Phase.HOLD), UNDER_WAY | {Phase.ABORTED, Phase.FAULT}),
    **dict.fromkeys((Phase.RUNNING, Phase.ASKING, Phase.RETURNING), UNDER_WAY | ENDED),
    **dict.fromkeys(ENDED, frozenset[Phase]()),
}
"""Where each phase may lead; to itself only with another reason, such as the next hold or the next question."""

_ENDS: Mapping[str, Phase] = {
    "complete": Phase.DONE,
    "incomplete": Phase.INCOMPLETE,
    "aborted": Phase.ABORTED,
    "safety_stop": Phase.ABORTED,
    "fault": Phase.FAULT,
}


NOTHING = Failure("", "")


class IllegalTransitionError(Exception):
    """A phase was to follow that cannot."""


@dataclass(frozen=True)
class State:
    """A phase, with the code of what holds or ended the mission and words for the operator where there are any."""

    phase: Phase
    code: str = ""
    message: str = ""

    def __str__(self) -> str:
        word = f"{self.phase.upper()}({self.code})" if self.code else self.phase.upper()
        return f"{word}: {self.message}" if self.message else word

    @classmethod
    def at_the_end(cls, outcome: str, cause: Failure = NOTHING) -> "State":
        """The phase that an outcome of the executive ends in, and what went wrong where something did: what ended it in
        a fault, or what kept the robot from home.
        """
        return cls(_ENDS[outcome], "SAFETY_STOP" if outcome == "safety_stop" else cause.code, cause.message)


def under_way(hold: State | None, pause: State | None, question: str | None, returning: bool) -> State:
    """The phase of a mission that has not ended; what keeps the robot from moving is named before what it does."""
    if hold is not None:
        return hold
    if pause is not None:
        return pause
    if question is not None:
        return State(Phase.ASKING, message=question)
    return State(Phase.RETURNING if returning else Phase.RUNNING)


class Course:
    """The phases of one mission in their order.

    Args:
        tell: called with each change, before and after; writes the journal's row.
    """

    def __init__(self, tell: Callable[[State, State], None] = lambda _before, _after: None) -> None:
        self.state = State(Phase.PREFLIGHT)
        self._tell = tell

    @property
    def ended(self) -> bool:
        return self.state.phase in ENDED

    def enter(self, state: State) -> bool:
        """Be in a state from now on; whether that is a change.

        Raises:
            IllegalTransitionError: where :data:`TRANSITIONS` does not lead there.
        """
        before = self.state
        if state == before:
            return False
        if state.phase not in TRANSITIONS[before.phase]:
            raise IllegalTransitionError(f"a mission that is {before} cannot become {state}")
        self.state = state
        self._tell(before, state)
        return True
