"""The perception worker: a real spawned process that may fail, die or hang without taking the mission along."""

import multiprocessing
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from behaviours.settings import WorkerSettings
from drivers.jobs import Done, Failed, Job, Running
from mission import worker as module
from mission.worker import PerceptionWorker
from mission.worker_process import NICENESS, WorkerProcess
from perception.failure import Failure
from tests.mission import worker_stages

HIGH_GB = 0.4
"""More than a worker has that has done nothing yet."""


@pytest.fixture
def events() -> list[dict[str, Any]]:
    return []


@pytest.fixture
def settings() -> WorkerSettings:
    return WorkerSettings()


@pytest.fixture
def worker(
    tmp_path: Path, events: list[dict[str, Any]], settings: WorkerSettings, monkeypatch: pytest.MonkeyPatch
) -> Iterator[PerceptionWorker]:
    monkeypatch.setattr(module, "_run_stage", worker_stages.run_stage)
    journal = SimpleNamespace(record=lambda kind, /, **figures: events.append({"kind": kind, **figures}))
    worker = PerceptionWorker(tmp_path, journal, settings)
    yield worker
    worker.close()


def outcome_of(job: Job[Any], seconds: float = 30.0) -> Done[Any] | Failed:
    end = time.monotonic() + seconds
    while isinstance(outcome := job.poll(), Running):
        assert time.monotonic() < end, "it does not end"
        time.sleep(0.005)
    return outcome


def failure_of(job: Job[Any]) -> Failure:
    outcome = outcome_of(job)
    assert isinstance(outcome, Failed)
    return outcome.failure


def value_of(job: Job[Any]) -> Any:
    outcome = outcome_of(job)
    assert isinstance(outcome, Done), outcome
    return outcome.value


def eventually(holds: Callable[[], object]) -> None:
    end = time.monotonic() + 20
    while not holds():
        assert time.monotonic() < end, "it does not happen"
        time.sleep(0.01)


def eventually_dead(process: int) -> None:
    eventually(lambda: not is_alive(process))


def is_alive(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    return True


def wait_for(path: Path) -> int:
    end = time.monotonic() + 20
    while not (path.exists() and path.read_text()):
        assert time.monotonic() < end
        time.sleep(0.01)
    return int(path.read_text())


def test_a_stage_runs_in_one_process_of_its_own_and_is_on_record(
    worker: PerceptionWorker, events: list[dict[str, Any]]
) -> None:
    job = worker.submit("add", a=2, b=3, scan_id="S01", room_id="R1", cycle=2)
    assert isinstance(job.poll(), Running)
    assert outcome_of(job) == Done(5)
    assert job.poll() == Done(5), "asked again, it answers the same"
    ids = {"scan_id": "S01", "room_id": "R1", "cycle": 2}
    assert events == [{"kind": "stage", "name": "add", "seconds": 0.125, "failure": None, **ids}]
    first, second = (outcome_of(worker.submit("process_id")) for _ in range(2))
    assert first == second != Done(os.getpid())


def test_the_tick_loop_goes_before_the_worker_on_a_busy_core(worker: PerceptionWorker) -> None:
    found = outcome_of(worker.submit("niceness"))
    assert isinstance(found, Done)
    assert found.value == min(os.nice(0) + NICENESS, 19) > os.nice(0)


def test_a_stage_that_refuses_comes_back_with_its_code_and_evidence(
    worker: PerceptionWorker, events: list[dict[str, Any]]
) -> None:
    failure = failure_of(worker.submit("refuse", scan_id="S02"))
    assert failure == Failure("REG_DEGENERATE", "slides along the corridor", {"min_eigenvalue": 0.001})
    assert [(event["failure"], event["scan_id"]) for event in events] == [("REG_DEGENERATE", "S02")]
    bug = failure_of(worker.submit("break_down"))
    assert bug.code == "PERC_EXCEPTION"
    assert "ZeroDivisionError: a bug" in bug.message
    assert "break_down" in str(bug.evidence["traceback"])
    assert failure_of(worker.submit("no such stage")).code == "PERC_EXCEPTION"


def test_a_stage_whose_process_dies_has_three_lives_and_no_fourth(
    worker: PerceptionWorker, events: list[dict[str, Any]], tmp_path: Path
) -> None:
    assert outcome_of(worker.submit("die", times=2)) == Done("alive after 2")
    (tmp_path / "deaths").unlink()
    assert failure_of(worker.submit("die", times=9)).code == "PERC_DIED"
    assert (tmp_path / "deaths").read_text() == "xxx"
    assert [event["failure"] for event in events] == [None, "PERC_DIED"]
    assert outcome_of(worker.submit("add", a=1, b=1)) == Done(2), "the next stage has a process again"


@pytest.mark.parametrize("pause", [0.0, 0.5], ids=["at once", "later"])
def test_a_process_that_is_killed_while_it_has_nothing_to_do_is_replaced(
    worker: PerceptionWorker, pause: float
) -> None:
    for _ in range(3):
        idle = outcome_of(worker.submit("process_id"))
        assert isinstance(idle, Done)
        os.kill(idle.value, signal.SIGKILL)
        time.sleep(pause)
        assert outcome_of(worker.submit("add", a=1, b=1)) == Done(2)
    assert [process.pid for process in multiprocessing.active_children() if process.pid == idle.value] == []


def test_a_stage_that_hangs_is_killed_at_its_deadline(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, events: list[dict[str, Any]]
) -> None:
    monkeypatch.setattr(module, "_run_stage", worker_stages.run_stage)
    journal = SimpleNamespace(record=lambda kind, /, **figures: events.append({"kind": kind, **figures}))
    worker = PerceptionWorker(tmp_path, journal, deadline=0.5)
    try:
        assert failure_of(worker.submit("hang")).code == "PERC_TIMEOUT"
        assert not is_alive(wait_for(tmp_path / "hanging"))
    finally:
        worker.close()


def test_a_cancelled_stage_is_killed_and_the_next_one_runs(worker: PerceptionWorker, tmp_path: Path) -> None:
    job = worker.submit("hang")
    process = wait_for(tmp_path / "hanging")
    job.cancel()
    job.cancel()
    assert failure_of(job).code == "CANCELLED"
    assert outcome_of(worker.submit("add", a=1, b=1)) == Done(2)
    assert not is_alive(process)


@pytest.mark.parametrize("settings", [WorkerSettings(memory_high_gb=HIGH_GB)])
def test_a_worker_that_keeps_too_much_memory_is_replaced_between_two_stages(
    worker: PerceptionWorker, events: list[dict[str, Any]]
) -> None:
    slim, large = (value_of(worker.submit("hoard", gb=gb)) for gb in (0.01, HIGH_GB))
    assert slim == large, "one that keeps little stays"
    told = [event for event in events if event["kind"] == "failure"]
    assert [(event["code"], event["evidence"]["limit_gb"]) for event in told] == [("MEM_HIGH", HIGH_GB)]
    assert HIGH_GB < told[0]["evidence"]["used_gb"] < 2 * HIGH_GB + 0.2
    fresh = value_of(worker.submit("process_id"))
    assert fresh not in (large, os.getpid())
    assert value_of(worker.submit("process_id")) == fresh
    eventually_dead(large)
    assert [event["failure"] for event in events if event["kind"] == "stage"] == [None] * 4, "no result was lost"


@pytest.mark.parametrize("settings", [WorkerSettings(HIGH_GB, HIGH_GB)])
def test_a_stage_that_nobody_asks_for_is_killed_for_its_memory_too(
    worker: PerceptionWorker, events: list[dict[str, Any]], tmp_path: Path
) -> None:
    """In a pause no leaf asks for its stage, and it goes on."""
    worker.watch()
    worker.submit("burst", gb=2 * HIGH_GB, times=9)
    eventually(lambda: worker.watch() or any(event.get("code") == "MEM_HIGH" for event in events))
    for victim in map(int, (tmp_path / "bursts").read_text().split()):
        eventually_dead(victim)


@pytest.mark.parametrize("settings", [WorkerSettings(HIGH_GB, HIGH_GB)])
@pytest.mark.parametrize(("times", "codes"), [(1, ["MEM_HIGH"]), (9, ["MEM_HIGH", "MEM_HIGH"])], ids=["once", "again"])
def test_a_stage_that_outgrows_its_cap_is_killed_and_gets_a_second_chance_and_no_third(
    worker: PerceptionWorker, events: list[dict[str, Any]], tmp_path: Path, times: int, codes: list[str]
) -> None:
    outcome = outcome_of(worker.submit("burst", gb=2 * HIGH_GB, times=times))
    if times == 1:
        assert outcome == Done("ended after 1")
    else:
        assert isinstance(outcome, Failed) and outcome.failure.code == "PERC_DIED"
    assert [event["code"] for event in events if event["kind"] == "failure"] == codes
    victims = (tmp_path / "bursts").read_text().split()
    assert len(set(victims)) == len(codes)
    for victim in map(int, victims):
        eventually_dead(victim)
    assert outcome_of(worker.submit("add", a=1, b=1)) == Done(2)


@pytest.mark.parametrize("settings", [WorkerSettings(memory_high_gb=HIGH_GB)])
def test_closing_leaves_no_process_of_those_that_were_replaced(worker: PerceptionWorker) -> None:
    large = value_of(worker.submit("hoard", gb=HIGH_GB))
    worker.close()
    assert not is_alive(large)
    assert multiprocessing.active_children() == []


def test_a_machine_that_tells_nobodys_memory_replaces_nobody(tmp_path: Path) -> None:
    """As one without /proc, and as any before the first stage."""
    process = WorkerProcess()
    assert process.memory_gb == 0.0
    process.end().join()


def test_closing_leaves_no_process_behind_even_in_the_middle_of_a_stage(
    worker: PerceptionWorker, tmp_path: Path
) -> None:
    worker.submit("hang")
    process = wait_for(tmp_path / "hanging")
    worker.close()
    assert not is_alive(process)
    assert multiprocessing.active_children() == []


def test_a_worker_does_not_outlive_an_executive_that_is_killed(tmp_path: Path) -> None:
    lead = "import sys, pathlib; from tests.mission.worker_stages import lead; lead(pathlib.Path(sys.argv[1]))"
    executive = subprocess.Popen([sys.executable, "-c", lead, str(tmp_path)], cwd=Path(__file__).parents[2])
    process = wait_for(tmp_path / "hanging")
    executive.kill()
    executive.wait()
    end = time.monotonic() + 20
    while is_alive(process):
        assert time.monotonic() < end, "its worker works on"
        time.sleep(0.05)


def test_a_stage_that_misses_a_file_is_no_dead_worker(worker: PerceptionWorker) -> None:
    failure = failure_of(worker.submit("open_what_is_not_there"))
    assert failure.code == "PERC_EXCEPTION"
    assert "M07.npz" in failure.message
