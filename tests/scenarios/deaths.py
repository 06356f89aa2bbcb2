"""A mission whose process really dies at one crash point of its commit path, and what takes it up again.

Each life is a process of its own, forked from one that has no thread, and ends by ``os._exit`` before, amid or after
one operation: of the ledger's rows and transactions, of the run folder's files, of the transfer and of the scanner's
spool. The devices outlive it: what they know is put aside at the instant of the death, beside the disk that it is
about, and handed to the next life.
"""

import hashlib
import json
import os
import pickle
import re
import threading
import traceback
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Any, NoReturn

import numpy as np

from drivers.interfaces import DriveGoal
from drivers.jobs import Outcome
from drivers.wire.hashing import sha256_of
from drivers.wire.spool import Spool
from mission.fsck import check
from mission.journal import read_events
from mission.ledger import Ledger
from mission.run import Summary
from mission.store import RunFolder
from perception.transforms import Matrix
from tests.scenarios.bad_disk import BadDisk, Way
from tests.scenarios.kept import Kept
from tests.scenarios.scripted import ScriptedJob

DIED = 77
_OF_A_PROCESS = re.compile(r"(?<=\.)\d+\.(?=partial)")
_OF_THE_DAY = ("started", "ended", "t", "utc", "wall_s", "simulated_s")
"""What two missions that are the same may differ in."""


class When(Enum):
    """The instant of a death; amid a write, its first byte is on the disk."""

    BEFORE = "before"
    AMID = "amid"
    AFTER = "after"


class MortalDisk(BadDisk):
    """A good disk whose user dies at the ``at``-th operation, from one."""

    def __init__(self, folder: Path, when: When, at: int | None, die: Callable[[], NoReturn]) -> None:
        super().__init__(folder, Way.FULL, None)
        self._when = when
        self._dies_at = at
        self._die = die

    def asked(self, what: str, path: object) -> bool:
        if not self.holds(path):
            return False
        self.log.append(f"{what} {_OF_A_PROCESS.sub('', Path(str(path)).name)}")
        if self._is_now and self._when is When.BEFORE:
            self._die()
        return self._is_now and self._when is When.AMID and what == "write"

    def done(self) -> None:
        if self._is_now:
            self._die()

    @property
    def _is_now(self) -> bool:
        return len(self.log) == self._dies_at


@dataclass(frozen=True)
class Drive:
    """A goal that the base was given, and how it ended, if it did."""

    goal: DriveGoal
    outcome: Outcome[Any] | None
    cancelled: bool


@dataclass(frozen=True)
class Devices:
    """What base and scanner know, which the executive's death does not change, and what the watch saw so far."""

    pose: tuple[float, float, float]
    odom_from_map: Matrix
    was_placed: bool
    owner: str
    drives: list[Drive]
    taken: dict[str, Matrix]
    cancelled: frozenset[str]
    registered: list[str]
    rooms_ended: dict[str, tuple[str, str]]

    @classmethod
    def of(cls, kept: Kept) -> "Devices":
        base, jobs = kept.base, kept.base._jobs
        drives = [Drive(goal, jobs[goal.goal_id].outcome, jobs[goal.goal_id].cancelled) for goal in base.goals]
        cancelled = frozenset(name for name, job in kept.scanner._jobs.items() if job.cancelled)
        taken, watch = dict(kept.scanner.taken), kept.monitor
        return cls(
            base.pose, base.odom_from_map, base.was_placed, base.owner, drives, taken, cancelled,
            watch.registered, watch.rooms_ended,
        )  # fmt: skip

    def tell(self, kept: Kept) -> None:
        """Devices that know it; what they were about goes on."""
        base, scanner = kept.base, kept.scanner
        base.pose, base.odom_from_map = self.pose, self.odom_from_map
        base.was_placed, base.owner = self.was_placed, self.owner
        kept.monitor.registered, kept.monitor.rooms_ended = self.registered, self.rooms_ended
        for drive in self.drives:
            job = kept.script.job("drive", lambda goal=drive.goal: base._arrive(goal))  # type: ignore[misc]
            job.outcome, job.cancelled = drive.outcome, drive.cancelled
            base.goals.append(drive.goal)
            base._jobs[drive.goal.goal_id] = job
            base._drives.append(job)
        for scan_id, map_from_base in self.taken.items():
            scanner.taken[scan_id] = map_from_base
            scanner._jobs[scan_id] = self._scan(kept, scan_id)

    def _scan(self, kept: Kept, scan_id: str) -> ScriptedJob:
        """Stored already or under way; one that died while it was stored is taken once more by the same name."""
        job = kept.script.job("take", lambda: kept.scanner._store(scan_id))
        job.cancelled = scan_id in self.cancelled
        return job


class Place:
    """Where a mission is flown: the disk it is about, and beside it what the devices know and how a life ended."""

    def __init__(self, folder: Path) -> None:
        self.disk = folder / "disk"
        self.disk.mkdir()
        self._devices = folder / "devices"
        self._told = folder / "told.json"

    def live(self, when: When = When.AFTER, at: int | None = None) -> dict[str, Any]:
        """One life; what it told at its end, empty where it died.

        Raises:
            AssertionError: where it ended in any other way.
        """
        assert threading.active_count() == 1, "a lock that another thread holds would be held for ever in the child"
        child = os.fork()
        if child == 0:
            self._live(when, at)
        _, status = os.waitpid(child, 0)
        code = os.waitstatus_to_exitcode(status)
        told: dict[str, Any] = json.loads(self._told.read_text()) if code != DIED else {}
        assert code in (0, DIED), f"ended with {code}: {told.get('error', '')}"
        return told

    @property
    def devices(self) -> Devices:
        return pickle.loads(self._devices.read_bytes())  # noqa: S301, written here

    @property
    def run(self) -> RunFolder:
        return RunFolder(self.disk / "run")

    def _live(self, when: When, at: int | None) -> NoReturn:
        """The child; it never returns to what its parent was about."""
        try:
            kept = Kept(self.disk)
            if self._devices.exists():
                self.devices.tell(kept)

            def end(code: int) -> NoReturn:
                self._devices.write_bytes(pickle.dumps(Devices.of(kept)))
                os._exit(code if not kept.monitor.breaches else self._fails("; ".join(kept.monitor.breaches)))

            disk = MortalDisk(self.disk, when, at, lambda: end(DIED))
            came_to = kept.fly(disk)
            outcome = came_to.outcome if isinstance(came_to, Summary) else str(came_to)
            self._told.write_text(json.dumps({"outcome": outcome, "errors": kept.errors, "log": disk.log}))
            end(0)
        except BaseException:
            self._fails(traceback.format_exc())
        finally:
            os._exit(1)

    def _fails(self, why: str) -> int:
        self._told.write_text(json.dumps({"error": why}))
        return 1


@dataclass(frozen=True)
class Undisturbed:
    """The mission that nobody killed: what it asked of the disk, and what it came to."""

    log: list[str]
    result: Any

    def points(self, when: When) -> Iterator[int]:
        """The operations at which a life may end so; only a write may be torn."""
        yield from (at for at, what in enumerate(self.log, 1) if when is not When.AMID or what.startswith("write "))


def undisturbed(folder: Path) -> Undisturbed:
    place = Place(folder)
    told = place.live()
    assert (told["outcome"], told["errors"]) == ("complete", []), told
    assert_whole(place, died=False)
    return Undisturbed(told["log"], result(place))


def die_and_resume(folder: Path, when: When, at: int, clean: Undisturbed) -> None:
    """One mission whose executive dies at one crash point, and is resumed.

    Raises:
        AssertionError: where a promise was broken.
    """
    place = Place(folder)
    assert place.live(when, at) == {}, "the mission ended before it died"
    assert_nothing_is_torn(place)
    told = place.live()
    assert told["outcome"] == "complete", told["outcome"]
    assert told["errors"] == []
    assert_whole(place, died=True)
    found = result(place)
    for name, expected in clean.result.items():
        assert found[name] == expected, f"{name}: {found[name]}, not {expected} as where nobody died"


def assert_nothing_is_torn(place: Place) -> None:
    """Whatever has its name is whole, from the instant of the death on."""
    spool = Spool(place.disk / "scanner")
    for path in place.disk.rglob("*"):
        if path.suffix == ".npz" and ".partial" not in path.name:
            with np.load(path) as archive:
                assert all(archive[name].size for name in archive.files), f"{path.name} is torn"
        elif path.name == "state.json" or (path.suffix == ".json" and path.parent.name == "scanner"):
            json.loads(path.read_text())
        elif path.suffix == ".scan" and path.parent.name == "scans":
            stored = spool.find(path.stem)
            assert stored is not None and sha256_of(path) == stored.receipt.sha256, f"{path.name} is torn"


def assert_whole(place: Place, died: bool) -> None:
    """The folder is clean; of what the dead one was about, no more is left than one file under no name of its own."""
    verdict = check(place.run)
    assert verdict.exit_code == 0, str(verdict)
    left = [path.name for path in place.disk.rglob("*") if ".part" in path.name or path.suffix == ".tmp"]
    assert len(left) <= died, f"left over: {left}"
    assert all(".partial" in name and f".{os.getpid()}." not in name for name in left), f"left over: {left}"
    with closing(Ledger(place.run.ledger)) as ledger:
        events = list(ledger.events())
    # A line is on its way to the disk before the ledger has it: the log may know more, and never less.
    log = iter(read_events(place.run.events))
    assert all(event in log for event in events), "the log lacks an event of the ledger, or has it elsewhere"


def result(place: Place) -> dict[str, Any]:
    """What a death must not change."""
    devices, state = place.devices, json.loads(place.run.state.read_text())
    with closing(Ledger(place.run.ledger)) as ledger:
        jobs = [[row.kind, row.name, row.how, _without_place(row.outcome, place)] for row in ledger.jobs()]
    return {
        "scans": [scan["scan_id"] for scan in state["scans"]],
        "scans taken": list(devices.taken),
        "goals begun": [(drive.goal.goal_id, drive.goal.x, drive.goal.y) for drive in devices.drives],
        "jobs": jobs,
        "maps": dict(_arrays(place.run)),
        "figures": _without_the_day(state),
    }


def _without_place(told: str | None, place: Place) -> str:
    return str(told).replace(str(place.disk), "")


def _arrays(run: RunFolder) -> Iterator[tuple[str, str]]:
    """Every array file that is seen under its name, and a hash of what is in it."""
    for path in sorted(run.path.rglob("*.npz")):
        if ".partial" not in path.name:
            with np.load(path) as archive:
                content = b"".join(name.encode() + archive[name].tobytes() for name in sorted(archive.files))
            yield str(path.relative_to(run.path)), hashlib.sha256(content).hexdigest()


def _without_the_day(told: Any) -> Any:
    if isinstance(told, dict):
        return {name: _without_the_day(value) for name, value in told.items() if name not in _OF_THE_DAY}
    return [_without_the_day(value) for value in told] if isinstance(told, list) else told
