import time

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from drivers.simulated.bodies import Body, Track, standing
from drivers.simulated.clock import ScaledClock, VirtualClock
from drivers.simulated.costmap import CostMap
from drivers.simulated.lidar import Lidar, Sweep
from drivers.simulated.localiser import Localiser
from drivers.simulated.obstruction import Obstruction
from drivers.simulated.odometry import Odometry
from drivers.simulated.planner import Planner
from drivers.simulated.plant import Tilt, WheelLoop
from drivers.simulated.profile import BaseProfile, GuardProfile, LidarProfile, OdometryProfile
from drivers.simulated.safety import SafetyMonitor
from drivers.simulated.scenario import load_scenario
from drivers.simulated.side_channel import StanceServer, ask_stance
from drivers.simulated.stance import Stance
from drivers.simulated.surroundings import Surroundings
from drivers.simulated.world import Surface
from perception import transforms
from perception.failure import FailureError
from perception.grids import Cell, Grid
from tests.drivers.simulated_rooms import perfect_map, shell, two_rooms, world_of

FOOTPRINT = (0.9, 0.6)
WORLD = two_rooms()
MAP = perfect_map(WORLD)
NOTHING = np.empty((0, 2))


def test_a_scaled_clock_runs_faster_than_the_wall_and_a_virtual_one_only_when_told():
    fast, still = ScaledClock(100.0), VirtualClock()
    before = fast.now()
    fast.sleep(1.0)
    assert 1.0 <= fast.now() - before < 60.0
    assert still.now() == 0.0
    still.sleep(2.5)
    assert still.now() == 2.5


def test_a_wheel_reaches_its_speed_within_the_acceleration_limit_and_comes_to_rest():
    wheel = WheelLoop(acceleration=1.0)
    speeds = [0.0, *(wheel.step(target, 0.05) for target in [0.5] * 60 + [0.0] * 60)]
    assert speeds[60] == pytest.approx(0.5, abs=0.01)
    assert np.abs(np.diff(speeds)).max() < 0.05 * 1.4
    assert max(speeds) < 0.56
    assert speeds[-1] == 0.0


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.floats(-40, 40), st.floats(-40, 40))
def test_the_floor_never_leans_the_robot_further_than_its_limit_and_does_so_smoothly(seed, x, y):
    limit = float(np.deg2rad(1.5))
    tilt = Tilt(limit, seed)
    here, there = np.array(tilt.at(x, y)), np.array(tilt.at(x + 0.01, y))
    assert np.abs(here).max() <= limit
    assert np.abs(there - here).max() < np.deg2rad(0.1)


def test_odometry_errors_stay_within_the_figures_of_the_profile():
    lengths, turns = [], []
    for seed in range(40):
        odometry = Odometry(OdometryProfile(slips_per_metre=0.0), seed)
        for _ in range(200):
            odometry.moved(0.02, 0.0)
        x, y, yaw = odometry.pose
        lengths.append(np.hypot(x, y))
        turns.append(np.rad2deg(yaw))
    assert np.abs(np.array(lengths) / 4.0 - 1.0).max() < 0.025
    assert 0.6 < np.std(turns) < 1.5  # half a degree after a metre, one after four


def test_the_footprint_touches_exactly_what_it_overlaps():
    obstruction = Obstruction(WORLD, FOOTPRINT)
    clear = 4.0 - 0.45
    assert not obstruction.touches(clear - 0.015, 1.0, 0.0)
    assert obstruction.touches(clear + 0.005, 1.0, 0.0)
    assert not obstruction.touches(4.1, 2.0, 0.0)
    assert obstruction.touches(4.1, 2.0, np.pi / 2)
    assert obstruction.touches(2.0, 2.0, 0.0, (Body(2.5, 2.2),))
    assert not obstruction.touches(2.0, 2.0, 0.0, (Body(2.75, 2.0),))


def test_what_is_lower_than_3_cm_or_higher_than_the_mast_is_not_touched():
    bar = ((1.0, 1.0, 0.0), (1.1, 3.0, 0.02), Surface.OTHER)
    lamp = ((2.0, 1.0, 1.6), (2.4, 3.0, 1.8), Surface.FURNITURE)
    table = ((3.0, 1.0, 0.72), (3.4, 3.0, 0.75), Surface.FURNITURE)
    obstruction = Obstruction(world_of([*shell(0, 0, 8, 4), bar, lamp, table]), FOOTPRINT)
    assert [obstruction.touches(x, 2.0, np.pi / 2) for x in (1.0, 2.2, 3.2)] == [False, False, True]


def test_a_track_is_walked_in_a_straight_line_between_its_times():
    track = Track(((10.0, 0.0, 0.0), (20.0, 5.0, 0.0)))
    assert track.at(9.9) is None and track.at(20.1) is None
    body = track.at(15.0)
    assert (body.x, body.y, body.yaw) == (2.5, 0.0, 0.0)
    assert len(standing((track, track), 12.0)) == 2


@settings(max_examples=15, deadline=None)
@given(
    st.floats(0.6, 3.4), st.floats(0.6, 3.4), st.floats(-3.1, 3.1),
    st.floats(-0.05, 0.05), st.floats(-0.05, 0.05), st.floats(-0.03, 0.03),
)  # fmt: skip
def test_the_localiser_finds_back_from_a_few_centimetres(x, y, yaw, dx, dy, turn):
    sweep = Lidar(Surroundings(WORLD), LidarProfile(), GuardProfile(columns=4), 0).sweep(x, y, yaw, ())
    localiser = Localiser(MAP, (x + dx, y + dy, yaw + turn))
    for _ in range(5):
        localiser.correct(sweep.plane)
    off = np.hypot(localiser.pose[0] - x, localiser.pose[1] - y)
    assert off < 0.04
    assert abs(np.angle(np.exp(1j * (localiser.pose[2] - yaw)))) < np.deg2rad(1.0)


def test_hits_that_the_map_does_not_know_do_not_move_the_localiser():
    localiser = Localiser(MAP, (2.0, 2.0, 0.0))
    crowd = np.stack([np.full(200, 1.0), np.linspace(-0.6, 0.6, 200)], axis=1)
    assert not localiser.correct(crowd)
    assert localiser.pose == (2.0, 2.0, 0.0)


@settings(max_examples=12, deadline=None)
@given(st.floats(0.6, 7.6), st.floats(0.6, 3.4), st.one_of(st.none(), st.floats(-3.1, 3.1)))
@example(4.5, 1.0, None)
@example(4.461714850398344, 1.715828626947569, None)
def test_no_pose_of_a_plan_touches_anything(x, y, yaw):
    obstruction = Obstruction(WORLD, FOOTPRINT)
    try:
        path = Planner(FOOTPRINT).plan(CostMap(MAP, FOOTPRINT), (1.0, 1.0, 0.3), (x, y, yaw))
    except FailureError as error:
        assert error.failure.code == "NAV_NO_PATH"
        return
    assert not any(obstruction.touches(*pose) for pose in path.poses)
    assert np.hypot(*(path.poses[-1, :2] - (x, y))) < 0.1


def test_a_table_top_is_an_overhang_and_a_cupboard_is_not():
    table = ((1.0, -0.5, 0.7), (2.0, 0.5, 0.73), Surface.FURNITURE)
    cupboard = ((-2.0, -0.5, 0.0), (-1.0, 0.5, 1.8), Surface.FURNITURE)
    surroundings = Surroundings(world_of([*shell(-4, -4, 4, 4), table, cupboard]))
    sweep = Lidar(surroundings, LidarProfile(), GuardProfile(), 0).sweep(0.0, 0.0, 0.0, ())
    assert len(sweep.overhang) > 20
    assert sweep.overhang[:, 0].min() > 0.9 and np.abs(sweep.overhang[:, 1]).max() < 0.6
    ahead = np.abs(np.arctan2(sweep.plane[:, 1], sweep.plane[:, 0])) < 0.2
    assert sweep.plane[ahead, 0].min() > 3.9


def test_the_cost_map_forgets_who_has_gone_but_remembers_table_tops():
    cost_map = CostMap(Grid(np.full((80, 80), Cell.FREE, np.uint8), (0.0, 0.0), 0.05), FOOTPRINT)
    pose = (1.0, 2.0, 0.0)
    person = np.stack([np.full(9, 1.0), np.linspace(-0.2, 0.2, 9)], axis=1)
    wall = np.stack([np.full(400, 2.5), np.linspace(-2, 2, 400)], axis=1)
    cost_map.observe(pose, Sweep(np.concatenate([person, wall]), NOTHING))
    assert cost_map.is_seen_under((2.0, 2.0, 0.0))
    cost_map.observe(pose, Sweep(wall, NOTHING))
    assert not cost_map.is_seen_under((2.0, 2.0, 0.0))
    cost_map.observe(pose, Sweep(wall, person))
    cost_map.observe(pose, Sweep(wall, NOTHING))
    assert cost_map.is_seen_under((2.0, 2.0, 0.0))


@settings(max_examples=60, deadline=None)
@given(st.floats(0.0, 0.5), st.floats(-0.6, 0.6), st.floats(0.35, 1.2), st.floats(-0.6, 0.6))
def test_the_safety_monitor_leaves_room_to_stop(speed, turn_rate, x, y):
    profile = BaseProfile()
    hits = np.array([[x, y]] * 3)
    if abs(x) < 0.48 and abs(y) < 0.33:
        return
    v, w = SafetyMonitor(profile).limit((speed, turn_rate), Sweep(hits, NOTHING))
    assert abs(v) <= speed and abs(w) <= abs(turn_rate)
    heading, px, py = 0.0, 0.0, 0.0
    for _ in range(200):
        px, py, heading = px + v * np.cos(heading) * 0.01, py + v * np.sin(heading) * 0.01, heading + w * 0.01
        cos, sin = np.cos(heading), np.sin(heading)
        dx, dy = x - px, y - py
        assert abs(cos * dx + sin * dy) > 0.449 or abs(cos * dy - sin * dx) > 0.299
        v -= np.sign(v) * min(abs(v), profile.acceleration * 0.01)
        w -= np.sign(w) * min(abs(w), profile.turn_acceleration * 0.01)


def test_the_side_channel_tells_the_stance_and_says_when_nobody_is_there():
    stance = Stance(transforms.planar(1.0, 2.0, 0.5), (0.01, -0.02), (Body(3.0, 4.0),), True)
    server = StanceServer(lambda: stance)
    told = ask_stance(server.endpoint)
    server.close()
    assert np.allclose(told.map_from_base, stance.map_from_base)
    assert (told.tilt, told.bodies, told.moving) == (stance.tilt, stance.bodies, True)
    with pytest.raises(FailureError, match="SCAN_FAILED"):
        ask_stance(server.endpoint, timeout=0.6)


def test_a_base_that_answers_late_is_waited_for():
    """Later than the first question waits, as on a busy machine: the answer to a newer one counts."""
    stance = Stance(np.eye(4), (0.0, 0.0), (), False)

    def late() -> Stance:
        time.sleep(0.8)
        return stance

    server = StanceServer(late)
    assert not ask_stance(server.endpoint).moving
    server.close()


def test_a_scenario_is_read_from_yaml(tmp_path):
    path = tmp_path / "scenario.yaml"
    path.write_text(
        "tracks: [{kind: cart, waypoints: [[0, 1, 2], [9, 1, 2]]}]\n"
        "scanner: {fail_first: 2}\n"
        "base: {slip_at: [3.0], emergency_stop: [[5, 6]]}\n"
    )
    scenario = load_scenario(path)
    assert scenario.tracks[0].at(4.0).height == 1.0
    assert scenario.scanner.fail_first == 2
    assert scenario.base.emergency_stop == ((5.0, 6.0),)
