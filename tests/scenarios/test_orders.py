"""An operator at the control socket of a mission that runs: each word is acknowledged at once, and obeyed at a tick."""

import signal
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest

from mission.control import Pause, Resume, is_live
from mission.run import Summary
from perception.failure import FailureError
from tests.mission.acknowledged import ACK_S, Wait, acknowledged
from tests.scenarios.kept import Kept

AT_LEAST = 3
"""Pauses that fit into a short mission, however late the machine lets the operator speak."""
_PATIENCE_S = 120.0


class Operator(threading.Thread):
    """Pauses a mission again and again, and looks what the base is told after each word."""

    def __init__(self, kept: Kept) -> None:
        super().__init__(daemon=True)
        self.waits: list[Wait] = []
        self.disobeyed: list[int] = []
        self._kept = kept

    def run(self) -> None:
        self._until_tick(1)
        with suppress(FailureError):  # nobody is there any more when the mission has ended
            while is_live(self._kept.run.path):
                self._pause_once()

    def _pause_once(self) -> None:
        self.waits.append(acknowledged(self._kept.run.path, Pause()))
        first = len(self._beats) + 1  # the tick that was under way may still end as it began
        self._until_tick(first + 4)
        self.disobeyed += [tick for tick, may_move in self._beats[first:] if may_move]
        self.waits.append(acknowledged(self._kept.run.path, Resume()))
        self._until_tick(first + 7)

    @property
    def _beats(self) -> list[tuple[int, bool]]:
        return self._kept.base.beats

    def _until_tick(self, count: int) -> None:
        end = time.monotonic() + _PATIENCE_S
        while len(self._beats) < count and (not self._beats or is_live(self._kept.run.path)):
            assert time.monotonic() < end
            time.sleep(0.001)


def test_a_mission_under_way_acknowledges_in_200_ms_and_obeys_at_its_next_tick(tmp_path: Path) -> None:
    kept = Kept(tmp_path)
    operator = Operator(kept)
    operator.start()
    summary = kept.fly()
    operator.join(_PATIENCE_S)
    assert isinstance(summary, Summary)
    assert summary.outcome == "complete"
    assert len(operator.waits) >= 2 * AT_LEAST
    assert max(wait.own for wait in operator.waits) < ACK_S
    assert operator.disobeyed == []


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_between_the_end_and_the_deliveries_aborts_nothing(tmp_path: Path, number: signal.Signals) -> None:
    kept = Kept(tmp_path)
    kept.perception.close = lambda: signal.raise_signal(number)  # type: ignore[method-assign]
    before = signal.signal(number, signal.default_int_handler)
    try:
        summary = kept.fly()
        assert isinstance(summary, Summary)
        assert summary.outcome == "complete"
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(number)  # whoever handled it before does so again
    finally:
        signal.signal(number, before)
