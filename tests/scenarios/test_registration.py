"""Missions in which a scan does not find its place at once."""

import math

import numpy as np

from tests.scenarios.play import Play
from tests.scenarios.scripted import EVER, ONCE, TWICE
from tests.scenarios.site import row


def test_a_refused_registration_is_tried_by_features() -> None:
    """Odometry was off: ICP slides and is refused, global registration near the guess is accepted. Nobody drives."""
    play = Play(row(1))
    play.script.fail("register_scan", "REG_LOW_OVERLAP")
    assert play.run() == "complete"
    assert [scan.registration.method for scan in play.survey.scans] == ["anchor", "global"]
    (asked,) = play.perception.of_stage("register_globally")
    assert asked["error_m"] == play.settings.registration.global_search_m
    assert asked["error_rad"] == math.pi
    assert (play.calls["take"], play.calls["register_globally"]) == (2, 1)
    assert play.events.codes == ["REG_LOW_OVERLAP"]


def test_a_scan_without_a_place_finds_it_after_a_bridging_scan_half_way_back() -> None:
    """ICP and features are both refused. A scan half-way back is placed, and with it the first one is placed too."""
    play = Play(row(1))
    play.script.fail("register_scan", "REG_DEGENERATE").fail("register_globally", "REG_AMBIGUOUS")
    assert play.run() == "complete"
    assert [event["purpose"] for event in play.events.of("drive")] == ["view", "bridge", "start"]
    assert play.survey.set_aside == ()
    assert [scan.scan_id for scan in play.survey.scans] == ["S01", "S02", "S03"], "the newest is where the base stands"
    for scan in play.survey.scans:
        assert np.allclose(scan.map_from_base, play.scanner.taken[scan.scan_id])
    view, bridge = (play.scanner.taken[name][:2, 3] for name in ("S02", "S03"))
    assert np.allclose(bridge, view / 2)
    assert (play.calls["take"], play.calls["register_scan"], play.calls["register_globally"]) == (3, 3, 1)


def test_a_bridged_scan_is_tried_against_all_that_is_known_by_its_own_guess() -> None:
    """The set-aside scan is registered to the bridging one too, and from where its own odometry said it was."""
    play = Play(row(1))
    play.script.fail("register_scan", "REG_DEGENERATE").fail("register_globally", "REG_AMBIGUOUS")
    play.run()
    first, bridging, again = play.perception.of_stage("register_scan")
    assert (first["scan_id"], bridging["scan_id"], again["scan_id"]) == ("S02", "S03", "S02")
    assert [name for name, _ in again["reference"]] == ["S01", "S03"]
    assert np.allclose(again["guess"], first["guess"])
    assert bridging["error_m"] > first["error_m"], "more was driven since the last scan with a place"


def test_a_scan_set_aside_that_finds_no_place_even_then_costs_only_itself() -> None:
    """The bridging scan is good, the old one is refused a second time: the room goes on without it."""
    play = Play(row(1))
    play.script.fail("register_scan", "REG_DEGENERATE", [1, 3]).fail("register_globally", "REG_AMBIGUOUS")
    assert play.run() == "complete"
    assert [scan.scan_id for scan in play.survey.scans] == ["S01", "S03"]
    assert play.survey.set_aside == ()
    assert play.rooms == {"A": ("complete", "lambda_mu")}
    assert play.events.codes[:3] == ["REG_DEGENERATE", "REG_AMBIGUOUS", "REG_DEGENERATE"]


def test_registration_that_is_always_refused_leaves_the_room_partial_with_its_code() -> None:
    """Neither scan finds a place: no pose is made up, the room ends with the refusal, and the robot goes home."""
    play = Play(row(1))
    play.script.fail("register_scan", "REG_DEGENERATE", EVER).fail("register_globally", "REG_AMBIGUOUS", EVER)
    assert play.run() == "incomplete"
    assert play.rooms == {"A": ("partial", "REG_AMBIGUOUS")}
    assert [scan.scan_id for scan in play.survey.scans] == ["S01"]
    assert play.calls["take"] == 3
    assert np.allclose(play.base.pose[:2], (0, 0))


def test_a_bridge_that_cannot_be_reached_does_not_hide_why_it_was_wanted() -> None:
    """The way back is blocked as well. The room's reason is the refused registration; the blocked way is on record."""
    play = Play(row(1))
    play.script.fail("register_scan", "REG_DEGENERATE", ONCE).fail("register_globally", "REG_AMBIGUOUS", ONCE)
    play.script.fail("drive", "NAV_STUCK", [2])
    assert play.run() == "incomplete"
    assert play.rooms == {"A": ("partial", "REG_AMBIGUOUS")}
    assert "NAV_STUCK" in play.events.codes


def test_a_stage_that_dies_is_no_reason_to_build_a_bridge() -> None:
    """The worker, not the scan, is what failed: driving half-way back would not help."""
    play = Play(row(1))
    play.script.fail("register_scan", "PERC_DIED", TWICE).fail("register_globally", "PERC_DIED", TWICE)
    assert play.run() == "incomplete"
    assert play.rooms == {"A": ("partial", "PERC_DIED")}
    assert [event["purpose"] for event in play.events.of("drive")] == ["view", "start"]


def test_the_first_scan_of_all_needs_no_reference_and_its_failure_keeps_its_name() -> None:
    """The map frame cannot be made: there is nothing to register to, and the reason says what really happened."""
    play = Play(row(1))
    play.script.fail("anchor_scan", "PERC_DIED", TWICE)
    assert play.run() == "incomplete"
    assert play.rooms == {"A": ("partial", "PERC_DIED")}
    assert play.calls["register_scan"] == 0
