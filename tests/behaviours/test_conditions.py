"""Questions to the blackboard."""

from dataclasses import replace

import numpy as np
import pytest
from py_trees.common import Status

from behaviours import conditions, safety
from behaviours.conditions import Condition
from behaviours.keys import Key
from behaviours.survey import Survey
from perception.building import Building
from perception.failure import Failure
from tests.behaviours.bench import Bench, current, get, put, scan, survey_of, tick

YES, NO = Status.SUCCESS, Status.FAILURE


def answer(condition: Condition) -> Status:
    bench = Bench()
    bench.set_up(condition)
    status = tick(condition)
    assert bench.events == [], "a question leaves nothing in the journal"
    return status


def in_a_room(status: str) -> None:
    building, room_id = Building().add_room((0.0, 0.0))
    put(SURVEY=replace(Survey(), building=building.end_room(room_id, status, "")), ROOM=room_id)


@pytest.mark.parametrize(
    ("code", "codes", "expected"),
    [
        ("SCAN_FAILED", ("SCAN_",), YES),
        ("SCAN_FAILED", ("SCAN_FAILED",), YES),
        ("SCAN_FAILED", ("SCAN",), NO),
        ("TIMEOUT", ("SCAN_", "TIMEOUT"), YES),
        ("NAV_TIMEOUT", ("TIMEOUT",), NO),
        ("REG_DEGENERATE", ("NAV_", "SCAN_"), NO),
    ],
)
def test_failure_is_matches_whole_codes_and_prefixes_that_end_with_an_underscore(
    code: str, codes: tuple[str, ...], expected: Status
) -> None:
    put(FAILURE=Failure(code, "scripted"))
    assert answer(conditions.FailureIs("that one?", *codes)) == expected
    assert get(Key.FAILURE).code == code, "asking does not change the failure"


def test_failure_is_none_of_them_while_nothing_failed() -> None:
    assert answer(conditions.FailureIs("that one?", "SCAN_")) == NO


def test_the_map_frame_is_made_by_the_first_scan() -> None:
    put(SURVEY=Survey())
    assert answer(conditions.NoScanYet("none?")) == YES
    assert answer(conditions.MapFrameIsMade("made?")) == NO
    put(SURVEY=survey_of(scan("S01")))
    assert answer(conditions.NoScanYet("none?")) == NO
    assert answer(conditions.MapFrameIsMade("made?")) == YES


def test_a_scan_set_aside_waits() -> None:
    put(SURVEY=Survey(), SCAN=current("S03", np.eye(4)))
    assert answer(conditions.ScanIsSetAside("waits?")) == NO
    put(SURVEY=Survey(set_aside=(current("S02", np.eye(4)),)))
    assert answer(conditions.ScanIsSetAside("waits?")) == YES
    put(SURVEY=Survey(set_aside=(current("S03", np.eye(4)),)))
    assert answer(conditions.ScanIsSetAside("waits?")) == NO, "what it was refused by has not changed"


@pytest.mark.parametrize("status", ["open", "complete", "partial"])
def test_a_room_is_either_open_or_ended(status: str) -> None:
    in_a_room(status)
    assert answer(conditions.RoomIsOpen("open?")) == (YES if status == "open" else NO)
    assert answer(conditions.RoomIsEnded("ended?")) == (NO if status == "open" else YES)


@pytest.mark.parametrize(("command", "expected"), [("run", NO), ("abort", YES)])
def test_an_abort_is_ordered_by_that_very_word(command: str, expected: Status) -> None:
    put(COMMAND=command)
    assert answer(safety.AbortOrdered("abort?")) == expected
