"""Missions with faults drawn from a seed: whatever befalls them, they end as they should. At length: make campaign."""

import random
from functools import cache

import numpy as np
import pytest

from drivers.interfaces import DriveReport
from perception.findings import ViewChoice
from tests.scenarios.faults import EVENTS, OPERATIONS, Event, befall, shortened, ways_of, with_numbers
from tests.scenarios.ordeal import by_chance
from tests.scenarios.play import Play
from tests.scenarios.scripted import FOR_GOOD
from tests.scenarios.site import row

SEEDS = range(25)
REPORT = DriveReport("G1", np.eye(4), ((0.0, 1.0, 2.0), (3.0, 4.0, 5.0)), 3.0)


@cache
def quiet(rooms: int) -> Play:
    """A mission that nothing befell."""
    play = Play(row(rooms))
    play.run()
    return play


@pytest.mark.parametrize("seed", SEEDS)
def test_a_mission_with_faults_by_chance_keeps_every_promise(seed: int) -> None:
    """One seed again: ``python -m benchmarks.faults --seed SEED``."""
    by_chance(seed)


def test_a_seed_is_one_mission_for_ever() -> None:
    assert by_chance(5) == by_chance(5)


@pytest.mark.parametrize(
    ("operation", "way"), [(operation, way) for operation in ("take", "segment_room") for way in ways_of(operation)]
)
def test_each_way_is_felt_by_a_mission_of_one_room(operation: str, way: str) -> None:
    """A fault that does not bite proves nothing."""
    play = Play(row(1))
    befall(play, operation, way, 1, 2, random.Random(0))
    play.run()
    assert (play.events.codes, play.clock.now()) != (quiet(1).events.codes, quiet(1).clock.now())


@pytest.mark.parametrize("name", ["person", "cart"])
def test_who_stands_at_a_view_blocks_the_drive_to_it(name: str) -> None:
    """The room is seen so slowly that every view of it is driven to."""
    play = Play(row(1))
    play.perception.seen = [2000, 4000, 6000, 8000, 9000]
    play.each_tick = Event(name, *EVENTS[name](play, random.Random(0)), 1, FOR_GOOD).at
    assert play.run() == "incomplete"
    assert play.events.codes == ["NAV_BLOCKED"]
    assert play.rooms == {"A": ("partial", "views_blocked")}


@pytest.mark.parametrize("name", sorted(set(EVENTS) - {"person", "cart", "slip"}))
def test_each_other_event_is_felt_by_a_mission_of_two_rooms(name: str) -> None:
    play = Play(row(2))
    chance = random.Random(0)
    play.each_tick = Event(name, *EVENTS[name](play, chance), 5, 40).at
    play.run()
    assert (play.phases, play.ticks) != (quiet(2).phases, quiet(2).ticks)


def test_a_slip_is_found_out_by_registration() -> None:
    play = Play(row(2))
    play.each_tick = lambda play, ticks: play.base.slip(0.6, 0.5, 0.1) if ticks == 10 else None
    assert play.run() == "complete"
    assert "REG_INCONSISTENT" in play.events.codes
    assert all(np.allclose(scan.map_from_base, play.scanner.taken[scan.scan_id]) for scan in play.survey.scans)


def test_a_door_that_was_not_reached_for_any_reason_is_left_with_that_reason() -> None:
    """The base's driver breaks on the way to a door: the mission does not end there as if there were no door."""
    play = Play(row(3))
    befall(play, "drive", "garbage", 2, 1, random.Random(0))
    assert play.run() == "complete"
    assert play.doors == ["passed", "passed"]
    stuck = Play(row(2))
    befall(stuck, "drive", "garbage", 2, FOR_GOOD, random.Random(0))
    assert stuck.run() == "incomplete"
    assert stuck.doors == ["refused"]


def test_a_view_that_is_nowhere_is_not_driven_to() -> None:
    play = Play(row(1))
    befall(play, "choose_view", "NaN", 1, 1, random.Random(0))
    play.run()
    assert "NAV_NO_TARGET" in play.events.codes
    assert all(np.isfinite([goal.x, goal.y]).all() for goal in play.base.goals)


@pytest.mark.parametrize("operation", ["anchor_scan", "register_scan", "segment_room", "drive", "optimise_poses"])
def test_a_result_that_is_no_number_is_not_used(operation: str) -> None:
    play = Play(row(2))
    befall(play, operation, "NaN", 1, 1, random.Random(0))
    play.run()
    assert "RESULT_NOT_FINITE" in play.events.codes
    assert all(np.isfinite(scan.map_from_scanner).all() for scan in play.survey.scans)


def test_values_are_spoilt_all_through_and_nothing_else_is() -> None:
    scaled = with_numbers(REPORT, lambda number: number * 1000)
    assert scaled.distance == 3000.0 and scaled.track[1] == (3000.0, 4000.0, 5000.0) and scaled.goal_id == "G1"
    assert scaled.map_from_base[0, 0] == 1000.0
    assert [len(part) for part in shortened(REPORT, lambda length: length // 2).track] == [3]
    assert shortened(ViewChoice((), 7), lambda length: 0) == ViewChoice((), 0)


def test_every_operation_is_one_that_a_mission_asks_for() -> None:
    play = Play(row(2))
    play.script.fail("register_scan", "REG_LOW_OVERLAP", [1])
    play.base.reboot()
    play.run()
    assert set(OPERATIONS) <= set(play.calls)
