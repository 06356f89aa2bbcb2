"""Missions in which nothing goes wrong."""

import inspect
from dataclasses import replace

import numpy as np
import pytest

from behaviours.settings import BuildingSettings, Settings
from tests.scenarios.play import Play
from tests.scenarios.scripted import EVER, MOUNT
from tests.scenarios.site import Site, row, star, twice_joined


def test_three_rooms_in_a_row_are_scanned_one_after_the_other_and_the_robot_comes_home() -> None:
    """Two scans finish each room; the robot goes under each door once, finds no third one, and drives to its start."""
    play = Play(row(3))
    assert play.run() == "complete"
    assert play.rooms == dict.fromkeys("ABC", ("complete", "lambda_mu"))
    assert play.doors == ["passed", "passed"]
    assert [event["purpose"] for event in play.events.of("drive")] == ["view", "door", "view", "door", "view", "start"]
    assert np.allclose(play.base.pose[:2], (0, 0))
    assert play.calls["take"] == play.calls["fetch"] == play.calls["align_scan"] == 6
    assert (play.calls["anchor_scan"], play.calls["register_scan"], play.calls["register_globally"]) == (1, 5, 0)
    assert play.calls["find_doors"] == 3
    assert play.events.codes == []


def test_poses_are_those_the_scans_were_taken_at() -> None:
    """Odometry starts somewhere else and turned; the guess that registration gets is right all the same."""
    play = Play(row(3))
    play.run()
    assert np.max(play.perception.guess_errors) < 1e-9
    for scan in play.survey.scans:
        assert np.allclose(scan.map_from_base, play.scanner.taken[scan.scan_id])
        assert np.allclose(scan.map_from_scanner, play.scanner.taken[scan.scan_id] @ MOUNT)


def test_each_drive_sets_out_from_a_registered_pose_in_the_newest_map() -> None:
    """Registration knows better than the base where it stands, and each drive of this mission begins at a scan."""
    play = Play(row(2))
    play.run()
    assert all(goal.map_from_base is not None for goal in play.base.goals)
    assert [goal.map_id for goal in play.base.goals] == ["map_S01", "map_S02", "map_S03", "map_S04"]


def test_each_scan_is_one_cycle_of_its_room_with_its_figures() -> None:
    """The books of a room tell per cycle how much was seen, and by which figures it was ended."""
    play = Play(row(2))
    play.run()
    for room in play.survey.building.rooms:
        cycles = play.survey.cycles[room.id]
        assert [cycle.scan_id for cycle in cycles] == [scan.scan_id for scan in play.survey.room_scans(room.id)]
        assert [cycle.counts.seen for cycle in cycles] == [9000, 9200]
        assert [cycle.decision.stop for cycle in cycles] == [False, True]
        assert cycles[1].decision.growing_rate == pytest.approx(200 / 9200)
    numbers = [arguments["cycle"] for arguments in play.perception.of_stage("label_space")]
    assert numbers == [1, 2, 1, 2]


def test_rooms_around_a_hall_are_each_entered_once() -> None:
    """From each room the way to the next leads back through the hall, which is not scanned again."""
    play = Play(star())
    assert play.run() == "complete"
    assert sorted(play.rooms) == ["A", "B", "C", "D"]
    assert play.calls["take"] == 8
    assert play.doors == ["passed"] * 3


def test_a_second_door_to_a_room_is_known_to_lead_there() -> None:
    """Two doors join A and B. One is passed; the other turns out to be its neighbour and is left alone."""
    play = Play(twice_joined())
    assert play.run() == "complete"
    assert sorted(play.rooms) == ["A", "B"]
    assert sorted(play.doors) == ["linked", "passed"]
    assert play.calls["take"] == 4


def test_poses_are_adjusted_when_a_door_closes_a_loop_and_once_more_at_the_end() -> None:
    """A tree of rooms is looked at only at the end, where every scan gets its residual."""
    tree, loop = Play(star()), Play(twice_joined())
    assert tree.run() == loop.run() == "complete"
    assert (tree.calls["optimise_poses"], loop.calls["optimise_poses"]) == (1, 2)
    assert [len(asked["scans"]) for asked in loop.perception.of_stage("optimise_poses")] == [4, 4]
    assert {scan.residual for scan in tree.survey.scans} == {0.002}


def test_a_pose_graph_that_fails_costs_nothing_but_the_residuals() -> None:
    play = Play(twice_joined())
    play.script.fail("optimise_poses", "PERC_TIMEOUT", EVER)
    assert play.run() == "complete"
    assert {scan.residual for scan in play.survey.scans} == {None}
    assert play.events.codes == ["PERC_TIMEOUT", "PERC_TIMEOUT"]


def test_a_room_whose_views_promise_nothing_ends_without_a_confirming_scan() -> None:
    """After one scan the best view would show 500 of 80,000 seen voxels: the room is complete."""
    play = Play(row(1))
    play.perception.seen = [80_000]
    assert play.run() == "complete"
    assert play.rooms == {"A": ("complete", "predicted_gain")}
    assert play.calls["take"] == 1


def test_a_robot_that_need_not_come_home_ends_where_it_is() -> None:
    """The site's settings say so: the last drive is to the last view."""
    play = Play(row(2), settings=replace(Settings(), building=BuildingSettings(return_to_start=False)))
    assert play.run() == "complete"
    assert [event["purpose"] for event in play.events.of("drive")] == ["view", "door", "view"]


def test_a_second_mission_in_the_same_process_knows_nothing_of_the_first() -> None:
    """The blackboard is global: the first mission's outcome, door and room must not meet the second one."""
    assert Play(row(2)).run() == "complete"
    second = Play(row(1))
    assert second.run() == "complete"
    assert list(second.rooms) == ["A"]


@pytest.mark.parametrize("site", [row(2), star()], ids=["row", "star"])
def test_a_mission_is_the_same_each_time(site: Site) -> None:
    """Virtual clock, scripted drivers: two runs leave the same events, to the last figure."""
    first, second = Play(site), Play(site)
    first.run()
    second.run()
    assert first.events == second.events


def test_what_the_tree_asks_of_the_stages_is_what_they_take() -> None:
    """The scripted worker takes anything; the real one's stages must take the very arguments that were sent."""
    from mission.stages import STAGES

    play = Play(row(2))
    play.script.fail("register_scan", "REG_LOW_OVERLAP")
    play.run()
    asked = {stage for stage, _ in play.perception.requests}
    assert asked == set(STAGES) - {"warm_up"}
    for stage, arguments in play.perception.requests:
        inspect.signature(STAGES[stage]).bind(None, **arguments)
