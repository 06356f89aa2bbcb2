"""The bad cable befalls messages as often as it says, and as it says."""

import random
from unittest.mock import Mock

import pytest

from tests.drivers.chaos_link import NONE, Mischief, _Direction

MANY = 20_000


def carried(mischief: Mischief, count: int) -> tuple[_Direction, list[int]]:
    """Messages that came one after another: what befell them, and the numbers of those that left."""
    sink = Mock()
    way = _Direction(sink, mischief, random.Random(0))
    for number in range(count):
        way.carry([b"%d" % number])
        way.deliver()
    return way, [int(call.args[0][0]) for call in sink.send_multipart.call_args_list]


def test_each_thing_befalls_the_share_that_it_is_said_to() -> None:
    befell = carried(Mischief(), MANY)[0].befell
    assert sum(befell.values()) == MANY
    for name in ("drop", "duplicate", "delay", "reorder", "hold"):
        assert befell[name] / MANY == pytest.approx(getattr(Mischief(), name), abs=0.01)


def test_nothing_befalls_messages_on_a_good_cable() -> None:
    assert carried(NONE, 100)[1] == list(range(100))


def test_each_message_that_is_swapped_is_passed_by_the_next_that_is_not() -> None:
    swaps = Mischief(drop=0.0, duplicate=0.0, delay=0.0, reorder=0.5, hold=0.0, longest_s=60.0)
    way, left = carried(swaps, 1000)
    passed = [number for place, number in enumerate(left) if any(later > number for later in left[:place])]
    assert len(passed) == way.befell["reorder"] - (1000 - len(left))
