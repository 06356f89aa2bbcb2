"""The services of a mission whose every job is written in its chronicle, and told from there when it is resumed."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from behaviours.services import Journal, Operator, Perception, Services
from drivers.interfaces import (
    Base,
    BaseInfo,
    BaseState,
    DriveGoal,
    DriveReport,
    Lease,
    Scanner,
    ScannerInfo,
    ScanReceipt,
    ScanSettings,
    SelfTest,
)
from drivers.jobs import Job
from mission.chronicle import Chronicle
from mission.products import made_by
from mission.records import KeptFile
from mission.store import RunFolder
from perception.failure import FailureError
from perception.transforms import Matrix


def remembering(services: Services, chronicle: Chronicle) -> Services:
    """The same services, with every job of a leaf in the chronicle, and every act in the journal as well."""
    chronicle.witnessed_by(services.journal)
    return replace(
        services,
        scanner=RememberedScanner(services.scanner, chronicle),
        base=RememberedBase(services.base, chronicle, services.owner),
        perception=RememberedPerception(services.perception, chronicle),
        operator=RememberedOperator(services.operator, chronicle),
        clock=RememberedClock(chronicle),
        journal=RememberedJournal(services.journal, chronicle),
    )


class RememberedScanner:
    """A :class:`~drivers.interfaces.Scanner`."""

    def __init__(self, scanner: Scanner, chronicle: Chronicle) -> None:
        self._scanner = scanner
        self._chronicle = chronicle

    def info(self) -> Job[ScannerInfo]:
        return self._scanner.info()

    def self_test(self) -> Job[SelfTest]:
        return self._scanner.self_test()

    def take(self, scan_id: str, settings: ScanSettings, odom_from_base: Matrix) -> Job[ScanReceipt]:
        def order() -> Job[ScanReceipt]:
            return self._scanner.take(scan_id, settings, odom_from_base)

        return self._chronicle.begin("take", scan_id, order, acts=True)

    def fetch(self, receipt: ScanReceipt, destination: Path) -> Job[Path]:
        return self._chronicle.begin("fetch", receipt.scan_id, lambda: self._scanner.fetch(receipt, destination))


class RememberedBase:
    """A :class:`~drivers.interfaces.Base`; to stand still needs no leave and leaves no trace."""

    def __init__(self, base: Base, chronicle: Chronicle, owner: str) -> None:
        self._base = base
        self._chronicle = chronicle
        self._owner = owner

    def info(self) -> Job[BaseInfo]:
        return self._base.info()

    def state(self) -> BaseState | None:
        return self._chronicle.sense(self._base.state(), self._owner)

    def drive(self, goal: DriveGoal) -> Job[DriveReport]:
        frame = self._chronicle.odom_frame

        def order() -> Job[DriveReport]:
            # An order may have to wait for leave, and longer than what it says of the base's place is true.
            if self._chronicle.odom_frame != frame:
                why = f"the place that goal {goal.goal_id} was to begin at is not known any more"
                raise FailureError("NAV_INTERRUPTED", why, track=[], distance=0.0)
            return self._base.drive(goal)

        return self._chronicle.begin("drive", goal.goal_id, order, acts=True)

    def stop(self) -> Job[None]:
        return self._base.stop()

    def acquire(self, owner: str) -> Job[Lease]:
        return self._base.acquire(owner)

    def beat(self, tick: int, may_move: bool) -> None:
        self._base.beat(tick, may_move)

    def release(self) -> Job[None]:
        return self._base.release()


class RememberedPerception:
    """The perception worker; a stage is named by the scan, room and cycle that it is about."""

    def __init__(self, perception: Perception, chronicle: Chronicle) -> None:
        self._perception = perception
        self._chronicle = chronicle

    def submit(self, stage: str, /, **arguments: Any) -> Job[Any]:
        def made(value: Any) -> Sequence[KeptFile]:
            return made_by(RunFolder(self._chronicle.folder), stage, arguments, value)

        def start() -> Job[Any]:
            return self._perception.submit(stage, **arguments)

        return self._chronicle.begin(stage, about(arguments), start, made=made)


class RememberedOperator:
    """The operator. What is asked of him for as long as something is wrong just now is no part of the past."""

    def __init__(self, operator: Operator, chronicle: Chronicle) -> None:
        self._operator = operator
        self._chronicle = chronicle

    def ask(self, question_id: str, text: str, options: tuple[str, ...], default: str, deadline: float) -> Job[str]:
        def put() -> Job[str]:
            return self._operator.ask(question_id, text, options, default, deadline)

        return self._chronicle.begin("ask", question_id, put) if question_id.startswith("Q") else put()


class RememberedClock:
    """Mission time, told or lived."""

    def __init__(self, chronicle: Chronicle) -> None:
        self._chronicle = chronicle

    def now(self) -> float:
        return self._chronicle.now()


class RememberedJournal:
    """A journal that takes no note of what is only told again."""

    def __init__(self, journal: Journal, chronicle: Chronicle) -> None:
        self._journal = journal
        self._chronicle = chronicle

    def record(self, kind: str, /, **figures: object) -> None:
        if not self._chronicle.telling:
            self._journal.record(kind, **figures)


def heeding(command: Callable[[], str], chronicle: Chronicle) -> Callable[[], str]:
    """The operator's word; the first "run" is the leave that a resumed mission waits for before it acts."""

    def word() -> str:
        said = command()
        if said == "run":
            chronicle.release()
        return said

    return word


def about(arguments: Mapping[str, object]) -> str:
    """A stage's job by name: what tells it from the other jobs of that stage."""
    return " ".join(str(arguments[key]) for key in ("scan_id", "room_id", "cycle") if key in arguments)
