"""The operator's word and answers."""

import os
import signal
from typing import Any

import pytest

from drivers.jobs import Done, Running
from drivers.simulated.clock import VirtualClock
from mission.clock import MissionClock
from mission.operator import Desk, Word, signals
from perception.failure import FailureError

OPTIONS = ("again", "go on")


class Notes(list[dict[str, Any]]):
    def record(self, kind: str, /, **figures: object) -> None:
        self.append({"kind": kind, **figures})


def desk(attended: bool = True) -> tuple[Desk, VirtualClock, Notes]:
    clock, notes = VirtualClock(), Notes()
    return Desk(clock, notes, attended), clock, notes


# --- the word -------------------------------------------------------------------------------------------------------


def test_an_abort_is_for_good() -> None:
    word = Word()
    assert word() == "run"
    word.pause()
    assert word() == "pause"
    word.resume()
    word.abort()
    word.resume()
    word.pause()
    assert word() == "abort"


def test_a_mission_may_begin_paused() -> None:
    assert Word(paused=True)() == "pause"


def test_ctrl_c_pauses_and_the_second_one_aborts() -> None:
    before = signal.getsignal(signal.SIGINT)
    word = Word()
    with signals(word):
        os.kill(os.getpid(), signal.SIGINT)
        assert word() == "pause"
        os.kill(os.getpid(), signal.SIGINT)
        assert word() == "abort"
        os.kill(os.getpid(), signal.SIGINT)
        assert word() == "abort", "an impatient operator does no harm"
    assert signal.getsignal(signal.SIGINT) is before


def test_ctrl_c_after_a_resume_pauses_again() -> None:
    word = Word()
    with signals(word):
        os.kill(os.getpid(), signal.SIGINT)
        word.resume()
        os.kill(os.getpid(), signal.SIGINT)
        assert word() == "pause"


def test_sigterm_aborts_at_once() -> None:
    before = signal.getsignal(signal.SIGTERM)
    word = Word()
    with signals(word):
        os.kill(os.getpid(), signal.SIGTERM)
        assert word() == "abort"
    assert signal.getsignal(signal.SIGTERM) is before


# --- questions ------------------------------------------------------------------------------------------------------


def test_an_answer_ends_the_job_and_is_on_record() -> None:
    at, _, notes = desk()
    job = at.ask("Q001", "Again?", OPTIONS, "go on", 120.0)
    assert isinstance(job.poll(), Running)
    assert [question.question_id for question in at.open] == ["Q001"]
    at.answer("Q001", "again")
    assert job.poll() == Done("again")
    assert at.open == ()
    assert [(note["kind"], note.get("by")) for note in notes] == [("asked", None), ("answered", "operator")]


def test_a_question_takes_its_default_at_its_deadline_and_not_before() -> None:
    at, clock, _ = desk()
    job = at.ask("Q001", "Again?", OPTIONS, "go on", 120.0)
    clock.sleep(119.9)
    assert isinstance(job.poll(), Running)
    clock.sleep(0.1)
    assert job.poll() == Done("go on")
    (question,) = at.questions
    assert (question.answer, question.by) == ("go on", "default")
    with pytest.raises(FailureError, match="NO_SUCH_QUESTION"):
        at.answer("Q001", "again")


def test_where_nobody_watches_the_default_is_taken_at_once() -> None:
    at, _, notes = desk(attended=False)
    assert at.ask("Q001", "Again?", OPTIONS, "go on", 120.0).poll() == Done("go on")
    assert notes[-1]["by"] == "default"


@pytest.mark.parametrize(
    ("name", "answer", "code"), [("Q002", "again", "NO_SUCH_QUESTION"), ("Q001", "maybe", "NO_SUCH_OPTION")]
)
def test_an_answer_that_fits_nothing_is_refused_with_what_would(name: str, answer: str, code: str) -> None:
    at, _, _ = desk()
    job = at.ask("Q001", "Again?", OPTIONS, "go on", 120.0)
    with pytest.raises(FailureError, match=code):
        at.answer(name, answer)
    assert isinstance(job.poll(), Running)


def test_a_withdrawn_question_is_gone_and_an_answered_one_stays_on_record() -> None:
    at, _, _ = desk()
    first, second = at.ask("Q1", "?", OPTIONS, "go on", 9.0), at.ask("Q2", "?", OPTIONS, "go on", 9.0)
    at.answer("Q1", "again")
    first.cancel()
    second.cancel()
    assert [question.question_id for question in at.questions] == ["Q1"]


# --- mission time ---------------------------------------------------------------------------------------------------


def test_mission_time_stands_still_and_goes_on_from_there() -> None:
    wall = VirtualClock()
    clock = MissionClock(10.0, wall.now, wall.sleep)
    clock.sleep(2.0)
    clock.stand_still(True)
    clock.sleep(5.0)
    clock.stand_still(True)
    assert clock.now() == pytest.approx(20.0)
    clock.stand_still(False)
    assert clock.now() == pytest.approx(20.0)
    clock.sleep(1.0)
    clock.stand_still(False)
    assert clock.now() == pytest.approx(30.0)
