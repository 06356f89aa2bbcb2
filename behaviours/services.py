"""What leaves are handed at ``setup``: drivers, perception worker, clock, journal, files, and the operator."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import inf
from pathlib import Path
from typing import Any, Protocol

from behaviours.settings import Settings
from drivers.interfaces import Base, Scanner
from drivers.jobs import Done, Job, Outcome
from perception.grids import Grid


class Clock(Protocol):
    """Mission time in seconds, never going back; scripted in tests, scaled in a simulation."""

    def now(self) -> float: ...


class Journal(Protocol):
    """Takes note of what happened; every figure with the scan or room it belongs to."""

    def record(self, kind: str, /, **figures: object) -> None: ...


class Perception(Protocol):
    """The worker that runs the stages of the paper, one job at a time, outside of the tick."""

    def submit(self, stage: str, /, **arguments: object) -> Job[Any]:
        """Start a stage by name; its arguments and its result are small values and ids."""
        ...


class Files(Protocol):
    """Where the mission's files are."""

    def scan_file(self, scan_id: str) -> Path: ...

    def robot_map(self, map_id: str) -> Grid: ...

    def free_gb(self) -> float:
        """Gigabytes that may still be written."""
        ...


class Operator(Protocol):
    """Whoever watches over the mission."""

    def ask(self, question_id: str, text: str, options: tuple[str, ...], default: str, deadline: float) -> Job[str]:
        """Put a question; the job's value is one of the options, the default where nobody answers in time.

        Args:
            question_id: name, unique within the mission.
            deadline: mission time after which the default is taken.
        """
        ...


class NobodyThere:
    """An operator who takes every default at once: for missions that nobody watches."""

    def ask(self, question_id: str, text: str, options: tuple[str, ...], default: str, deadline: float) -> Job[str]:
        return _Answered(default)


@dataclass(frozen=True)
class _Answered:
    answer: str

    def poll(self) -> Outcome[str]:
        return Done(self.answer)

    def cancel(self) -> None:
        """There is nothing to cancel."""


class Interlock:
    """Whether the wheels may turn now: a drive is under way, and no scan that they would spoil."""

    def __init__(self) -> None:
        self._held_until: dict[str, float] = {}
        self._driven_by: set[str] = set()

    def lets_drive(self, now: float) -> bool:
        """Whether a base that is let move at mission time ``now`` does nothing but what was ordered."""
        return self.driving and all(now >= until for until in self._held_until.values())

    def hold(self, who: str, until: float = inf) -> None:
        """Forbid motion, up to some mission time at most."""
        self._held_until[who] = until

    def release(self, who: str) -> None:
        """Harmless for who does not hold it."""
        self._held_until.pop(who, None)

    @property
    def driving(self) -> bool:
        return bool(self._driven_by)

    def set_out(self, who: str) -> None:
        self._driven_by.add(who)

    def arrive(self, who: str) -> None:
        """Harmless for who did not set out."""
        self._driven_by.discard(who)


@dataclass(frozen=True)
class Services:
    """All that a leaf may reach; a subtree never builds any of it."""

    scanner: Scanner
    base: Base
    perception: Perception
    clock: Clock
    journal: Journal
    files: Files
    settings: Settings = field(default_factory=Settings)
    operator: Operator = field(default_factory=NobodyThere)
    interlock: Interlock = field(default_factory=Interlock)
    owner: str = ""
    """By what name this mission holds the lease of the base."""


def connect(kwargs: Mapping[str, object]) -> Services:
    """The services out of ``setup``'s keyword arguments.

    Raises:
        TypeError: when the tree is set up without them.
    """
    services = kwargs.get("services")
    if not isinstance(services, Services):
        raise TypeError(f"set the tree up with services=Services(...), found {services!r}")
    return services
