"""The judge of every mission that is flown here knows each breach."""

import pytest

from tests.missions.promises import Event, broken_by_devices, broken_by_executive

SCAN: Event = {"event": "scan", "scan_id": "S01", "moving": False}
OTHER: Event = {"event": "scan", "scan_id": "S02", "moving": False}
BEGUN: Event = {"event": "drive_begun", "goal_id": "G01"}
ENDED: Event = {"event": "drive", "goal_id": "G01"}


@pytest.mark.parametrize(
    ("truth", "words"),
    [
        ([SCAN, BEGUN, ENDED, SCAN], "scan S01 was taken 2 times"),
        ([SCAN, BEGUN, ENDED, BEGUN, ENDED, OTHER], "goal G01 was begun 2 times"),
        ([{**SCAN, "moving": True}], "scan S01 was taken in motion"),
        ([SCAN, BEGUN, OTHER, ENDED], "scan S02 was taken on the way to G01"),
        ([{"event": "collision", "pose": [1, 2, 0]}], "the base ran into something at [1, 2, 0]"),
    ],
)
def test_what_devices_must_not_do_is_told(truth: list[Event], words: str) -> None:
    assert words in broken_by_devices(truth)


def test_a_drive_that_was_cut_short_by_the_death_of_its_base_is_no_breach() -> None:
    assert broken_by_devices([SCAN, BEGUN, OTHER, {"event": "drive_begun", "goal_id": "G02"}]) == []
    assert broken_by_devices([SCAN, BEGUN, ENDED, OTHER]) == []


@pytest.mark.parametrize(
    ("events", "words"),
    [
        ([{"kind": "registered", "scan_id": "S01"}] * 2, "scan S01 has 2 poses in the log"),
        ([{"kind": "failure", "code": "SCAN_MOVED"}], "the base moved in a scan: SCAN_MOVED"),
        ([{"kind": "failure", "code": "TICK_EXCEPTION"}], "the program is wrong: TICK_EXCEPTION"),
    ],
)
def test_what_an_executive_must_not_say_is_told(events: list[Event], words: str) -> None:
    assert broken_by_executive(events) == [words]
    assert broken_by_executive([{"kind": "registered", "scan_id": "S01"}, {"kind": "failure", "code": "X"}]) == []
