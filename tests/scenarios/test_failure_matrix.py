"""Every operation, broken in every way, for good: whatever it is, the mission ends at rest and with a named reason."""

import pytest

from perception.failure import Failure
from tests.scenarios.play import Play
from tests.scenarios.scripted import EVER, HANG
from tests.scenarios.site import row

OPERATIONS = [
    *("take", "fetch", "drive", "stop"),
    *("validate_scan", "align_scan", "anchor_scan", "register_scan", "register_globally"),
    *("segment_room", "build_map", "label_space", "choose_view", "find_doors"),
]
WITH_A_DEADLINE_IN_THE_TREE = ["take", "drive"]
WAYS = {"refused": Failure("UNHEARD_OF", "a code that no recovery knows"), "nonsense": object()}


@pytest.mark.parametrize("operation", OPERATIONS)
@pytest.mark.parametrize("way", WAYS)
def test_an_operation_that_always_fails_ends_the_mission_at_rest(operation: str, way: str) -> None:
    """From its first call on the operation fails, or gives something that nobody can use."""
    play = Play(row(2))
    play.script.answer(operation, WAYS[way], EVER)
    if operation == "register_globally":
        play.script.fail("register_scan", "REG_LOW_OVERLAP", EVER)
    outcome = play.run()
    assert outcome in ("complete", "incomplete")
    unfinished = [reason for status, reason in play.rooms.values() if status != "complete"]
    assert all(unfinished), "every unfinished room has a named reason"
    assert outcome == "complete" or unfinished or "refused" in play.doors


@pytest.mark.parametrize("operation", WITH_A_DEADLINE_IN_THE_TREE)
def test_an_operation_that_never_ends_is_bounded_by_the_tree(operation: str) -> None:
    """Nobody answers and nobody fails: each wait has an end, the mission too."""
    play = Play(row(2))
    play.script.answer(operation, HANG, EVER)
    assert play.run() == "incomplete"
    assert {job.cancelled for job in play.script.jobs if job.what == operation} == {True}
