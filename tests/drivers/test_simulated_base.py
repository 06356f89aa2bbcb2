import time

import numpy as np
import pytest

from drivers.jobs import Done, Failed, Running
from drivers.lease import NEVER
from drivers.simulated.base import SimulatedBase
from drivers.simulated.bodies import Track
from drivers.simulated.clock import ScaledClock
from drivers.simulated.scenario import BaseFaults, Scenario
from drivers.simulated.truth_log import TruthLog, read_truth
from perception import transforms
from perception.grids import Cell
from tests.drivers.simulated_rooms import goal, perfect_map, run, two_rooms

WORLD = two_rooms()
MAP = perfect_map(WORLD)
DOORWAY = (4.1, 2.0, 0.0)
BEYOND = (7.0, 3.0, None)
FOR_EVER = 1e9


def base_in(world=WORLD, **options):
    base = SimulatedBase(world, **options)
    base.permit(FOR_EVER)
    return base


def drive(base, place, name="g1", known=WORLD.start, seconds=120.0, robot_map=MAP):
    base.start_drive(goal(robot_map, place, known, name))
    taken = run(base, seconds, name)
    return base.drive_status(name), taken


def misses(base, place):
    """Metres and degrees between where the base truly stands and where it should."""
    x, y, yaw = transforms.to_planar(base.stance().map_from_base)
    turn = 0.0 if place[2] is None else np.angle(np.exp(1j * (yaw - place[2])))
    return float(np.hypot(x - place[0], y - place[1])), abs(float(np.rad2deg(turn)))


@pytest.mark.parametrize("seed", range(3))
def test_it_stands_under_a_door_of_90_cm_within_5_cm_and_3_degrees_and_drives_on(seed):
    base = base_in(seed=seed)
    outcome, _ = drive(base, DOORWAY)
    assert isinstance(outcome, Done), outcome
    off, turn = misses(base, DOORWAY)
    assert off < 0.05 and turn < 3.0
    outcome, _ = drive(base, BEYOND, "g2", known=None)
    assert isinstance(outcome, Done), outcome
    assert misses(base, BEYOND)[0] < 0.10
    assert base.collisions == 0
    believed, _ = transforms.difference(base.telemetry().map_from_base, base.stance().map_from_base)
    assert believed < 0.05


def test_the_report_tells_the_way_it_took():
    base = base_in()
    outcome, _ = drive(base, BEYOND)
    track = np.array(outcome.value.track)
    steps = np.linalg.norm(np.diff(track[:, :2], axis=0), axis=1)
    assert np.allclose(track[0, :2], WORLD.start[:2], atol=0.05)
    assert np.allclose(track[-1, :2], BEYOND[:2], atol=0.15)
    assert steps.max() < 0.1
    assert outcome.value.distance == pytest.approx(steps.sum(), abs=0.1)


def test_a_goal_without_a_way_fails_at_once_and_nothing_is_driven():
    closed = MAP.with_data(MAP.data.copy())
    (row, first), (_, last) = MAP.cells_of([[4.1, 1.5], [4.1, 2.5]])
    closed.data[row : MAP.cells_of([4.1, 2.5])[0] + 1, first : last + 1] = Cell.OBSTACLE
    base = base_in()
    outcome, taken = drive(base, BEYOND, robot_map=closed)
    assert isinstance(outcome, Failed) and outcome.failure.code == "NAV_NO_PATH"
    assert taken < 0.2
    assert misses(base, WORLD.start)[0] == 0.0


def test_a_goal_inside_a_wall_has_no_path():
    outcome, _ = drive(base_in(), (4.1, 0.8, None))
    assert isinstance(outcome, Failed) and outcome.failure.code == "NAV_NO_PATH"


def test_a_door_of_70_cm_is_passed_and_one_of_55_cm_is_not():
    for width, passes in ((0.72, True), (0.55, False)):
        world = two_rooms(width)
        base = base_in(world)
        outcome, _ = drive(base, BEYOND, robot_map=perfect_map(world))
        assert isinstance(outcome, Done) == passes, (width, outcome)
        assert base.collisions == 0


def test_it_waits_for_a_person_in_the_door_and_goes_on():
    person = Track(((0.0, 4.1, 2.0), (14.0, 4.1, 2.0), (17.0, 6.5, 3.5), (FOR_EVER, 6.5, 3.5)))
    base = base_in(scenario=Scenario(tracks=(person,)))
    base.start_drive(goal(MAP, (5.5, 2.0, None), WORLD.start))
    activities = set()
    for _ in range(800):
        base.step(0.05)
        activities.add(str(base.telemetry().activity))
        if not isinstance(base.drive_status("g1"), Running):
            break
    assert isinstance(base.drive_status("g1"), Done), base.drive_status("g1")
    assert "waiting" in activities
    assert base.collisions == 0


def test_it_drives_round_a_person_who_stays():
    person = Track(((0.0, 2.9, 3.5), (2.0, 2.8, 2.1), (FOR_EVER, 2.8, 2.1)))
    base = base_in(scenario=Scenario(tracks=(person,)))
    outcome, taken = drive(base, DOORWAY)
    assert isinstance(outcome, Done), outcome
    assert taken > 20.0
    assert base.collisions == 0


def test_a_way_that_stays_blocked_fails_with_where_it_has_been():
    cart = Track(((0.0, 4.1, 2.0), (FOR_EVER, 4.1, 2.0)), kind="cart")
    base = base_in(scenario=Scenario(tracks=(cart,)))
    outcome, taken = drive(base, BEYOND)
    assert isinstance(outcome, Failed) and outcome.failure.code == "NAV_BLOCKED"
    assert 20.0 < taken < 100.0
    assert len(outcome.failure.evidence["track"]) > 5
    assert np.shape(outcome.failure.evidence["map_from_base"]) == (4, 4)
    assert base.collisions == 0
    believed = np.array(outcome.failure.evidence["map_from_base"])
    assert transforms.difference(believed, base.stance().map_from_base)[0] < 0.06


def test_odometry_drifts_within_its_bounds_and_never_jumps():
    bases = [base_in(seed=seed) for seed in range(4)]
    drifts = []
    for base in bases:
        last = base.telemetry().odom_from_base
        base.start_drive(goal(MAP, BEYOND, WORLD.start))
        while isinstance(base.drive_status("g1"), Running):
            base.step(0.05)
            now = base.telemetry().odom_from_base
            assert transforms.difference(last, now)[0] < 0.08
            last = now
        true = transforms.inverse(transforms.planar(*WORLD.start)) @ base.stance().map_from_base
        drifts.append(transforms.difference(true, last)[0])
    assert 0.01 < max(drifts) < 0.6
    assert len({round(drift, 6) for drift in drifts}) == 4


def test_spinning_wheels_do_not_lose_it():
    base = base_in(scenario=Scenario(base=BaseFaults(slip_at=(1.0, 2.5))))
    outcome, _ = drive(base, BEYOND)
    assert isinstance(outcome, Done), outcome
    assert misses(base, BEYOND)[0] < 0.10


def test_no_drive_ever_touches_anything():
    base = base_in(seed=11)
    rng = np.random.default_rng(5)
    done = 0
    for index in range(6):
        place = (float(rng.uniform(0.7, 7.5)), float(rng.uniform(0.7, 3.3)), None)
        outcome, _ = drive(base, place, f"g{index}", WORLD.start if index == 0 else None)
        done += isinstance(outcome, Done)
        assert isinstance(outcome, Done) or outcome.failure.code == "NAV_NO_PATH", outcome
    assert done >= 4
    assert base.collisions == 0


def test_a_stop_ends_the_goal_and_the_wheels():
    base = base_in()
    base.start_drive(goal(MAP, BEYOND, WORLD.start))
    run(base, 2.0)
    assert base.telemetry().moving
    base.stop()
    run(base, 2.0)
    outcome = base.drive_status("g1")
    assert isinstance(outcome, Failed) and outcome.failure.code == "CANCELLED" and outcome.failure.evidence["track"]
    for _ in range(30):
        base.step(0.05)
    assert not base.telemetry().moving
    assert base.telemetry().activity == "stopped"


def test_the_same_goal_is_not_driven_twice_and_a_new_one_takes_over():
    base = base_in()
    base.start_drive(goal(MAP, BEYOND, WORLD.start, "g1"))
    run(base, 1.0)
    base.start_drive(goal(MAP, (1.0, 3.0, None), None, "g2"))
    run(base, 60.0, "g2")
    assert base.drive_status("g1").failure.code == "CANCELLED"
    assert isinstance(base.drive_status("g2"), Done)
    at = misses(base, BEYOND)
    base.start_drive(goal(MAP, BEYOND, WORLD.start, "g1"))
    run(base, 1.0, "g1")
    assert misses(base, BEYOND) == at
    assert base.drive_status("g3") is None


def test_the_red_button_stops_it_and_is_told():
    base = base_in(scenario=Scenario(base=BaseFaults(emergency_stop=((2.0, 4.0),))))
    outcome, taken = drive(base, BEYOND)
    assert isinstance(outcome, Failed) and outcome.failure.code == "ESTOP"
    assert taken == pytest.approx(2.0, abs=0.11)
    assert base.telemetry().emergency_stop and not base.telemetry().moving


def test_a_base_that_was_never_told_where_it_stands_does_not_drive():
    outcome, _ = drive(base_in(), BEYOND, known=None)
    assert isinstance(outcome, Failed) and outcome.failure.code == "NAV_STUCK"


def test_the_truth_log_has_drives_and_collisions(tmp_path):
    wall_missing = MAP.with_data(np.full_like(MAP.data, Cell.FREE))
    base = base_in(truth=TruthLog(tmp_path))
    drive(base, (2.5, 2.0, None), robot_map=wall_missing)
    begun, ended = read_truth(tmp_path)
    assert (begun["event"], ended["event"]) == ("drive_begun", "drive")
    assert begun["goal_id"] == ended["goal_id"]
    assert ended["distance"] > 0.5


def test_a_touch_ends_the_drive_at_once_and_pushing_on_is_a_touch_again(tmp_path):
    """A cart is rammed into its side, quicker than any sensor sees, and stays there."""
    hit, at = 3.0, base_in()
    at.start_drive(goal(MAP, DOORWAY, WORLD.start))
    run(at, hit)
    x, y, _ = at._plant.pose
    waits, rams = (x + 0.3, y + 9.0), (x + 0.3, y)
    cart = Track(((0.0, *waits), (hit, *waits), (hit + 0.05, *rams), (1e6, *rams)), "cart")
    base = base_in(scenario=Scenario(tracks=(cart,)), truth=TruthLog(tmp_path))
    outcome, taken = drive(base, DOORWAY)
    assert isinstance(outcome, Failed) and outcome.failure.code == "COLLISION"
    assert taken < hit + 0.2
    assert not base.telemetry().moving and base.telemetry().activity == "idle"
    assert np.allclose(transforms.planar(*base._plant.pose), base.stance().map_from_base)
    assert [event["event"] for event in read_truth(tmp_path)].count("collision") == base.collisions == 1


def test_it_runs_by_itself_on_a_clock():
    base = base_in()
    clock = ScaledClock(20.0)
    base.start_drive(goal(MAP, (2.2, 1.5, None), WORLD.start))
    base.run(clock, lambda: not isinstance(base.drive_status("g1"), Running) or clock.now() > 200.0)
    assert isinstance(base.drive_status("g1"), Done)


def test_it_does_not_move_before_it_is_permitted_to():
    base = SimulatedBase(WORLD)
    outcome, _ = drive(base, BEYOND, seconds=3.0)
    assert isinstance(outcome, Running)
    assert misses(base, WORLD.start)[0] == 0.0
    assert base.telemetry().activity == "held"


def test_a_held_base_stands_at_once_keeps_its_goal_and_its_patience_and_arrives_when_it_may():
    base = base_in()
    base.start_drive(goal(MAP, DOORWAY, WORLD.start))
    run(base, 3.0)
    assert base.telemetry().moving
    base.permit(NEVER)
    base.step(0.05)
    assert not base.telemetry().moving and base.telemetry().activity == "held"
    at = base.stance().map_from_base
    assert run(base, 100.0) == 100.0, "it waits for longer than it would for anything else"
    assert np.array_equal(base.stance().map_from_base, at)
    base.permit(FOR_EVER)
    base.step(0.05)
    assert base.telemetry().activity == "driving", "it does not think that it got stuck"
    run(base, 120.0)
    assert isinstance(base.drive_status("g1"), Done), base.drive_status("g1")
    assert misses(base, DOORWAY)[0] < 0.10 and base.collisions == 0


def test_wherever_on_its_way_it_is_held_it_goes_on_at_once_or_has_arrived():
    base = base_in()
    base.start_drive(goal(MAP, DOORWAY, WORLD.start))
    holds = 0
    while isinstance(base.drive_status("g1"), Running):
        run(base, 0.15)
        base.permit(NEVER)
        base.step(0.05)
        assert not base.telemetry().moving
        base.permit(FOR_EVER)
        run(base, 0.1)
        assert base.telemetry().moving or isinstance(base.drive_status("g1"), Done), holds
        holds += 1
        assert holds < 1000
    assert isinstance(base.drive_status("g1"), Done) and holds > 20
    assert misses(base, DOORWAY)[0] < 0.10


def test_a_permit_runs_out_by_itself():
    base = SimulatedBase(WORLD)
    base.start_drive(goal(MAP, BEYOND, WORLD.start))
    base.permit(FOR_EVER)
    run(base, 3.0)
    base.permit(time.monotonic() + 0.1)
    base.step(0.05)
    assert base.telemetry().moving
    time.sleep(0.1)
    base.step(0.05)
    assert not base.telemetry().moving


def test_a_held_base_obeys_a_stop():
    base = base_in()
    base.start_drive(goal(MAP, BEYOND, WORLD.start))
    run(base, 2.0)
    base.permit(NEVER)
    base.stop()
    base.step(0.05)
    assert base.drive_status("g1").failure.code == "CANCELLED"


def test_who_steps_in_front_of_a_held_base_is_seen_before_it_goes_on():
    person = Track(((0.0, 3.0, 3.5), (4.0, 3.0, 3.5), (5.0, 3.2, 1.8), (FOR_EVER, 3.2, 1.8)))
    base = base_in(scenario=Scenario(tracks=(person,)))
    base.start_drive(goal(MAP, DOORWAY, WORLD.start))
    run(base, 1.5)
    base.permit(NEVER)
    run(base, 6.0)
    base.permit(FOR_EVER)
    run(base, 20.0)
    assert base.collisions == 0


class StallingClock(ScaledClock):
    """Lets whoever sleeps on it wait too long, once; then tells how it goes on."""

    def __init__(self, base):
        super().__init__(1.0)
        self.base, self.stalled, self.moving_after = base, False, None

    def now(self):
        if self.stalled and self.moving_after is None:
            self.moving_after = self.base.telemetry().moving
        return super().now()

    def sleep(self, seconds):
        if not self.stalled and self.base.telemetry().moving:
            time.sleep(0.3)
            self.stalled = True
        super().sleep(seconds)


def test_a_control_loop_that_stalled_finds_its_wheels_at_rest():
    base = base_in()
    clock = StallingClock(base)
    base.start_drive(goal(MAP, (2.2, 1.5, None), WORLD.start))
    base.run(clock, lambda: clock.moving_after is not None)
    assert clock.moving_after is False
