"""The perception worker: one spawned process, one stage at a time, killed and made anew when it hangs or dies."""

import os
import signal
import threading
import time
from collections.abc import Mapping
from concurrent.futures import CancelledError
from concurrent.futures import TimeoutError as DeadlineError
from concurrent.futures.process import BrokenProcessPool
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from pebble import ProcessExpired, ProcessPool

from behaviours.services import Journal
from drivers.jobs import Done, Failed, Job, Outcome, Running
from perception.failure import Failure, FailureError

NICENESS = 5
"""The tick loop, whose beats keep the base going, wins a core from the worker; an idle one is all the worker's."""

_GLANCE_S = 0.5
"""How often the worker looks whether its executive still lives."""


class PerceptionWorker:
    """Runs the stages of :mod:`mission.stages` on the files of a run.

    Open3D holds the interpreter's lock for seconds, so no stage ever runs in the process that ticks the tree.

    Args:
        run: the run folder, which both processes see.
        journal: gets one ``stage`` event for every stage that ended, with its seconds.
        deadline: wall seconds a stage may take before its process is killed.
    """

    def __init__(self, run: Path, journal: Journal, deadline: float = 180.0) -> None:
        self._run = run
        self._journal = journal
        self._deadline = deadline
        self._pool = _new_pool()

    def submit(self, stage: str, /, **arguments: object) -> Job[Any]:
        return _StageJob(self, stage, arguments)

    def schedule(self, stage: str, arguments: Mapping[str, object]) -> tuple[Any, ProcessPool]:
        """A future of (value, seconds), and the pool that it will never come from if that pool breaks.

        The pool brings a new process if the last one died at work. One that dies while it has none takes its pool
        along, and gets another.
        """
        if not self._pool.active:
            broken, self._pool = self._pool, _new_pool()
            broken.stop()
            threading.Thread(target=broken.join, daemon=True).start()
        call = [str(self._run), stage, dict(arguments)]
        return self._pool.schedule(_run_stage, args=call, timeout=self._deadline), self._pool

    def record(self, stage: str, arguments: Mapping[str, object], seconds: float, failure: Failure | None) -> None:
        ids = {key: arguments[key] for key in ("scan_id", "room_id", "cycle") if key in arguments}
        self._journal.record("stage", name=stage, seconds=round(seconds, 4), failure=failure and failure.code, **ids)

    def close(self) -> None:
        """Kill whatever runs and leave no process behind."""
        self._pool.stop()
        self._pool.join()


class _StageJob:
    """A stage under way; a process that died under it is given one more chance."""

    def __init__(self, worker: PerceptionWorker, stage: str, arguments: Mapping[str, object]) -> None:
        self._worker = worker
        self._stage = stage
        self._arguments = arguments
        self._chances = 2
        self._outcome: Outcome[Any] | None = None
        self._began = time.monotonic()
        self._future, self._pool = worker.schedule(stage, arguments)

    def poll(self) -> Outcome[Any]:
        if self._outcome is None and (self._future.done() or not self._pool.active):
            self._outcome = self._conclude()
        if self._outcome is not None:
            return self._outcome
        return Running(None, f"{time.monotonic() - self._began:.1f} s")

    def cancel(self) -> None:
        self._future.cancel()

    def _conclude(self) -> Outcome[Any] | None:
        try:
            value, seconds = self._result()
        except CancelledError:
            return Failed(Failure("CANCELLED", f"{self._stage} was cancelled"))
        except FailureError as error:
            return self._failed(error.failure)
        except DeadlineError:
            return self._again_or(Failure("PERC_TIMEOUT", f"{self._stage} did not end within its deadline"))
        except (ProcessExpired, BrokenProcessPool) as error:
            return self._again_or(Failure("PERC_DIED", f"the worker died during {self._stage}: {error}"))
        except Exception as error:
            trace = getattr(error, "traceback", "")
            return self._failed(
                Failure("PERC_EXCEPTION", f"{self._stage}: {type(error).__name__}: {error}", {"traceback": trace})
            )
        self._worker.record(self._stage, self._arguments, seconds, None)
        return Done(value)

    def _result(self) -> tuple[Any, float]:
        if not self._future.done():
            raise BrokenProcessPool("before it began")
        value, seconds = self._future.result()
        return value, seconds

    def _failed(self, failure: Failure) -> Outcome[Any]:
        self._worker.record(self._stage, self._arguments, time.monotonic() - self._began, failure)
        return Failed(failure)

    def _again_or(self, failure: Failure) -> Outcome[Any] | None:
        self._chances -= 1
        if self._chances == 0:
            return self._failed(failure)
        self._future, self._pool = self._worker.schedule(self._stage, self._arguments)
        return None


def _settle() -> None:
    """In the worker's process, before its first stage."""
    # Ctrl-C reaches every process of a terminal; whether a stage ends for it is the mission's to say.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(NICENESS)
    threading.Thread(target=_end_with, args=[os.getppid()], daemon=True).start()


def _end_with(executive: int) -> None:
    """A stage whose executive was killed would end in nobody's hands, beside that of the one that took its place."""
    while os.getppid() == executive:
        time.sleep(_GLANCE_S)
    os.kill(os.getpid(), signal.SIGKILL)


def _new_pool() -> ProcessPool:
    return ProcessPool(1, initializer=_settle, context=get_context("spawn"))


def _run_stage(run: str, stage: str, arguments: dict[str, Any]) -> tuple[Any, float]:
    """In the worker's process: look the stage up, run it, and say how long it took."""
    from mission import stages

    began = time.perf_counter()
    value = stages.run(stages.scans_of(Path(run)), stage, arguments)
    return value, time.perf_counter() - began
