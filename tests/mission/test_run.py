"""Around a mission: jobs that are waited for, and figures that are summed up."""

import subprocess
import sys
import time
from pathlib import Path

from drivers.jobs import wait_for
from mission.run import summarise
from mission.store import RunFolder
from perception.failure import Failure
from tests.behaviours.bench import HandJob


def test_a_job_that_never_ends_is_cancelled_in_the_end() -> None:
    job = HandJob()
    began = time.monotonic()
    answer = wait_for(job, 0.1)
    assert isinstance(answer, Failure)
    assert answer.code == "AGENT_UNREACHABLE"
    assert job.cancelled == 1
    assert time.monotonic() - began < 5


def test_the_summary_has_the_last_rates_of_each_room(tmp_path: Path) -> None:
    cycles = [
        {"growing_rate": 1.0, "occluded_decrease_rate": 0.8},
        {"growing_rate": 0.1, "occluded_decrease_rate": 0.2},
    ]
    rooms = [
        {"id": "R1", "scans": ["S01", "S02"], "reason_ended": "lambda_mu", "cycles": cycles},
        {"id": "R2", "scans": [], "reason_ended": "REG_DIVERGED", "cycles": []},
    ]
    state = {"outcome": "incomplete", "rooms": rooms, "scans": [{}, {}], "wall_s": 3.0, "simulated_s": 30.0}
    summary = summarise(RunFolder(tmp_path), state)
    assert (summary.run, summary.scans, summary.outcome, summary.reason) == (str(tmp_path), 2, "incomplete", "")
    assert [room["growing_rate"] for room in summary.rooms] == [0.1, None]
    assert [room["scans"] for room in summary.rooms] == [2, 0]


def test_the_process_that_ticks_loads_neither_open3d_nor_numba() -> None:
    code = "import sys, mission.run, mission.rehearsal; print([m for m in ('open3d', 'numba') if m in sys.modules])"
    said = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert said.strip() == "[]"
