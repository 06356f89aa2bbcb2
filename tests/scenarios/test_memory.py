"""A worker that needs more and more memory costs the mission time, but no scan, no result and no room."""

import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from behaviours.settings import WorkerSettings
from drivers.jobs import Failed, Job, Running
from mission import worker as module
from mission.worker import PerceptionWorker
from tests.mission import worker_stages
from tests.scenarios.play import Play
from tests.scenarios.site import row

LIMIT_GB = 0.4


@pytest.fixture
def play() -> Play:
    return Play(row(1))


@pytest.fixture
def worker(play: Play, limits: WorkerSettings, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    monkeypatch.setattr(module, "_run_stage", worker_stages.run_stage)
    with closing(PerceptionWorker(tmp_path, play.events, limits)) as worker:
        yield worker


def make_hungry(play: Play, worker: PerceptionWorker, stage: str, **arguments: object) -> None:
    """Before each of its stages is played, a real process does one that takes memory."""
    played = play.perception.submit

    def submit(name: str, /, **figures: Any) -> Job[Any]:
        job = worker.submit(stage, **arguments)
        while isinstance(outcome := job.poll(), Running):
            time.sleep(0.005)
        if isinstance(outcome, Failed):
            return play.script.job(name, lambda: outcome.failure)
        return played(name, **figures)

    play.perception.submit = submit


@pytest.mark.parametrize("limits", [WorkerSettings(memory_high_gb=LIMIT_GB)])
def test_a_worker_that_grows_is_replaced_between_two_stages(play: Play, worker: PerceptionWorker) -> None:
    make_hungry(play, worker, "hoard", gb=LIMIT_GB / 4)
    assert play.run() == "complete"
    assert play.rooms == {"A": ("complete", "lambda_mu")}
    assert play.calls["take"] == 2
    assert set(play.events.codes) == {"MEM_HIGH"}
    assert 1 < len(play.events.codes) < len(play.events.of("stage")) / 2


@pytest.mark.parametrize("limits", [WorkerSettings(LIMIT_GB, LIMIT_GB)])
@pytest.mark.parametrize(
    ("bursts", "codes", "ends"),
    [
        (1, ["MEM_HIGH"], ("complete", "lambda_mu")),
        (2, ["MEM_HIGH", "MEM_HIGH", "PERC_DIED", "DOORS_NO_ROOM", "NAV_NO_MAP"], ("partial", "PERC_DIED")),
    ],
    ids=["once", "twice"],
)
def test_a_stage_that_would_take_the_whole_machine_is_killed_and_done_again_once(
    play: Play, worker: PerceptionWorker, bursts: int, codes: list[str], ends: tuple[str, str]
) -> None:
    make_hungry(play, worker, "burst", gb=2 * LIMIT_GB, times=bursts)
    play.run()
    assert play.events.codes == codes
    assert play.rooms == {"A": ends}
