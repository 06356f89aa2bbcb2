"""Jobs written down as they are begun and ended; and, when a mission is resumed, told again.

The tree is deterministic given what its jobs came to, what the base said when they were begun, and the time. So a
mission is resumed by ticking a fresh tree from the start while the chronicle answers every job with its known outcome:
no leaf has code for it, and no node's state is ever saved. Where the known outcomes end, the mission waits for leave to
act, and then begins the next job, or the last one again by its old name, which the agents know whether they did.
"""

import json
import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, TypeVar

from behaviours.services import Clock, Journal
from drivers.interfaces import BaseState
from drivers.jobs import Done, Failed, Job, Outcome, Running
from mission.footing import Footing
from mission.ledger import Ledger
from mission.records import JobRow, KeptFile
from mission.values import from_json, to_json
from perception.failure import Failure, FailureError

log = logging.getLogger("mission")

T = TypeVar("T")

_PATIENCE_TICKS = 100
Made = Callable[[Any], Sequence[KeptFile]]
"""The files that a job made, of the value that it came to."""


@dataclass(frozen=True)
class _Ending:
    """How a job ended, as it is written down; ``outcome`` is JSON."""

    how: str
    outcome: str
    files: Sequence[KeptFile] = ()


class Chronicle:
    """All jobs of a mission in their order.

    Args:
        ledger: keeps them.
        clock: mission time of what is lived, not told.
    """

    def __init__(self, ledger: Ledger, clock: Clock) -> None:
        self._ledger = ledger
        self._clock = clock
        self._told = ledger.jobs()
        self._owed: list[tuple[int, _Ending, float]] = []
        self._dropped = 0
        self._reopen_what_was_given_up()
        self._next = 0
        self._unheard = 0
        self._at = 0.0
        self._moved = False
        self._may_act = not self._told
        self._sensed: BaseState | None = None
        self._footing = _footing(self._told)
        self._divergence: FailureError | None = None
        self._witness: Journal | None = None

    @property
    def folder(self) -> Path:
        """The run folder: where the ledger is, and the files that jobs make."""
        return self._ledger.path.parent

    def witnessed_by(self, journal: Journal) -> None:
        """Every act is told there too, once it is durably written down: a ledger that lost its end is known by that."""
        self._witness = journal

    @property
    def telling(self) -> bool:
        """Whether known outcomes are left to be told; nothing that happens meanwhile is new."""
        return self._next < len(self._told) or self._unheard > 0

    @property
    def scans_taken(self) -> int | None:
        """Scans that a mission has which is taken up again; None where none has begun."""
        return sum(row.kind == "take" and row.how == "done" for row in self._told) if self._told else None

    def release(self) -> None:
        """Leave to act: what was begun when the known outcomes ended is done now."""
        self._may_act = True

    def now(self) -> float:
        """Mission time, of what is told or of what is lived."""
        return self._at if self.telling else self._clock.now()

    def tell(self, tick: Callable[[], None]) -> None:
        """Tick a fresh tree through all that is known, in no time.

        Raises:
            FailureError: ``RESUME_DIVERGED`` when the tree does not do what it did.
        """
        idle = 0
        while self.telling:
            self._moved = False
            tick()
            if self._divergence is not None:
                raise self._divergence
            # A tick in which nothing began or ended waits for the time of the next job.
            self._at = self._at if self._moved else max(self._at, self._row.begun)
            idle = 0 if self._moved else idle + 1
            if idle > _PATIENCE_TICKS:
                row = self._row
                raise FailureError("RESUME_DIVERGED", f"the tree does not come to job {row.seq}, {row.kind} {row.name}")

    def sense(self, live: BaseState | None, owner: str) -> BaseState | None:
        """What the base says; while telling, what it said when the next job was begun.

        Args:
            owner: this mission, by the name that it has the lease under.
        """
        if self.telling:
            then = from_json(json.loads(self._row.world))
            # What the work goes by is of the past. Whether the base is well, and whose, is the watch's, and of now: it
            # is looked at when all is told, for until then nothing can act, nor tell the base that its owner lives.
            live = then and replace(then, emergency_stop=False, age=0.0, owner=owner)
        elif live is not None:
            live = self._footing.named(live)
        self._sensed = live
        return live

    @property
    def odom_frame(self) -> str:
        """What the odometry was told in that was sensed last."""
        return self._sensed.odom_frame if self._sensed else ""

    def begin(
        self,
        kind: str,
        name: str,
        start: Callable[[], Job[T]],
        acts: bool = False,
        made: Made | None = None,
    ) -> Job[T]:
        """Begin a job, or tell its outcome if it is known.

        Args:
            kind, name: what, of what; stable over restarts.
            start: begins it; called after the job is written down.
            acts: whether it moves the world, so that it must be on the disk before.
            made: the files that it made, of the value that it came to; written down before its end is.

        Raises:
            FailureError: ``RESUME_DIVERGED`` when the tree begins another job than it did before.
        """
        if self._next == len(self._told):
            world = json.dumps(to_json(self._sensed))
            return _LivedJob(self, lambda: self._write_down(kind, name, world, acts), start, made)
        row = self._told[self._next]
        if (row.kind, row.name) != (kind, name):
            # Kept as well as raised: a leaf makes an ordinary failure of what its job raises.
            self._divergence = FailureError(
                "RESUME_DIVERGED",
                f"job {row.seq} was {row.kind} {row.name}, but this tree begins {kind} {name}: "
                "its settings or its code are not those the mission began with",
                job=row.seq,
            )
            raise self._divergence
        self._next += 1
        self._moved = True
        self._at = max(self._at, row.begun)
        if row.ended is not None:
            return _ToldJob(self, row)
        return _LivedJob(self, lambda: row.seq, _interrupted if row.seq == self._dropped else start, made)

    @property
    def _row(self) -> JobRow:
        """The next job to be told, or the last one while its outcome is."""
        return self._told[min(self._next, len(self._told) - 1)]

    def to_be_heard(self) -> None:
        """An outcome is known and will be told."""
        self._unheard += 1

    def heard(self) -> None:
        self._unheard -= 1

    def told(self, at: float) -> None:
        self._moved = True
        self._at = max(self._at, at)

    def may_act(self) -> bool:
        return self._may_act

    def ended(self, seq: int, ending: _Ending) -> None:
        """Write down what a job came to, and before that what it made, so that no end is told without its files."""
        self._settle()
        if ending.files:
            self._ledger.keep(seq, ending.files)
        self._ledger.end(seq, ending.how, ending.outcome, self.now())

    def given_up(self, seq: int) -> None:
        """Write down that a job was cancelled; on a full disk, before anything else that is written."""
        self._owed.append((seq, _Ending("cancelled", "null"), self.now()))
        with waiting_for_room():
            self._settle()

    def _write_down(self, kind: str, name: str, world: str, acts: bool) -> int:
        self._settle()
        seq = self._ledger.begin(kind, name, world, self.now(), acts)
        if acts and self._witness is not None:
            self._witness.record("ordered", job=seq, what=kind, name=name)
        return seq

    def _settle(self) -> None:
        while self._owed:
            seq, ending, at = self._owed[0]
            self._ledger.end(seq, ending.how, ending.outcome, at)
            del self._owed[0]

    def _reopen_what_was_given_up(self) -> None:
        """A job that was cancelled last was not given up by the tree but by an executive on its way out: it is open.

        A drive is not ordered again, for the base never drives a goal that it was told to drop: it fails when there is
        leave to act, and how far it came is seen then.
        """
        if not self._told or self._told[-1].how != "cancelled":
            return
        last = self._told.pop()
        self._ledger.reopen(last.seq)
        self._told.append(replace(last, ended=None, how=None, outcome=None))
        if last.kind == "drive":
            self._dropped = last.seq


class _ToldJob:
    """A job whose outcome is known.

    It is told one tick after the job was begun, as in life: what the tree does upon it must not go by what the base
    said when this job was begun, but by what it said when the next one was.
    """

    def __init__(self, chronicle: Chronicle, row: JobRow) -> None:
        self._chronicle = chronicle
        self._row = row
        self._polls = 0
        self._is_awaited = row.how != "cancelled"  # that one is given up by the tree again
        if self._is_awaited:
            chronicle.to_be_heard()

    def poll(self) -> Outcome[Any]:
        assert self._row.ended is not None and self._row.outcome is not None
        self._polls += 1
        if self._polls == 1:
            return Running()
        if self._polls == 2:
            self._chronicle.told(self._row.ended)
        self._hear()
        value = from_json(json.loads(self._row.outcome))
        if self._row.how == "done":
            return Done(value)
        return Failed(value) if isinstance(value, Failure) else Running()

    def cancel(self) -> None:
        self._hear()

    def _hear(self) -> None:
        if self._is_awaited:
            self._is_awaited = False
            self._chronicle.heard()


class _LivedJob:
    """A job that is begun when there is leave to act, and written down before and after."""

    def __init__(
        self,
        chronicle: Chronicle,
        write_down: Callable[[], int],
        start: Callable[[], Job[Any]],
        made: Made | None,
    ) -> None:
        self._chronicle = chronicle
        self._write_down = write_down
        self._start = start
        self._made = made
        self._seq = 0
        self._job: Job[Any] | None = None
        self._outcome: Outcome[Any] | None = None
        self._act()

    def poll(self) -> Outcome[Any]:
        if self._outcome is not None:
            return self._outcome
        if self._job is None and not self._act():
            return Running(None, "waits for leave to go on, or for room on the disk")
        assert self._job is not None
        outcome, ending = _asked(self._job, self._made)
        if ending is None:
            return outcome
        with waiting_for_room():
            self._chronicle.ended(self._seq, ending)
            self._outcome = outcome
        return self._outcome or Running(None, "waits for room on the disk")

    def cancel(self) -> None:
        if self._outcome is None:
            self._outcome = Failed(Failure("CANCELLED", "the job was cancelled"))
            if self._job is not None:
                self._job.cancel()
                self._chronicle.given_up(self._seq)

    def _act(self) -> bool:
        """Begin it, if that may be; written down first, for nobody may act whom a full disk keeps from saying so."""
        if self._chronicle.may_act():
            with waiting_for_room():
                self._seq = self._write_down()
                self._job = _begun(self._start)
        return self._job is not None


class _Stillborn:
    """A job that could not be begun."""

    def __init__(self, failure: Failure) -> None:
        self._failure = failure

    def poll(self) -> Outcome[Any]:
        return Failed(self._failure)

    def cancel(self) -> None:
        """There is nothing to cancel."""


def _interrupted() -> Job[Any]:
    raise FailureError("NAV_INTERRUPTED", "the drive was given up when the mission was ended")


def _begun(start: Callable[[], Job[Any]]) -> Job[Any]:
    """What is written down as begun has an end, also where its driver raises at once."""
    try:
        return start()
    except Exception as error:
        return _Stillborn(_as_failure(error))


def _asked(job: Job[Any], made: Made | None) -> tuple[Outcome[Any], _Ending | None]:
    """What a job came to, and how that is written down; None while it runs.

    A driver that raises, or gives what could not be told again, has failed: the tree must hear now what it would hear
    in a mission that is resumed.
    """
    try:
        outcome = job.poll()
        if isinstance(outcome, Done):
            files = made(outcome.value) if made is not None else ()
            return outcome, _Ending("done", json.dumps(to_json(outcome.value)), files)
        if not isinstance(outcome, Failed):
            return outcome, None
        return outcome, _Ending("failed", json.dumps(to_json(outcome.failure)))
    except Exception as error:
        job.cancel()
        failure = _as_failure(error)
        return Failed(failure), _Ending("failed", json.dumps(to_json(failure)))


def _as_failure(error: Exception) -> Failure:
    if isinstance(error, FailureError):
        return error.failure
    log.error("a driver failed", exc_info=error)
    return Failure("DRIVER_EXCEPTION", f"{type(error).__name__}: {error}")


def _footing(told: list[JobRow]) -> Footing:
    if not told:
        return Footing(None, led=False)
    return Footing(from_json(json.loads(told[-1].world)), led=told[-1].kind == "drive")


@contextmanager
def waiting_for_room() -> Iterator[None]:
    """What a full disk does not take now is tried again at the next tick."""
    try:
        yield
    except FailureError as error:
        if error.failure.code != "DISK_FULL":
            raise
