"""The leaf for remote and background work: it starts, polls, and never leaves a job behind."""

from typing import Any

import pytest
from py_trees.common import Status

from behaviours.job import JobLeaf
from behaviours.keys import Key
from drivers.jobs import Job, Running
from perception.failure import FailureError
from tests.behaviours.bench import Bench, get, tick


class Stopping(JobLeaf):
    """Asks the base to stop, which takes a job."""

    timeout_code = "STOP_TIMEOUT"

    def __init__(self, limit: float | None = None) -> None:
        super().__init__("stopping")
        self.limit = limit
        self.values: list[Any] = []

    def start(self) -> Job[Any]:
        return self.services.base.stop()

    def timeout(self) -> float | None:
        return self.limit

    def finish(self, value: Any) -> Status:
        self.values.append(value)
        return Status.SUCCESS


def begun(limit: float | None = None) -> tuple[Bench, Stopping]:
    bench, leaf = Bench(), Stopping(limit)
    bench.set_up(leaf)
    assert tick(leaf) == Status.RUNNING
    return bench, leaf


def test_it_runs_until_the_job_is_done_and_takes_its_value() -> None:
    bench, leaf = begun()
    assert tick(leaf) == Status.RUNNING
    bench.job.done("value")
    assert tick(leaf) == Status.SUCCESS
    assert (leaf.values, len(bench.jobs), bench.job.cancelled) == (["value"], 1, 0)


def test_a_failed_job_fails_it_with_the_jobs_own_code() -> None:
    bench, leaf = begun()
    bench.job.failed("AGENT_UNREACHABLE", endpoint="tcp://there")
    assert tick(leaf) == Status.FAILURE
    assert get(Key.FAILURE).evidence == {"endpoint": "tcp://there"}
    assert bench.job.cancelled == 0


def test_it_tells_how_far_the_job_is() -> None:
    bench, leaf = begun()
    bench.job.outcome = Running(0.25, "spinning")
    tick(leaf)
    assert leaf.feedback_message == "25 % spinning"


def test_an_interruption_cancels_the_job_once() -> None:
    bench, leaf = begun()
    leaf.stop(Status.INVALID)
    leaf.stop(Status.INVALID)
    assert bench.job.cancelled == 1


def test_a_leaf_that_was_never_begun_can_be_stopped() -> None:
    Stopping().stop(Status.INVALID)


def test_a_finished_job_is_not_cancelled_when_the_leaf_is_invalidated() -> None:
    bench, leaf = begun()
    bench.job.done()
    tick(leaf)
    leaf.stop(Status.INVALID)
    assert bench.job.cancelled == 0


def test_the_deadline_counts_in_mission_time_and_cancels() -> None:
    bench, leaf = begun(limit=60.0)
    bench.clock.sleep(60.0)
    assert tick(leaf) == Status.RUNNING
    bench.clock.sleep(0.1)
    assert tick(leaf) == Status.FAILURE
    assert (bench.codes, bench.job.cancelled) == (["STOP_TIMEOUT"], 1)


def test_the_deadline_counts_anew_for_each_job() -> None:
    bench, leaf = begun(limit=60.0)
    bench.clock.sleep(100.0)
    tick(leaf)
    assert tick(leaf) == Status.RUNNING
    assert len(bench.jobs) == 2


def test_a_job_that_is_done_in_time_is_not_too_late_because_nobody_asked() -> None:
    bench, leaf = begun(limit=60.0)
    bench.clock.sleep(100.0)
    bench.job.done()
    assert tick(leaf) == Status.SUCCESS


@pytest.mark.parametrize("broken", ["poll", "finish"])
def test_an_exception_while_polling_leaves_no_job_behind(broken: str, monkeypatch: pytest.MonkeyPatch) -> None:
    bench, leaf = begun()

    def breaks(*_: object) -> None:
        raise OSError("gone")

    bench.job.done()
    monkeypatch.setattr(bench.job if broken == "poll" else leaf, broken, breaks)
    assert tick(leaf) == Status.FAILURE
    assert bench.codes == ["LEAF_EXCEPTION"]
    assert bench.job.cancelled == (1 if broken == "poll" else 0)


def test_a_job_that_cannot_be_started_is_a_failure(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuses() -> Job[Any]:
        raise FailureError("BASE_LOST", "nobody there")

    leaf = Stopping()
    bench = Bench()
    bench.set_up(leaf)
    monkeypatch.setattr(leaf, "start", refuses)
    assert tick(leaf) == Status.FAILURE
    assert bench.codes == ["BASE_LOST"]
    leaf.stop(Status.INVALID)
