"""The process that stages run in: spawned, another in its place where it dies at work, and asked for its memory."""

import os
import signal
import threading
import time
from collections.abc import Callable, Sequence
from ctypes import c_int
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from pebble import ProcessPool

NICENESS = 5
"""The tick loop, whose beats keep the base going, wins a core from the worker; an idle one is all the worker's."""

_GLANCE_S = 0.5
"""How often the worker looks whether its executive still lives."""


class WorkerProcess:
    """One process at a time, which is begun when it is first asked for, and does one call after another."""

    def __init__(self) -> None:
        context = get_context("spawn")
        self._pid: c_int = context.RawValue(c_int, 0)
        self._pool = ProcessPool(1, initializer=_settle, initargs=[self._pid], context=context)

    @property
    def lives(self) -> bool:
        """Whether its calls will be done. One that dies at work has a successor; one that dies idle takes all along."""
        return bool(self._pool.active)

    @property
    def memory_gb(self) -> float:
        """Resident just now; 0 where there is no process yet, or nobody can tell."""
        try:
            resident = Path(f"/proc/{self._pid.value}/statm").read_text(encoding="ascii").split()[1]
        except OSError:
            return 0.0
        return int(resident) * os.sysconf("SC_PAGE_SIZE") / 1e9

    def schedule(self, call: Callable[..., Any], arguments: Sequence[object], timeout: float) -> Any:
        """A future of what the call returns; one that is cancelled, or lasts longer, while under way is killed."""
        return self._pool.schedule(call, args=arguments, timeout=timeout)

    def end(self) -> threading.Thread:
        """Kill whatever runs. It is gone, with its memory, when the thread is."""
        self._pool.stop()
        thread = threading.Thread(target=self._pool.join, daemon=True)
        thread.start()
        return thread


def _settle(pid: c_int) -> None:
    """In the worker's process, before its first stage."""
    # Ctrl-C reaches every process of a terminal; whether a stage ends for it is the mission's to say.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(NICENESS)
    pid.value = os.getpid()
    threading.Thread(target=_end_with, args=[os.getppid()], daemon=True).start()


def _end_with(executive: int) -> None:
    """A stage whose executive was killed would end in nobody's hands, beside that of the one that took its place."""
    while os.getppid() == executive:
        time.sleep(_GLANCE_S)
    os.kill(os.getpid(), signal.SIGKILL)
