"""Seconds and memory of a call, and the one table that all benchmarks share."""

import statistics
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

HEAD = (
    "stage",
    "paper",
    "bar",
    "ours: wall s",
    "processor s",
    "alternative",
    "its wall s",
    "ours : it",
    "peak MB",
    "",
)


@dataclass
class Runs:
    """Wall and processor seconds of several calls of one thing, and what memory the largest took, megabytes."""

    wall: list[float] = field(default_factory=list)
    processor: list[float] = field(default_factory=list)
    peak: float = 0.0

    def time(self, call: Callable[..., Any], *arguments: Any, **options: Any) -> Any:
        """Call, and note what it took."""
        before = _forget_peak()
        wall, processor = time.perf_counter(), time.process_time()
        value = call(*arguments, **options)
        self.wall.append(time.perf_counter() - wall)
        self.processor.append(time.process_time() - processor)
        self.peak = max(self.peak, _status("VmHWM") - before)
        return value


@dataclass(frozen=True)
class Row:
    """One line of the table: what a stage took in the paper and may take here, ours and one alternative, seconds."""

    stage: str
    paper: str
    bar: str
    ours: Runs
    alternative: str = ""
    theirs: Runs | None = None
    remark: str = ""

    def cells(self) -> list[str]:
        wall, processor = statistics.median(self.ours.wall), statistics.median(self.ours.processor)
        theirs = statistics.median(self.theirs.wall) if self.theirs and self.theirs.wall else None
        return [
            self.stage,
            self.paper,
            self.bar,
            f"{wall:.3f}",
            f"{processor:.3f}",
            self.alternative,
            "" if theirs is None else f"{theirs:.3f}",
            "" if theirs is None else f"{wall / theirs:.2g}",
            f"{self.ours.peak:.0f}" if self.ours.peak else "",
            self.remark,
        ]


def table(rows: Iterable[list[str]]) -> str:
    """Markdown of rows with the cells of :meth:`Row.cells`."""
    lines = [list(HEAD), ["---"] * len(HEAD), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _forget_peak() -> float:
    """Begin a new maximum of the resident memory; what is resident now, megabytes."""
    Path("/proc/self/clear_refs").write_text("5")
    return _status("VmRSS")


def _status(name: str) -> float:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(float(line.split()[1]) for line in lines if line.startswith(name + ":")) / 1024
