"""The lease before and after a mission: who holds it is refused by, and who is waited for."""

import os
import time
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.interfaces import Base, Lease
from drivers.jobs import Done, Failed
from mission.ownership import myself, ownership
from perception.failure import Failure, FailureError

LEASE = Lease(1, 2, "me")


class Job:
    def __init__(self, outcome: Any) -> None:
        self.outcome = outcome

    def poll(self) -> Any:
        return self.outcome

    def cancel(self) -> None:
        """Nothing to cancel."""


def held(silent: float, free_in: float) -> Failed:
    evidence = {"owner": "ann", "silent_s": silent, "free_in_s": free_in}
    return Failed(Failure("LEASE_HELD", "the base is held by ann", evidence))


def base_that_answers(*answers: object) -> tuple[Base, list[str]]:
    said: list[str] = []
    left = list(answers)

    def acquire(owner: str) -> Job:
        said.append(owner)
        return Job(left.pop(0))

    def release() -> Job:
        said.append("release")
        return Job(Done(None))

    def state() -> Any:
        """Telemetry hears of a lease a little later than who has it."""
        asked.append(1)
        return None if len(asked) == 1 else SimpleNamespace(owner="" if len(asked) < 5 else LEASE.owner)

    asked: list[int] = []
    return SimpleNamespace(acquire=acquire, release=release, state=state), said  # type: ignore[return-value]


def test_the_base_is_owned_inside_and_given_back_whatever_happens() -> None:
    base, said = base_that_answers(Done(LEASE))
    with pytest.raises(RuntimeError), ownership(base) as lease:
        assert lease == LEASE and said == [myself()]
        assert base.state().owner == LEASE.owner, "telemetry says so too"
        raise RuntimeError
    assert said[1:] == ["release"]


def test_an_owner_names_its_host_its_process_and_its_user() -> None:
    assert str(os.getpid()) in myself() and os.uname().nodename in myself() and "@" in myself()


def test_an_owner_who_beats_is_not_waited_for() -> None:
    base, said = base_that_answers(held(silent=0.1, free_in=4.9))
    began = time.monotonic()
    with pytest.raises(FailureError, match=r"LEASE_HELD.*ann"), ownership(base):
        pytest.fail("it is somebody else's")
    assert len(said) == 1 and time.monotonic() - began < 1.0


def test_an_owner_who_fell_silent_is_waited_for() -> None:
    base, said = base_that_answers(held(silent=4.8, free_in=0.2), held(silent=5.0, free_in=0.0), Done(LEASE))
    with ownership(base) as lease:
        assert lease == LEASE
    assert len(said) == 4


def test_a_base_that_does_not_answer_is_not_asked_for_ever() -> None:
    base, said = base_that_answers(Failed(Failure("AGENT_UNREACHABLE", "no answer")))
    with pytest.raises(FailureError, match="AGENT_UNREACHABLE"), ownership(base):
        pytest.fail("there is nobody")
    assert len(said) == 1
