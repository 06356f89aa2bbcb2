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
PATIENCE_S = SETTINGS.operator.patience_s
LIMITS_S = {
    "drive": 2 * SETTINGS.driving.view_attempts * SETTINGS.driving.timeout_s,
    "take": 8 * SETTINGS.scanning.timeout_s,
    "fetch": 8 * SETTINGS.scanning.fetch_timeout_s,
    "base off": SETTINGS.building.base_return_s,
    "base taken": SETTINGS.building.base_return_s,
    "emergency stop": SETTINGS.building.release_s,
    "battery low": SETTINGS.battery.charging_s,
    "battery critical": SETTINGS.battery.charging_s,
    "disk nearly full": SETTINGS.scanning.room_s,
}
"""How long each may last by itself: the deadline of an operation, with its attempts, or of a hold."""
HELD_WAYS = ["stuck", "garbage"]
"""No end and nonsense; silence, and values that are merely wrong, are in the table."""
LASTING = [name for name in EVENTS if name not in ("person", "pause")]
"""People go on by themselves, and a pause is the operator's own."""


def bound_s(what: str) -> float:
    """Mission seconds within which the mission ends, whatever is held for good, and nobody answering."""
    of_its_own = WORKER_S * 8 if what in PERCEPTION else LIMITS_S.get(what, 0.0)
    return WORK_S + of_its_own + 2 * PATIENCE_S


@pytest.mark.parametrize("operation", OPERATIONS)
@pytest.mark.parametrize("way", HELD_WAYS)
def test_an_operation_that_goes_wrong_for_good_ends_the_mission_within_its_bound(operation: str, way: str) -> None:
    """(The monitor looks whether the end is a declared one, at rest, and every shortfall has a cause that was met.)"""
    ordeal = held(operation, way)
    assert ordeal.outcome in ("complete", "incomplete", "safety_stop")
    assert ordeal.seconds <= bound_s(operation)
    assert ordeal.ticks <= bound_s(operation) / TICK_S


@pytest.mark.parametrize("name", LASTING)
def test_what_is_never_over_ends_the_mission_within_its_bound(name: str) -> None:
    ordeal = lasting(name)
    assert ordeal.seconds <= bound_s(name)
    assert ordeal.ticks <= bound_s(name) / TICK_S


@pytest.mark.parametrize("operation", ["take", "drive", "fetch", "segment_room"])
def test_an_operation_that_never_ends_is_asked_about_where_somebody_may_help(operation: str) -> None:
    ordeal = held(operation, "stuck", attended=True)
    assert ordeal.asked is not None
    assert ordeal.asked <= bound_s(operation)
