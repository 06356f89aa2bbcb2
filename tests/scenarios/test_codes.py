"""Every code that a device, a client or a stage may answer with, for good: what is tried again, asked, and reported.

``tests/test_failure_codes.py`` knows which codes need a row here, and which need none.
"""

from typing import Any

import pytest

from mission.state import describe
from perception.findings import LabelCounts
from tests.scenarios.ordeal import held
from tests.scenarios.play import Play
from tests.scenarios.scripted import EVER, TWICE
from tests.scenarios.site import row


@pytest.mark.parametrize(
    ("code", "operation", "tries", "asked"),
    [
        # Another scan may help, and where it does not, somebody at the robot.
        ("SCAN_REJECTED", "take", 2, True),
        ("SCAN_RELEASED", "fetch", 2, True),
        ("SCAN_UNKNOWN", "fetch", 2, True),
        ("SCAN_BEAMS", "validate_scan", 2, True),
        ("SCAN_CORRUPT", "validate_scan", 2, True),
        ("SCAN_EMPTY", "validate_scan", 2, True),
        ("SCAN_EXTENT", "validate_scan", 2, True),
        ("SCAN_FEW_RETURNS", "validate_scan", 2, True),
        ("SCAN_FLAT", "validate_scan", 2, True),
        ("SCAN_FOREIGN", "validate_scan", 2, True),
        ("SCAN_HEADER", "validate_scan", 2, True),
        ("SCAN_INCOMPLETE", "validate_scan", 2, True),
        ("SCAN_MIRRORED", "validate_scan", 2, True),
        ("SCAN_MISMATCHED", "validate_scan", 2, True),
        ("SCAN_NOT_FINITE", "validate_scan", 2, True),
        ("SCAN_PATTERN", "validate_scan", 2, True),
        ("SCAN_RANGE", "validate_scan", 2, True),
        ("SCAN_REPEATED", "validate_scan", 2, True),
        ("SCAN_TRUNCATED", "validate_scan", 2, True),
        ("SCAN_TURNED", "validate_scan", 2, True),
        ("SCAN_UNITS", "validate_scan", 2, True),
        ("SCAN_UNREADABLE", "validate_scan", 2, True),
        # The same again would end the same; somebody may put it right.
        ("AGENT_EXCEPTION", "take", 1, True),
        ("AGENT_RESTARTED", "take", 1, True),
        ("DEVICE_FORGOT", "take", 1, True),
        ("DRIVER_EXCEPTION", "take", 1, True),
        ("SPOOL_FAILED", "take", 1, True),
        ("PERC_EXCEPTION", "build_map", 1, True),
        ("RUN_LOSSY", "build_map", 1, True),
        # Nobody at the robot could.
        ("BAD_MESSAGE", "take", 1, False),
        ("BAD_REPLY", "take", 1, False),
        ("MESSAGE_TOO_LARGE", "take", 1, False),
        ("NOT_ALLOWED", "take", 1, False),
        ("PROTOCOL_MISMATCH", "take", 1, False),
        ("SEGMENT_NO_FLOOR", "segment_room", 1, False),
        ("CONTOUR_NOT_FOUND", "segment_room", 1, False),
        ("VOXELS_BAD_SHAPE", "label_space", 1, False),
        ("NBV_SENSOR_OUTSIDE", "choose_view", 1, False),
        # To the view, and to the start at the end.
        ("CANCELLED", "drive", 2, False),
        # Each of these two is tried six times: whoever has the base may give it back.
        ("LEASE_HELD", "drive", 12, False),
    ],
)
def test_what_ends_a_room_is_the_reason_in_the_report(code: str, operation: str, tries: int, asked: bool) -> None:
    play = Play(row(1), attended=True)
    play.script.fail(operation, code, EVER)
    assert play.run() == "incomplete"
    assert [room["reason_ended"] for room in reported(play)] == [code]
    assert play.calls[operation] == tries
    assert any(f"({code}: " in question["text"] for question in play.events.of("asked")) is asked


def reported(play: Play) -> list[dict[str, Any]]:
    return list(describe(play.survey)["rooms"])


@pytest.mark.parametrize("code", ["REG_DIVERGED", "REG_LOW_OVERLAP"])
def test_a_scan_that_fits_nowhere_near_is_searched_for_everywhere(code: str) -> None:
    play = Play(row(1))
    play.script.fail("register_scan", code, TWICE)
    assert play.run() == "complete"
    assert code in play.events.codes
    assert play.calls["register_globally"] > 0


@pytest.mark.parametrize(
    ("operation", "way", "code", "outcome"),
    [
        ("stop", "stuck", "STOP_TIMEOUT", "complete"),
        ("fetch", "garbage", "LEAF_EXCEPTION", "incomplete"),
        ("segment_room", "garbage", "DRIVER_EXCEPTION", "incomplete"),
        ("segment_room", "stuck", "DOORS_NO_ROOM", "incomplete"),
        ("build_map", "stuck", "NAV_NO_MAP", "incomplete"),
    ],
)
def test_what_the_tree_itself_finds_wrong_is_in_the_log(operation: str, way: str, code: str, outcome: str) -> None:
    ordeal = held(operation, way)
    assert ordeal.outcome == outcome
    assert code in ordeal.codes


def test_a_space_that_shrinks_from_one_cycle_to_the_next_ends_its_room(monkeypatch: pytest.MonkeyPatch) -> None:
    play = Play(row(1))
    label = play.perception.label_space

    def shrinks(room_id: str, cycle: int, **more: Any) -> LabelCounts:
        counts = label(room_id, cycle, **more)
        return counts if cycle == 1 else LabelCounts(counts.occupied // 4, counts.empty // 4, 0)

    monkeypatch.setattr(play.perception, "label_space", shrinks)
    assert play.run() == "incomplete"
    assert [room["reason_ended"] for room in reported(play)] == ["STOP_SPACE_SHRANK"]
