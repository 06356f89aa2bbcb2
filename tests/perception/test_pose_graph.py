"""The pose graph on rings of poses whose truth is known, and on scans of a small room."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perception import pose_graph, transforms
from perception.failure import FailureError
from perception.matching.surfels import surface_of
from perception.pose_graph import Comparison
from perception.scan import BeamPattern
from tests.synthetic import Scene, box

INFORMATION = np.diag([4.0, 4.0, 4.0, 0.3, 0.3, 0.3])
COUNT = 24


def ring_of_truth():
    """Stations round a square of 18 m, each a little tilted."""
    angles = 2 * np.pi * np.arange(COUNT) / COUNT
    places = 9 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    return {f"S{n:02d}": transforms.from_euler(0.01, -0.01, 2.3 * n, (x, y, 1.3)) for n, (x, y) in enumerate(places)}


def crept(truth, rng, metres=0.002, radians=4e-4):
    """The chain: each relative pose a little wrong, so that the ring does not close."""
    names, poses = list(truth), {}
    poses[names[0]] = truth[names[0]]
    for before, after in pairwise(names):
        error = transforms.from_euler(*rng.normal(0, radians / 4, 2), rng.normal(0, radians), rng.normal(0, metres, 3))
        poses[after] = poses[before] @ transforms.inverse(truth[before]) @ truth[after] @ error
    return poses


def compared(truth, target, source, rng, metres=0.0002):
    error = transforms.from_euler(*rng.normal(0, 3e-5, 3), rng.normal(0, metres, 3))
    relative = transforms.inverse(truth[target]) @ truth[source] @ error
    return Comparison(target, source, relative, INFORMATION, 0.0015, 0.6)


def neighbours(truth, rng):
    names = list(truth)
    return [compared(truth, names[n - back], names[n], rng) for n in range(COUNT) for back in (1, 2) if n >= back]


def closing(truth, rng):
    names = list(truth)
    return [compared(truth, names[0], names[-1], rng), compared(truth, names[1], names[-1], rng)]


def worst(poses, truth):
    return max(transforms.difference(truth[name], poses[name])[0] for name in truth)


def drifting_ring(seed):
    """A ring, its chain, and the comparisons of neighbours: these repeat the chain's errors, as in a building they do,
    for both come from the same surfaces."""
    rng = np.random.default_rng(seed)
    truth = ring_of_truth()
    chain = crept(truth, rng)
    return rng, truth, chain, neighbours(chain, rng)


@pytest.mark.parametrize("seed", range(6))
def test_a_closed_loop_takes_out_what_crept_along_the_chain(seed):
    rng, truth, chain, pairs = drifting_ring(seed)
    found = pose_graph.optimise(chain, [*pairs, *closing(truth, rng)])
    assert found.reason == "" and found.disbelieved == ()
    gap = transforms.difference(chain["S23"], truth["S23"])[0]
    assert transforms.difference(found.poses["S23"], truth["S23"])[0] < 0.3 * gap + 0.001
    assert worst(found.poses, truth) < 0.9 * worst(chain, truth)
    assert found.rms_after < found.rms_before
    assert np.array_equal(found.poses["S00"], chain["S00"]) or np.allclose(found.poses["S00"], chain["S00"], atol=1e-9)


def test_a_chain_without_a_loop_stays_where_it_is():
    _, _, chain, pairs = drifting_ring(1)
    found = pose_graph.optimise(chain, pairs)
    assert worst(found.poses, chain) < 0.005
    assert found.disbelieved == ()


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 5),
    ends=st.tuples(st.integers(0, COUNT - 1), st.integers(0, COUNT - 1)).filter(lambda ends: ends[0] < ends[1]),
    off=st.floats(0.10, 3.0),  # nearer than what crept it cannot be told from a loop
    way=st.floats(0, 2 * np.pi),
    turn=st.floats(-0.5, 0.5),
)
def test_one_grossly_false_comparison_is_disbelieved_and_changes_nothing(seed, ends, off, way, turn):
    rng, truth, chain, pairs = drifting_ring(seed)
    pairs += closing(truth, rng)
    a, b = (f"S{n:02d}" for n in ends)
    said = transforms.planar(off * np.cos(way), off * np.sin(way), turn)
    false = replace(compared(chain, a, b, rng), target_from_source=transforms.inverse(chain[a]) @ chain[b] @ said)
    others = [pair for pair in pairs if (pair.target, pair.source) != (a, b)]
    found, without = pose_graph.optimise(chain, [*others, false]), pose_graph.optimise(chain, others)
    assert (a, b) in found.disbelieved
    assert worst(found.poses, without.poses) < 0.001
    assert worst(found.poses, truth) < worst(without.poses, truth) + 0.001


def test_a_loop_that_gapes_further_than_anything_crept_is_left_open():
    rng, truth, chain, pairs = drifting_ring(0)
    away = {**truth, "S23": truth["S23"] @ transforms.planar(0.4, 0.0, 0.0)}
    found = pose_graph.optimise(chain, [*pairs, *closing(away, rng)])
    assert found.disbelieved == (("S00", "S23"), ("S01", "S23"))
    assert worst(found.poses, chain) < 0.005


def test_a_scan_that_would_move_further_than_registration_can_err_stays_with_the_reason():
    """All that is known of the last scan puts it 15 cm away: rather a registration is wrong than all of that crept."""
    rng, _, chain, _ = drifting_ring(0)
    away = {**chain, "S23": chain["S23"] @ transforms.planar(0.15, 0.0, 0.0)}
    found = pose_graph.optimise(chain, neighbours(away, rng))
    assert "more than a registration can be wrong" in found.reason
    assert found.moved_m == 0.0
    assert worst(found.poses, chain) == 0.0
    assert found.residuals["S23"] > 0.05


def test_nothing_compared_is_nothing_changed():
    truth = ring_of_truth()
    found = pose_graph.optimise(truth, [])
    assert worst(found.poses, truth) == 0.0 and found.residuals == {} and found.compared == 0


def test_residual_is_the_distance_of_the_surfaces_that_the_poses_leave():
    """A wall 3 mm off head-on: 3 mm are added (in squares) to the 1.5 mm that the pair cannot do without."""
    truth = {"S01": np.eye(4), "S02": transforms.planar(4.0, 0.0, 0.5), "S03": transforms.planar(9.0, 0.0, 0.0)}
    along_x = np.zeros((6, 6))
    along_x[3, 3] = 1.0
    pair = Comparison("S01", "S02", truth["S02"], along_x, 0.0015, 0.5)
    shifted = {**truth, "S02": truth["S02"] @ transforms.planar(0.003, 0.2, 0.0)}
    assert pair.disagreement(shifted) == pytest.approx(0.003)
    found = pose_graph.residuals(shifted, [pair])
    assert found == pytest.approx({"S01": np.hypot(0.003, 0.0015), "S02": np.hypot(0.003, 0.0015)})


# --- scans ----------------------------------------------------------------------------------------------------------

PATTERN = BeamPattern.with_step(np.deg2rad(0.8), (np.deg2rad(-40), np.deg2rad(60)), (0.5, 120.0))


def pose(x, y, yaw):
    return transforms.from_euler(0.005, -0.01, yaw, (x, y, 1.3))


@pytest.fixture(scope="module")
def room():
    """Surfaces and poses of two scans of a furnished room and of one outside of it."""
    scene = Scene(box((0, 0, 0), (7, 5, 3)), box((3, 2, 0), (4.4, 2.8, 0.75)), box((9, 0, 0), (14, 5, 3)))
    truth = {"S01": pose(2, 1.5, 0.3), "S02": pose(5, 3.6, -1.9), "S03": pose(11, 2, 1.0)}
    return {
        name: surface_of(scene.take(at, PATTERN, seed=n).points) for n, (name, at) in enumerate(truth.items())
    }, truth


def test_two_scans_of_a_room_are_compared_to_a_millimetre(room):
    surfaces, truth = room
    believed = transforms.inverse(truth["S01"]) @ truth["S02"]
    pair = pose_graph.compare(("S01", surfaces["S01"]), ("S02", surfaces["S02"]), believed @ pose_error(0.01))
    distance, angle = transforms.difference(pair.target_from_source, believed)
    assert distance < 0.002 and angle < np.deg2rad(0.03)
    assert pair.overlap > 0.5 and pair.rmse < 0.004


def pose_error(metres):
    return transforms.planar(metres, -metres, metres / 4)


def test_information_tells_how_the_surfaces_part_when_a_scan_is_moved(room):
    """The quadratic form against the distances themselves: surfels moved by hand, their partners' planes kept."""
    surfaces, truth = room
    believed = transforms.inverse(truth["S01"]) @ truth["S02"]
    pair = pose_graph.compare(("S01", surfaces["S01"]), ("S02", surfaces["S02"]), believed)
    for axis in range(3):
        motion = np.zeros(3)
        motion[axis] = 0.005
        shifted = {"S01": np.eye(4), "S02": pair.target_from_source @ transforms.from_euler(0, 0, 0, motion)}
        share = np.mean(surfaces["S02"].surfels.normals[:, axis] ** 2)
        assert pair.disagreement(shifted) == pytest.approx(0.005 * np.sqrt(share), rel=0.35)


def test_scans_that_do_not_fit_where_the_map_has_them_are_refused(room):
    surfaces, truth = room
    believed = transforms.inverse(truth["S01"]) @ truth["S02"]
    with pytest.raises(FailureError, match="REG_"):
        pose_graph.compare(("S01", surfaces["S01"]), ("S02", surfaces["S02"]), believed @ pose_error(0.5))


def test_only_scans_that_see_the_same_surface_are_paired(room):
    surfaces, truth = room
    footprints = {name: pose_graph.footprint(surfaces[name], truth[name]) for name in truth}
    assert pose_graph.pairs_to_compare(footprints) == [("S01", "S02")]


def test_a_scan_is_paired_with_its_neighbours_and_with_those_that_close_a_loop_and_with_no_more():
    """Footprints along a ring: each shares with the next two; the last one meets the first ones again."""
    footprints = {f"S{n:02d}": np.arange(100 * n, 100 * n + 300) for n in range(12)}
    footprints["S11"] = np.union1d(footprints["S11"][:150], np.arange(0, 150))
    pairs = pose_graph.pairs_to_compare(footprints)
    assert [pair for pair in pairs if pair[1] == "S05"] == [("S04", "S05"), ("S03", "S05")]
    assert {pair[0] for pair in pairs if pair[1] == "S11"} >= {"S00", "S10"}
    crowd = {f"S{n:02d}": np.arange(100) for n in range(40)}
    assert len(pose_graph.pairs_to_compare(crowd)) <= 4 * 40
