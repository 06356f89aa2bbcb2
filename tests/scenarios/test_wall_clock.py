"""A clock on the wall that is set to and fro in a mission: stamps tell it, and nothing else goes by it."""

import random
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from datetime import UTC, datetime, tzinfo
from itertools import pairwise
from pathlib import Path
from typing import Any
from unittest.mock import patch

import pytest

from mission.report import write_report
from mission.run import Summary
from tests.scenarios.kept import Kept


@contextmanager
def jumping_wall_clock(seed: int) -> Iterator[None]:
    """Each look at it finds it set by up to an hour, to or fro."""
    chance, now = random.Random(seed), time.time

    def anywhere() -> float:
        return now() + chance.uniform(-3600.0, 3600.0)

    class Jumping(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> Any:
            return datetime.fromtimestamp(anywhere(), tz or UTC)

    with ExitStack() as stack:
        stack.enter_context(patch("time.time", anywhere))
        for module in ("journal", "run", "store"):
            stack.enter_context(patch(f"mission.{module}.datetime", Jumping))
        yield


def flown(folder: Path) -> Kept:
    kept = Kept(folder)
    summary = kept.fly()
    assert isinstance(summary, Summary)
    assert summary.outcome == "complete"
    kept.assert_folder_is_whole()
    return kept


def without_stamps(kept: Kept) -> list[dict[str, Any]]:
    """The events but for what the wall clock, and the machine's speed, say of them."""
    return [{name: value for name, value in row.items() if name not in ("utc", "tick_ms")} for row in kept.recorded]


@pytest.mark.parametrize("seed", [1, 2])
def test_a_wall_clock_that_jumps_changes_no_more_than_the_stamps(seed: int, tmp_path: Path) -> None:
    quiet = flown(tmp_path / "quiet")
    with jumping_wall_clock(seed):
        stepped = flown(tmp_path / "stepped")
        write_report(stepped.run.path)
    stamps = [row["utc"] for row in stepped.recorded]
    assert any(later < earlier for earlier, later in pairwise(stamps)), "it was never set back"
    assert without_stamps(stepped) == without_stamps(quiet)
    assert stepped.run.report.exists()
