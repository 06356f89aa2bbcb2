"""Every operation, broken in every way, for good: the mission ends at rest, with a named cause, within its bound.

All ways of all operations in one table: ``python -m benchmarks.faults --held``.
"""

import pytest

from tests.scenarios.faults import EVENTS, OPERATIONS, PERCEPTION
from tests.scenarios.ordeal import SETTINGS, held, lasting
from tests.scenarios.play import TICK_S
from tests.scenarios.scripted import WORKER_S

WORK_S = 3600.0
"""What two rooms take, with every attempt that the ladder has, where nothing takes longer than it should."""
ROOMS = 2
VIEWS = ROOMS * SETTINGS.driving.view_attempts
"""Drives at most. A room that cannot be left has the door and the way home instead of the other room's views."""
TRIES = ROOMS * SETTINGS.scanning.spots * 2
"""How often all else is tried at most: at each spot of each room twice."""
QUESTIONS_S = 2 * SETTINGS.operator.patience_s
"""What could not be finished is asked about, and after that the doors that could not be passed; a hold asks once."""
LIMITS_S = {
    **dict.fromkeys(PERCEPTION, TRIES * WORKER_S),
    "drive": VIEWS * SETTINGS.driving.timeout_s,
    "take": TRIES * SETTINGS.scanning.timeout_s,
    "fetch": TRIES * SETTINGS.scanning.fetch_timeout_s,
    "acquire": SETTINGS.building.base_return_s,
    "base off": SETTINGS.building.base_return_s,
    "base taken": SETTINGS.building.base_return_s,
    "emergency stop": SETTINGS.building.release_s,
    "battery low": SETTINGS.battery.charging_s,
    "battery critical": SETTINGS.battery.charging_s,
    "disk nearly full": SETTINGS.scanning.room_s,
}
"""How long each may last by itself: the deadline of an operation, with its attempts, or of a hold."""
HELD_WAYS = ["stuck", "garbage", "unheard of"]
"""No end, nonsense, and a code that nobody knows; silence, and values that are merely wrong, are in the table."""
ENDS = {
    **dict.fromkeys(("cart", "slip", "base reboot"), "complete"),
    **dict.fromkeys(("door closes", "battery low"), "incomplete"),
    **dict.fromkeys(
        ("base off", "base taken", "emergency stop", "battery critical", "disk nearly full"), "safety_stop"
    ),
    "abort": "aborted",
}
"""What comes of each event that is never over. People go on by themselves, and a pause is the operator's own."""


def bound_s(what: str) -> float:
    """Mission seconds within which the mission ends, whatever is held for good, and nobody answering."""
    return WORK_S + LIMITS_S.get(what, 0.0) + QUESTIONS_S


@pytest.mark.parametrize("operation", OPERATIONS)
@pytest.mark.parametrize("way", HELD_WAYS)
def test_an_operation_that_goes_wrong_for_good_ends_the_mission_within_its_bound(operation: str, way: str) -> None:
    """(The monitor looks whether the end is a declared one, at rest, and every shortfall has a cause that was met.)"""
    ordeal = held(operation, way)
    assert ordeal.outcome in ("complete", "incomplete", "safety_stop")
    assert ordeal.seconds <= bound_s(operation)
    assert ordeal.ticks <= bound_s(operation) / TICK_S


def test_of_every_event_it_is_known_what_comes_of_it() -> None:
    assert set(EVENTS) - set(ENDS) == {"person", "pause"}


@pytest.mark.parametrize("name", ENDS)
def test_what_is_never_over_ends_the_mission_as_it_should_and_within_its_bound(name: str) -> None:
    ordeal = lasting(name)
    assert ordeal.outcome == ENDS[name]
    assert ordeal.seconds <= bound_s(name)
    assert ordeal.ticks <= bound_s(name) / TICK_S


@pytest.mark.parametrize("operation", ["take", "drive", "fetch", "segment_room"])
def test_an_operation_that_never_ends_is_asked_about_where_somebody_may_help(operation: str) -> None:
    ordeal = held(operation, "stuck", attended=True)
    assert ordeal.asked is not None
    assert ordeal.asked <= bound_s(operation)
