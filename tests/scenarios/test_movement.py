"""Somebody stands in a scan: it waits until they have gone and takes another, once, and keeps both."""

from collections.abc import Callable
from itertools import pairwise

import pytest

from perception.failure import Failure
from perception.findings import Movement
from tests.scenarios.play import Play
from tests.scenarios.scripted import EVER
from tests.scenarios.site import row

SOMEBODY = Movement(0.03, (1.0, 2.0))


def crowded(calls: range) -> Play:
    """A mission of two rooms; the scans of these calls have somebody in them. A room's first scan is not looked at."""
    play = Play(row(2))
    play.script.answer("find_movement", SOMEBODY, calls)
    return play


def test_it_waits_until_they_have_gone_and_scans_once_more_from_the_same_place() -> None:
    whole, play = Play(row(2)), crowded(range(1, 2))
    assert whole.run() == play.run() == "complete"
    assert play.calls["take"] == whole.calls["take"] + 1
    assert play.events.codes == ["DYN_POINTS"]
    _, spoiled, again = play.survey.scans[:3]
    assert spoiled.base_pose == again.base_pose
    assert (spoiled.movement, again.movement) == (0.03, 0.0)
    taken = [event["t"] for event in play.events.of("scan")]
    waits = [after - before for before, after in pairwise(taken)]
    assert waits[1] > play.settings.scanning.calm_s
    assert play.rooms == whole.rooms
    assert [len(cycles) for cycles in play.survey.cycles.values()] == [2, 2], "a scan more is no cycle more"


def test_where_they_stay_it_goes_on_with_what_it_has() -> None:
    whole, play = Play(row(2)), crowded(EVER)
    assert whole.run() == play.run() == "complete"
    assert play.calls["take"] == whole.calls["take"] + 2, "once more in each room, and not for ever"
    assert {scan.movement for scan in play.survey.scans} == {None, 0.03}
    assert play.rooms == whole.rooms


@pytest.mark.parametrize(("share", "scans"), [(0.01, 0), (0.0101, 1)])
def test_a_little_movement_costs_nothing(share: float, scans: int) -> None:
    whole, play = Play(row(1)), Play(row(1))
    play.script.answer("find_movement", Movement(share, (1.0, 2.0)))
    assert whole.run() == play.run() == "complete"
    assert play.calls["take"] == whole.calls["take"] + scans
    assert play.survey.scans[1].movement == share


def test_a_scan_more_that_fails_is_not_missed() -> None:
    play = crowded(range(1, 2))
    play.script.fail("take", "SCAN_FAILED", range(3, 7))
    assert play.run() == "complete"
    assert "SCAN_FAILED" in play.events.codes


def test_a_scan_more_that_finds_no_place_is_tried_again_and_moves_nobody(monkeypatch: pytest.MonkeyPatch) -> None:
    whole, play = Play(row(2)), crowded(range(1, 2))
    register_scan, register_globally = play.perception.register_scan, play.perception.register_globally

    def once_more_is_known(register: Callable[..., object]) -> Callable[..., object]:
        def registered(scan_id: str, reference: list[object], **more: object) -> object:
            # What the same is asked of the same scans ends the same.
            if scan_id == "S03" and len(reference) < 3:
                return Failure("REG_DEGENERATE", "too little is known")
            return register(scan_id=scan_id, reference=reference, **more)

        return registered

    monkeypatch.setattr(play.perception, "register_scan", once_more_is_known(register_scan))
    monkeypatch.setattr(play.perception, "register_globally", once_more_is_known(register_globally))
    assert whole.run() == play.run() == "complete"
    assert len(play.survey.scans) == play.calls["take"] == whole.calls["take"] + 1
    assert play.survey.set_aside == ()
    assert play.calls["drive"] == whole.calls["drive"], "no drive half-way back: the scan before it has its place there"
