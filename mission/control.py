"""The control socket of a running mission: pause, resume, abort, status and answers, for this user of this machine.

It lies in a folder that only this user may enter, and its address in ``control.json`` of the run folder. What is asked
is acknowledged at once by the server's own thread; the tick loop obeys at its next tick.
"""

import json
import os
import shutil
import tempfile
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Annotated, Any

from msgspec import Meta

from drivers.disk import writing
from drivers.jobs import Progress
from drivers.messages import Body, Command, Name, Problem, Query, Reply, Stale
from drivers.processes import birth_of, lives
from drivers.wire.client import Link, Patience
from drivers.wire.codec import Codec
from drivers.wire.server import Server
from drivers.wire.sockets import Sockets
from mission.operator import Desk, Word
from perception.failure import FailureError

CONTROL_FILE = "control.json"
_PATIENCE = Patience(first=0.5, longest=1.0, total=3.0)

Text = Annotated[str, Meta(max_length=4096)]


class AskStatus(Query, frozen=True):
    """How is it going? ``Status``."""


class Pause(Command, frozen=True):
    """Stand still and wait: ``Status``."""

    always = True


class Resume(Command, frozen=True):
    """Go on; also answers a question whether to. ``Status``."""


class Abort(Command, frozen=True):
    """End the mission safely: ``Status``."""

    always = True


class AnswerQuestion(Command, frozen=True):
    """The operator's answer to an open question: ``Status``."""

    question_id: Name
    answer: Name


class Status(Body, frozen=True):
    """What the mission does, as of its last tick, and what the operator has ordered, as of now.

    Args:
        command: ``run``, ``pause`` or ``abort``.
        figures: JSON-ready, as ``state.json`` has them: ``phase`` and what stands beside it.
        questions: those that are open.
    """

    command: Name
    figures: dict[str, Any]
    questions: list[dict[str, Any]]


Requests = AskStatus | Pause | Resume | Abort | AnswerQuestion
_replies: Codec[Reply[Any]] = Codec(Reply[Status | Problem | Stale])


class Console:
    """The executive's end: obeys what comes in, and tells what was published last. Any thread may call it."""

    def __init__(self, word: Word, desk: Desk) -> None:
        self._word = word
        self._desk = desk
        self._figures: dict[str, Any] = {}

    def publish(self, figures: dict[str, Any]) -> None:
        """What ``status`` tells from now on."""
        self._figures = figures

    def obey(self, request: Requests) -> Status:
        """Raises ``NO_SUCH_QUESTION``, ``NO_SUCH_OPTION``, ``MISSION_ENDING``."""
        if isinstance(request, Pause):
            self._word.pause()
        elif isinstance(request, Abort):
            self._word.abort()
        elif isinstance(request, AnswerQuestion):
            self._desk.answer(request.question_id, request.answer)
        elif isinstance(request, Resume):
            self._resume()
        return self.status()

    def status(self) -> Status:
        questions = [
            {
                "question_id": question.question_id,
                "text": question.text,
                "options": list(question.options),
                "default": question.default,
                "deadline": question.deadline,
            }
            for question in self._desk.open
        ]
        return Status(self._word(), self._figures, questions)

    def _resume(self) -> None:
        if self._word() == "abort":
            raise FailureError("MISSION_ENDING", "the mission is being aborted; take it up again when it has ended")
        for question in self._desk.open:
            if "resume" in question.options:
                self._desk.answer(question.question_id, "resume")
        self._word.resume()


@contextmanager
def serving(console: Console, run: Path) -> Iterator[None]:
    """Serve a console and leave its address in the run folder; both are gone at the end."""
    folder = Path(tempfile.mkdtemp(prefix="mission-"))  # made with 0700, so nobody else reaches what is in it
    address = run / CONTROL_FILE
    try:
        socket, endpoint = Sockets().router(f"ipc://{folder}/control")
        server = Server(socket, Requests, console.obey, uuid.uuid4().hex, "mission control")
        try:
            _write_private(address, json.dumps({"endpoint": endpoint} | _this_process()))
            yield
        finally:
            server.close()
    finally:
        with suppress(OSError):  # one that stays names a process that is gone
            address.unlink(missing_ok=True)
        shutil.rmtree(folder, ignore_errors=True)


def order(run: Path, body: Requests) -> Status:
    """Ask the executive of a run folder, and wait for its acknowledgement.

    Raises:
        FailureError: ``NO_EXECUTIVE`` where nobody runs the mission, ``EXECUTIVE_SILENT`` where it does not answer, or
            what it refuses.
    """
    endpoint = _endpoint(run)
    try:
        with Link(Sockets(), endpoint, _PATIENCE, Progress(), _replies) as link:
            return link.ask(body, Status)
    except FailureError as error:
        if error.failure.code != "AGENT_UNREACHABLE":
            raise
        raise FailureError(
            "EXECUTIVE_SILENT", f"{run}: its executive is there but did not answer in {_PATIENCE.total:g} s"
        ) from error


def is_live(run: Path) -> bool:
    """Whether a process runs the mission of this folder just now."""
    try:
        _endpoint(run)
    except FailureError:
        return False
    return True


def _endpoint(run: Path) -> str:
    try:
        told = json.loads((run / CONTROL_FILE).read_text(encoding="utf-8"))
        endpoint, pid, birth = str(told["endpoint"]), int(told["pid"]), str(told["birth"])
    except FileNotFoundError:
        raise FailureError("NO_EXECUTIVE", f"{run}: no mission is running in this folder") from None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise FailureError("NO_EXECUTIVE", f"{run}: {CONTROL_FILE} cannot be read: {error}") from error
    if not lives(pid, birth):
        raise FailureError("NO_EXECUTIVE", f"{run}: the process that ran this mission ({pid}) is gone")
    return endpoint


def _this_process() -> dict[str, object]:
    return {"pid": os.getpid(), "birth": birth_of(os.getpid())}


def _write_private(path: Path, text: str) -> None:
    with writing(path):
        path.unlink(missing_ok=True)  # left by an executive that was killed
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
        with os.fdopen(handle, "w", encoding="utf-8") as stream:
            stream.write(text)
