"""Leaves that send the base somewhere, and the way back along the track."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from py_trees.behaviour import Behaviour
from py_trees.common import Status

from behaviours.driving import DriveToTarget, TargetHalfWayBack, TargetNearby, TargetStart, back_along
from behaviours.keys import Key
from behaviours.survey import PlanarPose, Survey, Target
from drivers.interfaces import DriveGoal, DriveReport
from perception import transforms
from perception.failure import FailureError
from tests.behaviours.bench import Bench, get, put, scan, standing, survey_of, tick

EAST_THEN_NORTH: tuple[PlanarPose, ...] = ((0, 0, 0), (3, 0, 0), (3, 4, 1.57))


def walked(*track: PlanarPose) -> Survey:
    return Survey(track=track)


def length(track: tuple[PlanarPose, ...]) -> float:
    return float(np.linalg.norm(np.diff(np.array(track)[:, :2], axis=0), axis=1).sum())


def on_bench(leaf: Behaviour, survey: Survey, **values: object) -> Bench:
    bench = Bench()
    bench.set_up(leaf)
    put(SURVEY=survey, BASE=bench.base_state, **values)
    return bench


def driving(survey: Survey | None = None) -> tuple[Bench, DriveToTarget]:
    leaf = DriveToTarget("drive")
    bench = on_bench(leaf, survey or survey_of(scan("S01")), TARGET=Target("G001", 2.0, 1.0, 0.5, "view"))
    assert tick(leaf) == Status.RUNNING
    return bench, leaf


def goal(bench: Bench) -> DriveGoal:
    name, (order,), _ = bench.calls[-1]
    assert name == "drive"
    assert isinstance(order, DriveGoal)
    return order


# --- back along the track -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("distance", "expected"), [(1.0, (3, 3)), (4.0, (3, 0)), (5.5, (1.5, 0)), (7.0, (0, 0)), (99.0, (0, 0))]
)
def test_back_along_follows_the_track_and_ends_at_its_start(distance: float, expected: tuple[float, float]) -> None:
    x, y, yaw = back_along(walked(*EAST_THEN_NORTH), distance)
    assert (x, y) == pytest.approx(expected)
    assert yaw is None, "any heading will do"


def test_back_along_passes_over_places_where_the_base_only_turned() -> None:
    assert back_along(walked((0, 0, 0), (2, 0, 0), (2, 0, 3.0)), 0.5)[:2] == pytest.approx((1.5, 0))


@pytest.mark.parametrize("track", [(), ((1.0, 2.0, 0.0),)])
def test_there_is_no_way_back_before_the_base_has_moved(track: tuple[PlanarPose, ...]) -> None:
    with pytest.raises(FailureError, match="NAV_NO_TRACK"):
        back_along(walked(*track), 0.5)


coordinate = st.floats(-20, 20, allow_subnormal=False)
tracks = st.lists(st.tuples(coordinate, coordinate, st.just(0.0)), min_size=2, max_size=8).map(tuple)


@given(tracks, st.floats(0.01, 30))
def test_back_along_stays_on_the_track_and_goes_no_further_than_asked(
    track: tuple[PlanarPose, ...], distance: float
) -> None:
    x, y, _ = back_along(walked(*track), distance)
    ends = np.array(track)[:, :2]
    spans = np.diff(ends, axis=0)
    share = np.einsum("ij,ij->i", (x, y) - ends[:-1], spans) / np.maximum(np.einsum("ij,ij->i", spans, spans), 1e-12)
    nearest = ends[:-1] + np.clip(share, 0, 1)[:, None] * spans
    assert np.linalg.norm(nearest - (x, y), axis=1).min() < 1e-5
    assert np.hypot(x - ends[-1, 0], y - ends[-1, 1]) <= min(distance, length(track)) + 1e-6


# --- targets --------------------------------------------------------------------------------------------------------


def test_a_spot_nearby_is_half_a_metre_back() -> None:
    leaf = TargetNearby("nearby")
    on_bench(leaf, walked(*EAST_THEN_NORTH))
    assert tick(leaf) == Status.SUCCESS
    assert get(Key.TARGET) == Target("G001", 3.0, 3.5, None, "nearby")


@pytest.mark.parametrize(("driven", "expected"), [(6.0, (3, 1)), (0.2, (3, 3.5))])
def test_half_way_back_is_half_of_what_was_driven_but_never_nearly_nothing(
    driven: float, expected: tuple[float, float]
) -> None:
    leaf = TargetHalfWayBack("half-way")
    on_bench(leaf, Survey(track=EAST_THEN_NORTH, driven=driven))
    assert tick(leaf) == Status.SUCCESS
    assert (get(Key.TARGET).x, get(Key.TARGET).y) == pytest.approx(expected)
    assert get(Key.TARGET).purpose == "bridge"


def test_the_start_is_where_the_first_scan_was_taken() -> None:
    leaf = TargetStart("start")
    on_bench(leaf, survey_of(scan("S01", 1.0, 2.0), scan("S02", 5.0, 5.0)))
    assert tick(leaf) == Status.SUCCESS
    assert (get(Key.TARGET).x, get(Key.TARGET).y, get(Key.TARGET).yaw) == (1.0, 2.0, 0.0)


def test_without_a_scan_there_is_no_start_to_go_to() -> None:
    leaf = TargetStart("start")
    bench = on_bench(leaf, Survey())
    assert tick(leaf) == Status.FAILURE
    assert bench.codes == ["NAV_NO_MAP"]


def test_no_two_goals_have_the_same_name() -> None:
    leaf = TargetNearby("nearby")
    on_bench(leaf, walked(*EAST_THEN_NORTH))
    names = []
    for _ in range(3):
        tick(leaf)
        names.append(get(Key.TARGET).goal_id)
    assert names == ["G001", "G002", "G003"]


# --- the drive ------------------------------------------------------------------------------------------------------


def test_the_goal_is_the_target_in_the_newest_map() -> None:
    bench, _ = driving()
    order = goal(bench)
    assert (order.goal_id, order.map_id, order.x, order.y, order.yaw) == ("G001", "map_1", 2.0, 1.0, 0.5)


def test_a_base_that_stands_where_it_was_registered_is_told_so() -> None:
    bench, _ = driving(survey_of(scan("S01"), scan("S02", 0.0, 0.0)))
    order = goal(bench)
    assert order.map_from_base is not None
    assert np.allclose(order.map_from_base, np.eye(4))


@pytest.mark.parametrize("moved", [standing(0.05), standing(yaw=0.1), None], ids=["driven", "turned", "silent"])
def test_a_base_that_has_moved_since_knows_better_itself(moved: object) -> None:
    leaf = DriveToTarget("drive")
    bench = on_bench(leaf, survey_of(scan("S01")), TARGET=Target("G001", 2.0, 1.0, None, "view"))
    put(BASE=moved)
    tick(leaf)
    assert goal(bench).map_from_base is None


def test_a_base_that_began_anew_since_it_was_registered_does_not_set_out() -> None:
    leaf = DriveToTarget("drive")
    bench = on_bench(leaf, survey_of(scan("S01")), TARGET=Target("G001", 2.0, 1.0, None, "view"))
    put(BASE=standing(odom_frame="another"))
    assert tick(leaf) == Status.FAILURE
    assert get(Key.FAILURE).code == "NAV_INTERRUPTED"
    assert bench.calls == []


@pytest.mark.parametrize(
    ("survey", "target", "code"),
    [
        (survey_of(scan("S01")), None, "NAV_NO_TARGET"),
        (Survey(), Target("G001", 0.0, 0.0, None, "view"), "NAV_NO_MAP"),
    ],
)
def test_nobody_is_sent_nowhere_or_without_a_map(survey: Survey, target: Target | None, code: str) -> None:
    leaf = DriveToTarget("drive")
    bench = on_bench(leaf, survey, TARGET=target)
    assert tick(leaf) == Status.FAILURE
    assert (bench.codes, bench.calls) == ([code], [])


def test_an_arrival_extends_the_track_and_the_distance_since_the_last_scan() -> None:
    bench, leaf = driving()
    bench.clock.sleep(12.0)
    bench.job.done(DriveReport("G001", transforms.planar(2, 1, 0.5), ((1, 0, 0), (2, 1, 0.5)), 2.4))
    assert tick(leaf) == Status.SUCCESS
    survey = get(Key.SURVEY)
    assert survey.track == ((0, 0, 0), (1, 0, 0), (2, 1, 0.5))
    assert (survey.driven, survey.position) == (2.4, (2, 1))
    (event,) = bench.events
    assert (event["kind"], event["result"], event["distance"], event["seconds"]) == ("drive", "arrived", 2.4, 12.0)


def test_a_blocked_drive_keeps_what_was_driven() -> None:
    bench, leaf = driving()
    bench.job.failed("NAV_BLOCKED", track=[[1.0, 0.0, 0.0]], distance=1.0, map_from_base=None)
    assert tick(leaf) == Status.FAILURE
    assert get(Key.SURVEY).track[-1] == (1.0, 0.0, 0.0)
    assert get(Key.SURVEY).driven == 1.0
    assert [event["result"] for event in bench.events if event["kind"] == "drive"] == ["NAV_BLOCKED"]


def test_a_drive_that_nobody_reported_counts_as_far_as_telemetry_tells() -> None:
    bench, leaf = driving()
    put(BASE=standing(0.0, 3.0, map_from_base=transforms.planar(0.0, 3.0, 1.0)))
    bench.job.failed("AGENT_UNREACHABLE")
    assert tick(leaf) == Status.FAILURE
    assert get(Key.SURVEY).driven == pytest.approx(3.0)
    assert get(Key.SURVEY).track[-1] == pytest.approx((0.0, 3.0, 1.0))


def test_a_drive_that_takes_too_long_is_cancelled() -> None:
    bench, leaf = driving()
    bench.clock.sleep(bench.services.settings.driving.timeout_s + 1)
    assert tick(leaf) == Status.FAILURE
    assert (bench.codes, bench.job.cancelled) == (["NAV_TIMEOUT"], 1)
