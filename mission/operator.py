"""The operator's word and answers, from wherever they come: control socket, signals, or nobody at all."""

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace

from behaviours.services import Clock, Journal
from drivers.jobs import Done, Job, Outcome, Running
from perception.failure import FailureError


class Word:
    """What the operator wants just now. An abort is for good.

    Written by the control socket's thread and by signal handlers, which may interrupt any line: no lock may be held
    here, and each attribute is written whole.
    """

    def __init__(self, paused: bool = False) -> None:
        self._paused = paused
        self._aborted = False

    def __call__(self) -> str:
        if self._aborted:
            return "abort"
        return "pause" if self._paused else "run"

    def pause(self) -> None:
        self._paused = True

    def resume(self) -> None:
        self._paused = False

    def abort(self) -> None:
        self._aborted = True


@contextmanager
def signals(word: Word) -> Iterator[None]:
    """Ctrl-C pauses, and aborts what is paused already; SIGTERM aborts. All of it safely, at the next tick."""

    def interrupted(*_: object) -> None:
        if word() == "run":
            word.pause()
        else:
            word.abort()

    handlers = {signal.SIGINT: interrupted, signal.SIGTERM: lambda *_: word.abort()}
    before = {number: signal.signal(number, handler) for number, handler in handlers.items()}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def deaf() -> None:
    """The mission has ended: there is nothing left to pause or to abort until somebody listens to the signals again."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.SIG_IGN)


@dataclass(frozen=True)
class Question:
    """One question as the operator sees it.

    Args:
        deadline: mission time at which the default is taken.
        answer: empty while it is open.
        by: whose the answer is, ``operator`` or ``default``.
    """

    question_id: str
    text: str
    options: tuple[str, ...]
    default: str
    deadline: float
    answer: str = ""
    by: str = ""


class Desk:
    """Where questions lie until they are answered; a :class:`behaviours.services.Operator`. May be used by any thread.

    Args:
        clock: mission time, so that no deadline passes in a pause.
        attended: whether anybody is there to answer; else each default is taken at once.
    """

    def __init__(self, clock: Clock, journal: Journal, attended: bool) -> None:
        self._clock = clock
        self._journal = journal
        self._attended = attended
        self._questions: dict[str, Question] = {}
        self._lock = threading.RLock()

    @property
    def questions(self) -> tuple[Question, ...]:
        """All that were asked and not withdrawn, in their order."""
        with self._lock:
            return tuple(self._questions.values())

    @property
    def open(self) -> tuple[Question, ...]:
        return tuple(question for question in self.questions if not question.answer)

    def ask(self, question_id: str, text: str, options: tuple[str, ...], default: str, deadline: float) -> Job[str]:
        """See :meth:`behaviours.services.Operator.ask`."""
        question = Question(question_id, text, options, default, deadline)
        with self._lock:
            self._questions[question_id] = question
        self._journal.record(
            "asked", question_id=question_id, text=text, options=options, default=default, deadline=deadline
        )
        if not self._attended:
            self._close(question, default, "default")
        return _Reply(self, question_id)

    def answer(self, question_id: str, answer: str) -> Question:
        """Answer an open question.

        Raises:
            FailureError: ``NO_SUCH_QUESTION`` where none of that name is open, ``NO_SUCH_OPTION``.
        """
        with self._lock:
            question = next((one for one in self.open if one.question_id == question_id), None)
            if question is None:
                names = ", ".join(one.question_id for one in self.open) or "none"
                raise FailureError("NO_SUCH_QUESTION", f"{question_id} is not open; open: {names}")
            if answer not in question.options:
                options = ", ".join(f"'{option}'" for option in question.options)
                raise FailureError("NO_SUCH_OPTION", f"{question_id} may be answered by {options}, not '{answer}'")
            return self._close(question, answer, "operator")

    def poll(self, question_id: str) -> Outcome[str]:
        """The answer, or the default once the deadline has passed."""
        with self._lock:
            question = self._questions[question_id]
            if not question.answer and self._clock.now() >= question.deadline:
                question = self._close(question, question.default, "default")
        return Done(question.answer) if question.answer else Running(None, question.text)

    def withdraw(self, question_id: str) -> None:
        """Nobody wants to know any more; an answered question stays on record."""
        with self._lock:
            if not self._questions[question_id].answer:
                del self._questions[question_id]

    def _close(self, question: Question, answer: str, by: str) -> Question:
        answered = replace(question, answer=answer, by=by)
        with self._lock:
            self._questions[question.question_id] = answered
        self._journal.record("answered", question_id=question.question_id, answer=answer, by=by)
        return answered


@dataclass(frozen=True)
class _Reply:
    desk: Desk
    question_id: str

    def poll(self) -> Outcome[str]:
        return self.desk.poll(self.question_id)

    def cancel(self) -> None:
        self.desk.withdraw(self.question_id)
