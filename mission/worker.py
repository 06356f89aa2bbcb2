"""The perception worker: one stage at a time in a process that is made anew when it hangs, dies or grows too large."""

import threading
import time
from collections.abc import Mapping
from concurrent.futures import CancelledError
from concurrent.futures import TimeoutError as DeadlineError
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

from pebble import ProcessExpired

from behaviours.services import Journal
from behaviours.settings import WorkerSettings
from drivers.jobs import Done, Failed, Job, Outcome, Running
from mission.worker_process import WorkerProcess
from perception.failure import Failure, FailureError

NAME = "perception worker"
_ATTEMPTS, _LIVES = 2, 3
"""How often a stage is tried that hangs or takes too much memory, which it would again; and one whose process dies."""


class PerceptionWorker:
    """Runs the stages of :mod:`mission.stages` on the files of a run.

    Open3D holds the interpreter's lock for seconds, so no stage ever runs in the process that ticks the tree.

    Args:
        run: the run folder, which both processes see.
        journal: gets one ``stage`` event for every stage that ended, with its seconds, and a ``failure`` with
            ``MEM_HIGH`` whenever a process is ended for its memory.
        settings: how much memory its process may have.
        deadline: wall seconds a stage may take before its process is killed.
    """

    def __init__(
        self, run: Path, journal: Journal, settings: WorkerSettings | None = None, deadline: float = 180.0
    ) -> None:
        self._run = run
        self._journal = journal
        self._settings = settings or WorkerSettings()
        self._deadline = deadline
        self._process = WorkerProcess()
        self._ending: list[threading.Thread] = []
        self._newest: _StageJob | None = None

    def submit(self, stage: str, /, **arguments: object) -> Job[Any]:
        self._newest = _StageJob(self, stage, arguments)
        return self._newest

    def watch(self) -> None:
        """Look after the stage under way while nobody asks for it, as in a pause."""
        if self._newest is not None:
            self._newest.watch()

    def schedule(self, stage: str, arguments: Mapping[str, object]) -> tuple[Any, WorkerProcess]:
        """A future of (value, seconds), and the process that it will never come from if that does not live."""
        if not self._process.lives:
            self._replace()
        call = [str(self._run), stage, dict(arguments)]
        return self._process.schedule(_run_stage, call, timeout=self._deadline), self._process

    def has_outgrown(self, process: WorkerProcess, stage: str) -> bool:
        """Whether a process has more memory than the machine is to lose to it, and so must not go on."""
        return self._exceeds(process, self._settings.memory_cap_gb, f"during {stage}; it is killed")

    def ended(self, stage: str, arguments: Mapping[str, object], seconds: float, why: Failure | None) -> None:
        """Note a stage that came to its end, or never will."""
        ids = {key: arguments[key] for key in ("scan_id", "room_id", "cycle") if key in arguments}
        self._journal.record("stage", name=stage, seconds=round(seconds, 4), failure=why and why.code, **ids)

    def has_lived_through(self, process: WorkerProcess, stage: str) -> None:
        """Let a process that has grown large do no other stage."""
        limit = self._settings.memory_high_gb
        if process is self._process and self._exceeds(process, limit, f"after {stage}; another takes its place"):
            self._replace()

    def close(self) -> None:
        """Kill whatever runs and leave no process behind."""
        for thread in (*self._ending, self._process.end()):
            thread.join()

    def _replace(self) -> None:
        self._ending = [thread for thread in (*self._ending, self._process.end()) if thread.is_alive()]
        self._process = WorkerProcess()

    def _exceeds(self, process: WorkerProcess, limit: float, when: str) -> bool:
        used = process.memory_gb
        if used <= limit:
            return False
        why = f"the worker has {used:.2f} GB, more than {limit:g} GB, {when}"
        failure = Failure("MEM_HIGH", why, {"used_gb": round(used, 3), "limit_gb": limit})
        self._journal.record(
            "failure", leaf=NAME, code=failure.code, message=failure.message, evidence=dict(failure.evidence)
        )
        return True


class _StageJob:
    """A stage under way; it is begun again where its process hung, or died under it, a few times in all."""

    def __init__(self, worker: PerceptionWorker, stage: str, arguments: Mapping[str, object]) -> None:
        self._worker = worker
        self._stage = stage
        self._arguments = arguments
        self._attempts = 1
        self._outgrown = False
        self._outcome: Outcome[Any] | None = None
        self._began = time.monotonic()
        self._future, self._process = worker.schedule(stage, arguments)

    def poll(self) -> Outcome[Any]:
        if self._outcome is None:
            self.watch()
            if self._future.done() or not self._process.lives:
                self._outcome = self._conclude()
        if self._outcome is not None:
            return self._outcome
        return Running(None, f"{time.monotonic() - self._began:.1f} s")

    def cancel(self) -> None:
        self._outgrown = False
        self._future.cancel()

    def watch(self) -> None:
        """End a stage that outgrows the machine before the kernel does, which may choose any process."""
        if self._future.running() and self._worker.has_outgrown(self._process, self._stage):
            self._outgrown = self._future.cancel()

    def _conclude(self) -> Outcome[Any] | None:
        try:
            value, seconds = self._result()
        except CancelledError:
            if self._outgrown:
                words = f"the worker was killed for its memory during {self._stage}"
                return self._again_or(Failure("PERC_DIED", words), _ATTEMPTS)
            return Failed(Failure("CANCELLED", f"{self._stage} was cancelled"))
        except FailureError as error:
            return self._failed(error.failure)
        except DeadlineError:
            return self._again_or(Failure("PERC_TIMEOUT", f"{self._stage} did not end within its deadline"), _ATTEMPTS)
        except (ProcessExpired, BrokenProcessPool) as error:
            return self._again_or(Failure("PERC_DIED", f"the worker died during {self._stage}: {error}"), _LIVES)
        except Exception as error:
            trace = getattr(error, "traceback", "")
            return self._failed(
                Failure("PERC_EXCEPTION", f"{self._stage}: {type(error).__name__}: {error}", {"traceback": trace})
            )
        self._ended(seconds, None)
        return Done(value)

    def _result(self) -> tuple[Any, float]:
        if not self._future.done():
            raise BrokenProcessPool("before it began")
        value, seconds = self._future.result()
        return value, seconds

    def _failed(self, failure: Failure) -> Outcome[Any]:
        self._ended(time.monotonic() - self._began, failure)
        return Failed(failure)

    def _ended(self, seconds: float, why: Failure | None) -> None:
        self._worker.ended(self._stage, self._arguments, seconds, why)
        self._worker.has_lived_through(self._process, self._stage)

    def _again_or(self, failure: Failure, most: int) -> Outcome[Any] | None:
        if self._attempts >= most:
            self._worker.ended(self._stage, self._arguments, time.monotonic() - self._began, failure)
            return Failed(failure)
        self._attempts += 1
        self._outgrown = False
        self._future, self._process = self._worker.schedule(self._stage, self._arguments)
        return None


def _run_stage(run: str, stage: str, arguments: dict[str, Any]) -> tuple[Any, float]:
    """In the worker's process: look the stage up, run it, and say how long it took."""
    from mission import stages

    began = time.perf_counter()
    value = stages.run(stages.scans_of(Path(run)), stage, arguments)
    return value, time.perf_counter() - began
