"""Recover: try, recover, try again, a bounded number of times."""

import pytest
from py_trees.behaviours import StatusQueue
from py_trees.common import Status

from behaviours.keys import Key
from behaviours.recover import Recover
from perception.failure import Failure
from tests.behaviours.bench import get, put, tick

S, F, R = Status.SUCCESS, Status.FAILURE, Status.RUNNING


class Counted(StatusQueue):
    """Answers from a list, and counts how often it was begun and interrupted."""

    def __init__(self, *answers: Status, failure: str | None = None) -> None:
        super().__init__("scripted", list(answers), eventually=None)
        self.begun = self.interrupted = 0
        self.failure = failure

    def initialise(self) -> None:
        self.begun += 1

    def update(self) -> Status:
        status = super().update()
        if status == F and self.failure is not None:
            put(FAILURE=Failure(self.failure, "scripted"))
        return status

    def terminate(self, new_status: Status) -> None:
        self.interrupted += self.status == R and new_status == Status.INVALID


def ticked_to_the_end(node: Recover, limit: int = 20) -> Status:
    for _ in range(limit):
        if tick(node) != R:
            return node.status
    raise AssertionError("it does not end")


@pytest.mark.parametrize("attempts", [1, 2, 3, 5])
def test_the_recovery_runs_between_attempts_and_never_after_the_last(attempts: int) -> None:
    primary, recovery = Counted(F), Counted(S)
    assert ticked_to_the_end(Recover("r", primary, recovery, attempts)) == F
    assert (primary.begun, recovery.begun) == (attempts, attempts - 1)


def test_success_at_once_needs_no_recovery() -> None:
    primary, recovery = Counted(S), Counted(S)
    assert tick(Recover("r", primary, recovery, 3)) == S
    assert (primary.begun, recovery.begun) == (1, 0)


def test_success_after_a_recovery_is_success() -> None:
    primary, recovery = Counted(F, F, S), Counted(S)
    assert ticked_to_the_end(Recover("r", primary, recovery, 5)) == S
    assert (primary.begun, recovery.begun) == (3, 2)


def test_a_recovery_that_fails_ends_it() -> None:
    primary, recovery = Counted(F), Counted(F)
    assert ticked_to_the_end(Recover("r", primary, recovery, 5)) == F
    assert (primary.begun, recovery.begun) == (1, 1)


def test_a_recovery_that_fails_does_not_hide_the_failure_it_was_for() -> None:
    recover = Recover("r", Counted(F, failure="REG_DEGENERATE"), Counted(F, failure="NAV_BLOCKED"), 2)
    assert ticked_to_the_end(recover) == F
    assert get(Key.FAILURE).code == "REG_DEGENERATE"


def test_the_failure_of_the_last_attempt_is_the_one_that_stands() -> None:
    recover = Recover("r", Counted(F, failure="NAV_BLOCKED"), Counted(S), 2)
    put(FAILURE=Failure("OLD", "of another leaf"))
    assert ticked_to_the_end(recover) == F
    assert get(Key.FAILURE).code == "NAV_BLOCKED"


def test_it_goes_on_where_it_was_at_the_next_tick() -> None:
    primary, recovery = Counted(R, R, F, R, S), Counted(R, R, S)
    recover = Recover("r", primary, recovery, 2)
    assert [tick(recover) for _ in range(8)] == [R] * 7 + [S]
    assert (primary.begun, recovery.begun) == (2, 1)


def test_attempts_count_anew_when_it_is_entered_again() -> None:
    primary, recovery = Counted(F), Counted(S)
    recover = Recover("r", primary, recovery, 2)
    for _ in range(3):
        assert ticked_to_the_end(recover) == F
    assert (primary.begun, recovery.begun) == (6, 3)


def test_attempts_count_anew_after_an_interruption() -> None:
    primary, recovery = Counted(F), Counted(S)
    recover = Recover("r", primary, recovery, 2)
    tick(recover)
    tick(recover)
    recover.stop(Status.INVALID)
    assert ticked_to_the_end(recover) == F
    assert (primary.begun, recovery.begun) == (1 + 2, 1 + 1)


@pytest.mark.parametrize(("answers", "ticks", "running"), [((R,), 1, "primary"), ((F,), 2, "recovery")])
def test_an_interruption_reaches_the_child_that_runs(answers: tuple[Status, ...], ticks: int, running: str) -> None:
    recover = Recover("r", Counted(*answers), Counted(R), 3)
    for _ in range(ticks):
        assert tick(recover) == R
    recover.stop(Status.INVALID)
    assert getattr(recover, running).interrupted == 1
    assert {node.status for node in recover.iterate()} == {Status.INVALID}


def test_it_tells_which_attempt_it_is_at() -> None:
    recover = Recover("r", Counted(F, R), Counted(S), 3)
    for _ in range(3):
        tick(recover)
    assert recover.feedback_message == "attempt 2 of 3"


def test_less_than_one_attempt_makes_no_sense() -> None:
    with pytest.raises(ValueError, match="at least 1, found 0"):
        Recover("r", Counted(S), Counted(S), 0)
