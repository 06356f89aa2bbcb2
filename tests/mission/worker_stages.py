"""Stages for a worker that does not load the real ones: cheap, and as bad as a test wants them."""

import os
import signal
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from mission import worker as module
from perception.failure import FailureError

_HOARD: list[bytes] = []


def run_stage(run: str, stage: str, arguments: dict[str, Any]) -> tuple[Any, float]:
    """What the worker's process calls, in place of :func:`mission.worker._run_stage`."""
    return STAGES[stage](Path(run), **arguments), 0.125


def lead(run: Path) -> None:
    """An executive whose worker hangs."""
    module._run_stage = run_stage
    job = module.PerceptionWorker(run, SimpleNamespace(record=print)).submit("hang")
    while True:
        job.poll()
        time.sleep(0.1)


def add(run: Path, a: int, b: int, **_: Any) -> int:
    return a + b


def process_id(run: Path) -> int:
    return os.getpid()


def niceness(run: Path) -> int:
    return os.nice(0)


def refuse(run: Path, **_: Any) -> None:
    raise FailureError("REG_DEGENERATE", "slides along the corridor", min_eigenvalue=0.001)


def break_down(run: Path) -> None:
    raise ZeroDivisionError("a bug")


def die(run: Path, times: int) -> str:
    """The process is killed the first so many times."""
    deaths = run / "deaths"
    count = len(deaths.read_text()) if deaths.exists() else 0
    if count < times:
        deaths.write_text("x" * (count + 1))
        os.kill(os.getpid(), signal.SIGKILL)
    return f"alive after {count}"


def hang(run: Path) -> None:
    (run / "hanging").write_text(str(os.getpid()))
    time.sleep(60)


def hoard(run: Path, gb: float) -> int:
    """It takes memory that it never gives back."""
    _HOARD.append(b"x" * int(gb * 1e9))
    return os.getpid()


def burst(run: Path, gb: float, times: int) -> str:
    """It takes memory, and goes on for long with that, the first so many times."""
    bursts = run / "bursts"
    count = len(bursts.read_text().split()) if bursts.exists() else 0
    if count < times:
        with bursts.open("a") as stream:
            stream.write(f"{os.getpid()}\n")
        hoard(run, gb)
        time.sleep(60)
    return f"ended after {count}"


def open_what_is_not_there(run: Path) -> None:
    (run / "M07.npz").open()


STAGES = {
    "add": add,
    "process_id": process_id,
    "niceness": niceness,
    "refuse": refuse,
    "break_down": break_down,
    "die": die,
    "hang": hang,
    "hoard": hoard,
    "burst": burst,
    "open_what_is_not_there": open_what_is_not_there,
}
