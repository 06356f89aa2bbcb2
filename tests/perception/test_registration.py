from dataclasses import replace

import numpy as np
import pytest

from perception import transforms
from perception.failure import FailureError
from perception.global_registration import register_globally
from perception.registration import (
    NEAR_ODOMETRY,
    RegistrationLimits,
    anchor,
    judge,
    reference_from,
    register,
    surface_of,
)
from perception.scan import BeamPattern
from tests.shared_data import SCANS
from tests.synthetic import Scene, box

PATTERN = BeamPattern.with_step(np.deg2rad(0.6), (np.deg2rad(-40), np.deg2rad(60)), (1.5, 120.0))
EXPECTED = (0.2, np.deg2rad(2.0))


def furnished_room():
    return Scene(
        box((0, 0, 0), (7, 5, 3)),
        box((0, 3, 0), (0.6, 4.5, 2)),
        box((3, 2, 0), (4.4, 2.8, 0.75)),
        box((6.2, 0, 0), (7, 1.2, 1.2)),
        box((2, 4.6, 0), (3, 5, 2.2)),
    )


def bare_corridor(length):
    """Walls, floor and ceiling only; the ends are out of sight."""
    return Scene(box((0, 0, 0), (length, 2.2, 2.8)))


def pose(x, y, yaw, tilt=(0.0, 0.0), z=1.3):
    return transforms.from_euler(*tilt, yaw, (x, y, z))


def surface(scene, at, seed):
    return surface_of(scene.take(at, PATTERN, seed=seed).points)


@pytest.fixture(scope="module")
def room():
    scene = furnished_room()
    first, second = pose(2, 1.5, 0.3, (0.01, -0.005)), pose(5, 3.6, -1.9, (-0.012, 0.006))
    surfaces = surface(scene, first, 1), surface(scene, second, 2)
    return surfaces[1], reference_from([(surfaces[0], first)]), second


@pytest.mark.parametrize("seed", range(4))
def test_pose_is_found_to_millimetres_from_a_poor_guess(room, seed):
    source, reference, truth = room
    rng = np.random.default_rng(seed)
    error = transforms.from_euler(*rng.normal(0, 0.002, 2), rng.uniform(-0.08, 0.08))
    guess = truth @ error
    guess[:3, 3] += [*rng.uniform(-0.35, 0.35, 2), rng.normal(0, 0.01)]
    found = register(source, reference, guess)
    judge(found, EXPECTED)
    distance, angle = transforms.difference(truth, found.map_from_scanner)
    assert distance < 0.002
    assert angle < np.deg2rad(0.02)
    assert found.correction_m == pytest.approx(transforms.difference(guess, found.map_from_scanner)[0])


def test_chain_of_scans_does_not_drift():
    scene = furnished_room()
    rng = np.random.default_rng(3)
    truths = [pose(x, y, yaw) for x, y, yaw in rng.uniform((1, 1, -3), (6, 4, 3), (6, 3)) if not 2.5 < x < 4.9]
    known = [(surface(scene, truths[0], 0), truths[0])]
    for n, truth in enumerate(truths[1:], 1):
        source = surface(scene, truth, n)
        guess = truth @ transforms.planar(*rng.normal(0, 0.1, 2), rng.normal(0, 0.02))
        known.append((source, register(source, reference_from(known), guess).map_from_scanner))
    distance, angle = transforms.difference(truths[-1], known[-1][1])
    assert len(known) >= 3
    assert distance < 0.003 and angle < np.deg2rad(0.03)


def test_instrument_that_measures_too_long_does_not_shift_the_pose(room):
    """5 mm on every range move walls by different amounts seen head-on and from aside."""
    _, _, truth = room
    scene, first = furnished_room(), pose(2, 1.5, 0.3, (0.01, -0.005))

    def long_surface(at, seed):
        points = scene.take(at, PATTERN, seed=seed).points
        return surface_of(points * (1 + 0.005 / np.linalg.norm(points, axis=1, keepdims=True)))

    reference = reference_from([(long_surface(first, 1), first)])
    found = register(long_surface(truth, 2), reference, truth @ transforms.planar(0.1, 0.1, 0.02))
    distance, angle = transforms.difference(truth, found.map_from_scanner)
    assert distance < 0.001 and angle < np.deg2rad(0.01)


@pytest.fixture(scope="module")
def corridor():
    scene = bare_corridor(400.0)
    first, second = pose(200, 1.0, 0.0), pose(204, 1.2, 0.1)
    return surface(scene, second, 2), reference_from([(surface(scene, first, 1), first)]), second


@pytest.mark.parametrize("slide", [0.3, 2.0])
def test_slide_along_a_bare_corridor_is_refused(corridor, slide):
    source, reference, second = corridor
    found = register(source, reference, transforms.planar(slide, 0, 0) @ second)
    with pytest.raises(FailureError, match="REG_DEGENERATE"):
        judge(found, (1.0, 0.1))
    assert abs(found.weak_axis[0]) > 0.99


def test_scan_of_another_room_is_refused(room):
    _, reference, _ = room
    elsewhere = Scene(box((0, 0, 0), (11, 8.5, 3)), box((4, 4, 0), (6, 5, 1)), box((0, 0, 0), (2, 1, 2)))
    found = register(surface(elsewhere, pose(5, 2, 0), 3), reference, pose(3, 2, 0))
    with pytest.raises(FailureError, match="REG_"):
        judge(found, (1.0, 0.5))


def test_place_that_earlier_scans_saw_through_is_refused():
    """A box room twice as long fits a shorter one wherever the scan overlaps; only what was seen through tells."""
    long_room, short_room = Scene(box((0, 0, 0), (8, 4, 3))), Scene(box((0, 0, 0), (5, 4, 3)))
    at = pose(2, 1.5, 0.2)
    found = register(surface(short_room, at, 1), reference_from([(surface(long_room, at, 2), at)]), at)
    assert found.conflict > 0.03
    with pytest.raises(FailureError, match="seen through"):
        judge(found, EXPECTED)


def test_odometry_vouches_for_a_place_from_which_a_mirrors_wall_is_seen_through():
    """As much as a pane shows of the wall opposite; nobody vouches for what a search over the whole map has found."""
    found = replace(anchor(transforms.planar(0.0, 0.0, 0.0)), conflict=0.07)
    judge(found, EXPECTED, NEAR_ODOMETRY)
    for limits, conflict in ((RegistrationLimits(), 0.07), (NEAR_ODOMETRY, 0.1)):
        with pytest.raises(FailureError, match="seen through"):
            judge(replace(found, conflict=conflict), EXPECTED, limits)


def test_people_and_ghosts_do_not_move_the_pose(room):
    _, reference, truth = room
    scan = furnished_room().take(truth, PATTERN, seed=2)
    rng = np.random.default_rng(0)
    person = rng.normal((2.0, 0.5, -0.4), (0.15, 0.15, 0.5), (3000, 3))
    ghosts = scan.points[: len(scan.points) // 8] * 1.6
    found = register(
        surface_of(np.vstack([scan.points, person, ghosts])), reference, truth @ transforms.planar(0.2, -0.1, 0.03)
    )
    distance, angle = transforms.difference(truth, found.map_from_scanner)
    assert distance < 0.003 and angle < np.deg2rad(0.03)


def test_correction_beyond_what_odometry_allows_is_refused(room):
    source, reference, truth = room
    found = register(source, reference, transforms.planar(0.4, 0, 0) @ truth)
    with pytest.raises(FailureError, match="REG_INCONSISTENT"):
        judge(found, (0.02, 0.005))


@pytest.mark.parametrize(("axis", "name"), [((0.0, 0.0, 1.0), "an upright"), ((1.0, 0.0, 0.0), "a level")])
def test_a_scan_that_nothing_keeps_from_turning_is_refused(axis, name):
    held = anchor(transforms.planar(0.0, 0.0, 0.0))
    judge(held, (0.1, 0.05))
    with pytest.raises(FailureError, match=f"REG_DEGENERATE.*turning about {name} axis"):
        judge(replace(held, turn_hold=0.004, turn_axis=axis), (0.1, 0.05))


def test_nan_points_are_ignored_and_too_few_are_refused(room):
    _, reference, truth = room
    points = furnished_room().take(truth, PATTERN, seed=2).points.copy()
    points[::50] = np.nan
    found = register(surface_of(points), reference, truth)
    assert transforms.difference(truth, found.map_from_scanner)[0] < 0.002
    with pytest.raises(FailureError, match="REG_DIVERGED"):
        register(surface_of(points[:40]), reference, truth)


def test_global_search_finds_the_pose_without_a_heading(room):
    source, reference, truth = room
    rng = np.random.default_rng(0)
    near = transforms.planar(0, 0, rng.uniform(-3, 3)) @ truth
    near[:2, 3] = truth[:2, 3] + rng.uniform(-2, 2, 2)
    found = register_globally(source, reference, near)
    judge(found, (1.5, np.pi))
    assert found.method == "global"
    assert transforms.difference(truth, found.map_from_scanner)[0] < 0.002


def test_empty_box_room_is_ambiguous_to_a_global_search_but_not_near_a_heading():
    scene = Scene(box((0, 0, 0), (6, 4, 3)))
    first, second = pose(2, 2, 0.0), pose(3.2, 2.1, 0.4)
    source, reference = surface(scene, second, 1), reference_from([(surface(scene, first, 0), first)])
    with pytest.raises(FailureError, match="REG_AMBIGUOUS"):
        register_globally(source, reference, second)
    found = register_globally(source, reference, second, yaw=np.deg2rad(45))
    assert transforms.difference(second, found.map_from_scanner)[0] < 0.002


def test_real_pair_of_spinning_lidar_scans_agrees_with_its_reference():
    folder = SCANS / "gicp_pair"
    if not folder.exists():
        pytest.skip("the shared real scans are not here")
    import open3d as o3d

    clouds = [np.asarray(o3d.io.read_point_cloud(str(folder / f"{name}.ply")).points) for name in ("target", "source")]
    truth = np.loadtxt(folder / "T_target_source.txt")
    target, source = (surface_of(cloud, 0.25) for cloud in clouds)
    found = register(source, reference_from([(target, np.eye(4))]), np.eye(4))
    distance, angle = transforms.difference(truth, found.map_from_scanner)
    assert distance < 0.05 and angle < np.deg2rad(0.5)
