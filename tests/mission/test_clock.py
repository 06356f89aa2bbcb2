"""Mission time, and the wait from one tick to the next."""

import itertools

import pytest

from drivers.simulated.clock import VirtualClock
from mission.clock import MissionClock


@pytest.mark.parametrize(("work", "then"), [(0.0, 0.1), (0.03, 0.1), (0.0999, 0.1), (0.1, 0.1), (0.25, 0.25)])
def test_ticks_come_regularly_however_long_each_takes_and_none_is_made_up_for(work: float, then: float) -> None:
    wall = VirtualClock()
    clock = MissionClock(source=wall.now, wait=wall.sleep)
    woken = []
    for _ in range(4):
        wall.sleep(work)
        clock.sleep(0.1)
        woken.append(wall.now())
    assert [after - before for before, after in itertools.pairwise(woken)] == pytest.approx([then] * 3)


def test_one_late_tick_does_not_hurry_those_after_it() -> None:
    wall = VirtualClock()
    clock = MissionClock(source=wall.now, wait=wall.sleep)
    wall.sleep(0.7)
    for expected in (0.7, 0.8, 0.9):
        clock.sleep(0.1)
        assert wall.now() == pytest.approx(expected)
