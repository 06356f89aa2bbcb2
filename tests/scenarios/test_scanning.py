"""Missions whose scanner has a bad day."""

import numpy as np
import pytest

from tests.scenarios.play import Play
from tests.scenarios.scripted import EVER, HANG, TWICE
from tests.scenarios.site import row

LATER = EVER[1:]


def test_a_scan_that_fails_once_is_taken_again_on_the_spot() -> None:
    """The second scan is broken off by the scanner; the next order, under a new name, works without any driving."""
    play = Play(row(1))
    play.script.fail("take", "SCAN_FAILED", [2])
    assert play.run() == "complete"
    assert list(play.scanner.taken) == ["S01", "S02", "S03"]
    assert np.allclose(play.scanner.taken["S02"], play.scanner.taken["S03"])
    assert [scan.scan_id for scan in play.survey.scans] == ["S01", "S03"]


def test_a_scan_that_fails_twice_works_from_a_spot_nearby() -> None:
    """Something at the view disturbs the scanner: the robot goes half a metre back the way it came; there it works."""
    play = Play(row(1))
    play.script.fail("take", "SCAN_FAILED", [2, 3])
    assert play.run() == "complete"
    assert play.rooms == {"A": ("complete", "lambda_mu")}
    assert play.calls["take"] == 4
    assert [event["purpose"] for event in play.events.of("drive")] == ["view", "nearby", "start"]
    view, nearby = play.scanner.taken["S03"][:2, 3], play.scanner.taken["S04"][:2, 3]
    assert np.isclose(np.linalg.norm(view - nearby), 0.5)
    assert np.linalg.norm(nearby) < np.linalg.norm(view)
    assert play.events.codes == ["SCAN_FAILED", "SCAN_FAILED"]


def test_the_drive_nearby_does_not_claim_the_pose_of_the_last_scan() -> None:
    """The robot has left that place; what registration said of it would send the base into a wall."""
    play = Play(row(1))
    play.script.fail("take", "SCAN_FAILED", [2, 3])
    play.run()
    assert [goal.map_from_base is not None for goal in play.base.goals] == [True, False, True]


def test_a_scan_that_fails_for_ever_leaves_the_room_partial_with_its_code() -> None:
    """Two spots, two attempts each; then the room is given up, its doors are looked for, and the robot goes on."""
    play = Play(row(2))
    play.script.fail("take", "SCAN_FAILED", LATER)
    assert play.run() == "incomplete"
    assert play.rooms == {"A": ("partial", "SCAN_FAILED"), "B": ("partial", "SCAN_FAILED")}
    assert play.doors == ["passed"]
    assert play.calls["take"] == 1 + 4 + 4
    assert play.calls["find_doors"] == 1, "B has no contour to look for doors in"
    assert np.allclose(play.base.pose[:2], (0, 0))


def test_a_scanner_that_never_worked_is_the_reason_and_not_the_way_back_there_is_none_of() -> None:
    """The very first scan fails twice. The robot has not moved and may not: the room's reason is the scanner's."""
    play = Play(row(1))
    play.script.fail("take", "SCAN_FAILED", EVER)
    assert play.run() == "incomplete"
    assert play.rooms == {"A": ("partial", "SCAN_FAILED")}
    assert (play.calls["take"], play.calls["drive"]) == (2, 0)
    assert "NAV_NO_TRACK" in play.events.codes


def test_a_scan_that_never_ends_is_cancelled_and_taken_again() -> None:
    """The scanner hangs; after the deadline the order is cancelled, and the next one works."""
    play = Play(row(1))
    play.script.answer("take", HANG, [1])
    assert play.run() == "complete"
    assert play.events.codes == ["SCAN_TIMEOUT"]
    assert [job.cancelled for job in play.script.jobs if job.what == "take"] == [True, False, False]
    assert play.clock.now() > play.settings.scanning.timeout_s


def test_a_refused_cloud_and_no_floor_are_reasons_to_scan_again() -> None:
    """Each stage on the way to an aligned scan fails once, in a scan of its own."""
    play = Play(row(1))
    play.script.fail("validate_scan", "SCAN_TILT", [2]).fail("align_scan", "ALIGN_NO_FLOOR", [2])
    assert play.run() == "complete"
    assert play.events.codes == ["SCAN_TILT", "ALIGN_NO_FLOOR"]
    assert play.calls["take"] == 4
    assert len(play.survey.scans) == 2


@pytest.mark.parametrize("code", ["XFER_BROKEN", "XFER_WRITE_FAILED", "DISK_FULL", "AGENT_UNREACHABLE"])
def test_a_scan_that_did_not_come_home_is_fetched_again_and_not_taken_again(code: str) -> None:
    """The scanner still has it: 45 seconds of standing still are worth another transfer."""
    play = Play(row(1))
    play.script.fail("fetch", code, TWICE)
    assert play.run() == "complete"
    assert play.events.codes == [code, code]
    assert (play.calls["take"], play.calls["fetch"]) == (2, 4)


def test_a_transfer_that_never_ends_is_given_up_and_named() -> None:
    """Each attempt has its deadline; another scan would come home no better."""
    play = Play(row(1))
    play.script.answer("fetch", HANG, LATER)
    assert play.run() == "incomplete"
    assert play.rooms == {"A": ("partial", "XFER_TIMEOUT")}
    assert (play.calls["take"], play.calls["fetch"]) == (2, 4)
    assert play.clock.now() < 3 * play.settings.scanning.fetch_timeout_s + 600.0


def test_data_that_arrives_broken_again_and_again_is_a_reason_to_scan_again() -> None:
    play = Play(row(1))
    play.script.fail("fetch", "XFER_BROKEN", range(1, 4))
    assert play.run() == "complete"
    assert (play.calls["take"], play.calls["fetch"]) == (3, 5)


def test_a_scanner_that_is_gone_is_not_asked_again_and_again() -> None:
    """Nobody answers: neither another try on the spot nor another spot helps."""
    play = Play(row(1))
    play.script.fail("take", "AGENT_UNREACHABLE", LATER)
    assert play.run() == "incomplete"
    assert play.rooms == {"A": ("partial", "AGENT_UNREACHABLE")}
    assert play.calls["take"] == 2


def test_a_worker_that_dies_is_named_as_the_reason() -> None:
    """The process that segments dies twice (the worker's own second chance is over): the room is given up."""
    play = Play(row(1))
    play.script.fail("segment_room", "PERC_DIED", TWICE)
    assert play.run() == "incomplete"
    assert play.rooms == {"A": ("partial", "PERC_DIED")}
    assert play.calls["take"] == 1
