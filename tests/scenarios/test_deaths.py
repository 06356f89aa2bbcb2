"""An executive that really dies on its commit path, and the mission that is resumed: the one that nobody killed.

Every crash point: ``python -m benchmarks.deaths``.
"""

from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context

import pytest

from benchmarks.deaths import died, whole
from tests.scenarios.deaths import Undisturbed, When

pytestmark = pytest.mark.xdist_group("deaths")
"""Its fixture is a whole mission: one process flies it for all."""


@dataclass(frozen=True)
class Mortuary:
    """The mission that nobody killed, and a fresh interpreter to fork the others from: this one has threads."""

    pool: ProcessPoolExecutor
    clean: Undisturbed

    def last(self, operation: str) -> int:
        """The number of the last operation that is this."""
        return len(self.clean.log) - self.clean.log[::-1].index(operation)


@pytest.fixture(scope="module")
def mortuary() -> Iterator[Mortuary]:
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        yield Mortuary(pool, pool.submit(whole).result())


@pytest.mark.parametrize(
    ("when", "operation"),
    [
        (When.AMID, "write S02.scan.tmp"),
        (When.BEFORE, "replace S02.json.tmp"),
        (When.AMID, "write S02.scan.part"),
        (When.AFTER, "replace S02.scan.part"),
        (When.BEFORE, "fsync voxels"),
        (When.AMID, "write map_S02.partial.npz"),
        (When.AFTER, "insert mission.db"),
        (When.AMID, "write events.jsonl"),
    ],
    ids=str,
)
def test_resumed_it_is_the_mission_that_nobody_killed(when: When, operation: str, mortuary: Mortuary) -> None:
    assert mortuary.pool.submit(died, mortuary.clean, (when, mortuary.last(operation))).result() == ""


@pytest.mark.parametrize("when", [When.BEFORE, When.AFTER], ids=str)
def test_an_act_that_was_committed_and_perhaps_not_begun_is_done_once(when: When, mortuary: Mortuary) -> None:
    """The transaction that a second scan waits for: its row is there or not, and nobody knows what was done."""
    log, stored = mortuary.clean.log, mortuary.last("open S02.scan.tmp")
    commit = max(at for at, what in enumerate(log[:stored], 1) if what == "commit mission.db")
    assert mortuary.pool.submit(died, mortuary.clean, (when, commit)).result() == ""


def test_every_kind_of_operation_of_the_commit_path_is_a_crash_point(mortuary: Mortuary) -> None:
    kinds = {what.partition(" ")[0] for what in mortuary.clean.log}
    assert {"insert", "commit", "open", "write", "fsync", "replace", "mkdir", "posix_fallocate"} <= kinds
    files = {what.partition(" ")[2] for what in mortuary.clean.log if what.startswith("fsync ")}
    assert {"scans", "maps", "voxels", "scanner", "S01.scan.tmp", "S01.json.tmp", "S01.scan.part"} <= files
