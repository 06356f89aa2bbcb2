"""How long a tick takes, and how regularly it comes, while perception uses every core: `python -m benchmarks.tick`.

A whole mission runs with scans of five million points: its sockets, its worker, its ledger and its files. Ticks are
told apart by the leaf that runs after each; ``thinking`` are those at which it waits for a stage of the paper.
Prints milliseconds of the wall: of a tick, all that is called from it included, and from one tick to the next. The bar
is 20 ms for a tick at the 99th percentile while it thinks; ends with 1 where it is missed. What a tick lost by waiting
for a core (the kernel's own count) is told from what it lost by waiting for the interpreter's lock or the disk, for
only an idle machine is fair.

With ``--neighbours N`` as many processes that never rest run beside it, at the niceness of the worker.
"""

import argparse
import multiprocessing
import os
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from behaviours.scanning import StageLeaf
from mission import run
from mission.clock import MissionClock
from mission.executive import Executive, active_branch
from mission.rehearsal import Rehearsal, rehearse
from mission.worker_process import NICENESS
from tests.missions.flights import TWO_ROOMS

BAR_MS = 20.0
THINKING = "thinking"
FIVE_MILLION_DEG = 0.085
HEAD = ("", "ticks", "tick p50", "p99", "max", "work p99", "core p99", "lock p99", "from p50", "p99", "max")


@dataclass(frozen=True)
class Row:
    """Ticks of one kind, each in seconds: of the wall, of work, of waiting for a core; and from the one before it."""

    name: str
    wall: NDArray[np.float64]
    worked: NDArray[np.float64]
    waited: NDArray[np.float64]
    interval: NDArray[np.float64]

    @property
    def p99_ms(self) -> float:
        """Of a tick; infinite where there was none to judge by."""
        return 1000 * float(np.quantile(self.wall, 0.99)) if len(self.wall) else np.inf

    def cells(self) -> list[str]:
        if not len(self.wall):
            return [self.name, "0"]
        lost = [_p99(self.waited), _p99(self.wall - self.worked - self.waited)]
        figures = [*_quantiles(self.wall), _p99(self.worked), *lost, *_quantiles(self.interval)]
        return [self.name, str(len(self.wall)), *figures]


class Stopwatch:
    """Seen by a mission as its display: notes after each tick when it is, and what is done."""

    def __init__(self) -> None:
        self._ticks: list[tuple[str, float, NDArray[np.float64]]] = []
        self._began: NDArray[np.float64] | None = None

    def begin(self) -> None:
        """A tick begins now."""
        self._began = _seconds()

    def __call__(self, executive: Executive, newest: dict[str, Any]) -> None:
        branch = active_branch(executive.root)
        if self._began is not None and branch:
            kind = THINKING if isinstance(branch[-1], StageLeaf) else "all else"
            self._ticks.append((kind, self._began[0], _seconds() - self._began))

    def rows(self) -> Iterator[Row]:
        """A row for each kind of tick, and one for all."""
        kinds = np.array([kind for kind, _, _ in self._ticks])
        intervals = np.diff([began for _, began, _ in self._ticks], prepend=np.nan)
        wall, worked, waited = np.array([spent for _, _, spent in self._ticks]).T
        for name, of in ((THINKING, kinds == THINKING), ("all else", kinds == "all else"), ("all", kinds != "")):
            yield Row(name, wall[of], worked[of], waited[of], intervals[of])


class WatchedClock(MissionClock):
    """The mission's clock, which knows when a tick begins: when the wait before it is over."""

    watch: Stopwatch

    def sleep(self, seconds: float) -> None:
        super().sleep(seconds)
        self.watch.begin()


def measure(world: Path, step_deg: float, speed: float) -> list[Row]:
    """Rows of one simulated mission, which must be a whole one."""
    watch = WatchedClock.watch = Stopwatch()
    run.MissionClock = WatchedClock  # type: ignore[misc]
    with tempfile.TemporaryDirectory() as folder:
        plan = Rehearsal(str(world), step_deg=step_deg, speed=speed, profile="vz-400i")
        summary = rehearse(plan, Path(folder), watch)
    assert summary.outcome == "complete", f"{summary.outcome}: {summary.reason}"
    return list(watch.rows())


@contextmanager
def busy(count: int) -> Iterator[None]:
    """So many processes that compute all the time, at the niceness of a perception worker."""
    context = multiprocessing.get_context("spawn")
    processes = [context.Process(target=_spin, daemon=True) for _ in range(count)]
    for process in processes:
        process.start()
    try:
        yield
    finally:
        for process in processes:
            process.terminate()
            process.join()


def _spin() -> None:
    os.nice(NICENESS)
    value = 1.0
    while True:
        value = value * 1.0000001 % 3.0


def _seconds() -> NDArray[np.float64]:
    """Of the wall, of work of this thread, and of its waiting for a core."""
    worked, waited, _ = Path("/proc/thread-self/schedstat").read_text().split()
    return np.array([time.perf_counter(), int(worked) / 1e9, int(waited) / 1e9])


def _quantiles(seconds: NDArray[np.float64]) -> list[str]:
    return [f"{1000 * np.nanquantile(seconds, share):.1f}" for share in (0.5, 0.99, 1.0)]


def _p99(seconds: NDArray[np.float64]) -> str:
    return f"{1000 * np.quantile(seconds, 0.99):.1f}"


def kept(rows: list[Row]) -> bool:
    """Whether ticks are as quick as they must be while perception thinks."""
    return all(row.p99_ms <= BAR_MS for row in rows if row.name == THINKING)


def main() -> int:
    """0 where the bar was kept."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--step", type=float, default=FIVE_MILLION_DEG, help="degrees between beams")
    parser.add_argument("--speed", type=float, default=10.0, help="simulated seconds in one of the wall")
    parser.add_argument("--neighbours", type=int, default=0, help="processes that never rest, beside the mission")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder, busy(asked.neighbours):
        world = Path(folder) / "two-rooms.yaml"
        world.write_text(yaml.safe_dump(TWO_ROOMS))
        rows = measure(world, asked.step, asked.speed)
    print(
        f"{os.cpu_count()} cores, {asked.neighbours} neighbours; milliseconds; bar: tick p99 {BAR_MS:g} while thinking"
    )
    print("".join(f"{cell:>12}" for cell in HEAD))
    for row in rows:
        print("".join(f"{cell:>12}" for cell in row.cells()))
    if not kept(rows):
        print("THE BAR IS MISSED; 'core' is what a tick waited for one, and an idle machine lets it wait for none")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
