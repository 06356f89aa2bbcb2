"""What a mission did is told to the lives that take it up: the second, and those after it."""

from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Any

from drivers.jobs import Done, Failed, Job, Outcome
from drivers.simulated.clock import VirtualClock
from mission.chronicle import Chronicle
from mission.ledger import Ledger
from tests.behaviours.bench import HandJob


def ended(value: object) -> HandJob:
    job = HandJob()
    job.done(value)
    return job


@contextmanager
def life(folder: Path) -> Iterator[tuple[Chronicle, Ledger]]:
    with closing(Ledger(folder / "mission.db")) as ledger:
        chronicle = Chronicle(ledger, VirtualClock())
        chronicle.release()
        yield chronicle, ledger


def end_of(job: Job[Any]) -> Outcome[Any]:
    """Known outcomes are told one tick late."""
    job.poll()
    return job.poll()


def given_up(folder: Path, kind: str) -> None:
    """A life that ends while it is about a job."""
    with life(folder) as (chronicle, ledger):
        chronicle.begin(kind, "it", HandJob).cancel()
        assert [row.how for row in ledger.jobs()] == ["cancelled"]


def test_a_job_that_was_given_up_is_done_by_the_next_life_and_told_to_the_one_after(tmp_path: Path) -> None:
    given_up(tmp_path, "fetch")
    with life(tmp_path) as (chronicle, ledger):
        assert chronicle.begin("fetch", "it", lambda: ended("home")).poll() == Done("home")
        assert [row.how for row in ledger.jobs()] == ["done"]
    with life(tmp_path) as (chronicle, _):
        assert end_of(chronicle.begin("fetch", "it", HandJob)) == Done("home")


def test_a_drive_that_was_given_up_is_an_interrupted_one_to_every_life(tmp_path: Path) -> None:
    given_up(tmp_path, "drive")
    for _ in range(2):
        with life(tmp_path) as (chronicle, ledger):
            told = end_of(chronicle.begin("drive", "it", HandJob))
            assert isinstance(told, Failed) and told.failure.code == "NAV_INTERRUPTED"
            other = chronicle.begin("drive", "another way", lambda: ended("there"))
            assert end_of(other) == Done("there")
            assert [row.how for row in ledger.jobs()] == ["failed", "done"]
