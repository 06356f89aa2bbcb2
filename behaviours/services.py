"""What leaves are handed at ``setup``: the drivers, the perception worker, a clock, a journal, and where files go."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

from behaviours.settings import Settings
from drivers.interfaces import Base, Scanner
from drivers.jobs import Job
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


def connect(kwargs: Mapping[str, object]) -> Services:
    """The services out of ``setup``'s keyword arguments.

    Raises:
        TypeError: when the tree is set up without them.
    """
    services = kwargs.get("services")
    if not isinstance(services, Services):
        raise TypeError(f"set the tree up with services=Services(...), found {services!r}")
    return services
