import time

import numpy as np
import pytest

from drivers.interfaces import ScanSettings
from drivers.jobs import Done, Failed, Running
from drivers.simulated.agents import run_scanner_agent
from drivers.simulated.bodies import Body
from drivers.simulated.clock import VirtualClock
from drivers.simulated.profile import SCANNERS, ScannerProfile
from drivers.simulated.scanner import SimulatedScanner
from drivers.simulated.scanner_device import SimulatedScannerDevice
from drivers.simulated.scenario import ScannerFaults
from drivers.simulated.stance import Stance
from drivers.simulated.truth_log import TruthLog, read_truth
from drivers.simulated.world import Surface
from drivers.wire.endpoints import Endpoints
from perception import transforms
from perception.failure import FailureError
from tests.drivers.simulated_rooms import HEIGHT, shell, world_of

STEP = float(np.deg2rad(1.0))
ROOM = shell(-4.0, -3.0, 4.0, 3.0)
EXACT = ScannerProfile(noise_sigma=0.0, offset_sigma=0.0, cyclic_amplitude=0.0)


def cast(boxes, profile=EXACT, seed=0, scan_id="S1", bodies=(), tilt=(0.0, 0.0), pose=(0.0, 0.0, 0.0)):
    scanner = SimulatedScanner(world_of(boxes), profile, seed)
    at = transforms.planar(*pose)
    scan = scanner.cast(at, STEP, scan_id, np.eye(4), tilt, bodies)
    return scan, transforms.apply(scanner.map_from_scanner(at, tilt), scan.points)


def off_the_walls(points):
    """Distance of each point to the nearest face of the room."""
    x, y, z = np.abs(points[:, 0]), np.abs(points[:, 1]), points[:, 2]
    return np.abs(np.stack([x - 4.0, y - 3.0, z, z - HEIGHT])).min(0)


def test_a_profile_that_nobody_wrote_is_refused_with_those_there_are(tmp_path):
    with pytest.raises(FailureError, match=r"PROFILE_UNKNOWN.*vz-400"):
        run_scanner_agent(tmp_path / "world.npz", tmp_path, "ipc://nobody", Endpoints("ipc://nobody"), profile="vz-4")


def test_a_perfect_scanner_puts_every_point_on_a_wall_whatever_the_pose_and_the_tilt():
    _, points = cast(ROOM, pose=(1.0, -0.5, 0.7), tilt=(0.02, -0.026))
    assert len(points) > 20_000
    assert off_the_walls(points).max() < 1e-3


def test_each_point_lies_on_the_beam_that_is_named_for_it():
    scan, _ = cast(ROOM, SCANNERS["vz-400"])
    directions = scan.pattern.directions(scan.beam)
    ranges = np.linalg.norm(scan.points, axis=1)
    assert np.allclose(scan.points, directions * ranges[:, None], atol=1e-4)
    assert len(np.unique(scan.beam)) == len(scan.beam)
    assert scan.points.dtype == np.float32 and scan.beam.dtype == np.int32


def test_range_noise_has_the_sigma_of_the_profile():
    exact, _ = cast(ROOM)
    noisy, _ = cast(ROOM, ScannerProfile(noise_sigma=0.003, offset_sigma=0.0, cyclic_amplitude=0.0))
    _, a, b = np.intersect1d(exact.beam, noisy.beam, return_indices=True)
    error = np.linalg.norm(noisy.points[b], axis=1) - np.linalg.norm(exact.points[a], axis=1)
    assert error.std() == pytest.approx(0.003, rel=0.05)
    assert abs(error.mean()) < 1e-4


def test_systematic_share_is_the_same_in_every_scan_of_an_instrument_and_about_5_mm_over_instruments():
    exact, _ = cast(ROOM)
    true = np.linalg.norm(exact.points, axis=1)
    profile = ScannerProfile(noise_sigma=0.0)
    errors = []
    for seed in range(12):
        first, _ = cast(ROOM, profile, seed, "S1")
        second, _ = cast(ROOM, profile, seed, "S2")
        _, a, b = np.intersect1d(first.beam, second.beam, return_indices=True)
        assert np.allclose(first.points[a], second.points[b])
        _, a, b = np.intersect1d(first.beam, exact.beam, return_indices=True)
        errors.append(np.linalg.norm(first.points[a], axis=1) - true[b])
    assert 0.002 < np.sqrt(np.mean(np.concatenate(errors) ** 2)) < 0.007
    assert max(np.abs(error).max() for error in errors) < 0.012


def test_the_same_seed_and_name_give_the_same_scan_and_another_name_does_not():
    one, again, other = (cast(ROOM, SCANNERS["vz-400"], 3, name)[0] for name in ("S1", "S1", "S2"))
    assert np.array_equal(one.points, again.points)
    assert not np.array_equal(one.points[:1000], other.points[:1000])


@pytest.mark.parametrize("model, nearest", [("vz-400", 1.5), ("vz-400i", 0.5)])
def test_nothing_returns_nearer_than_the_minimum_range(model, nearest):
    pillar = ((0.7, -0.3, 0.0), (1.0, 0.3, HEIGHT), Surface.FURNITURE)
    scan, _ = cast([*ROOM, pillar], SCANNERS[model])
    ranges = np.linalg.norm(scan.points, axis=1)
    assert ranges.min() >= nearest
    assert (ranges < 1.4).any() == (nearest < 1.0)


def test_open_sky_returns_nothing():
    scan, points = cast([box for box in ROOM if box[2] is not Surface.CEILING])
    assert points[:, 2].max() < HEIGHT + 0.21
    assert not (scan.beam >= scan.pattern.columns * (scan.pattern.rows - 3)).any()


def test_beams_pass_through_glass_but_for_a_few_echoes():
    pane = ((2.5, -1.5, 0.5), (2.51, 1.5, 2.5), Surface.GLASS)
    _, points = cast([*ROOM, pane])
    azimuth, height = np.arctan2(points[:, 1], points[:, 0]), points[:, 2] - 1.3
    through = (np.abs(azimuth) < 0.4) & (np.abs(height / np.hypot(points[:, 0], points[:, 1])) < 0.2)
    on_pane = np.abs(points[through, 0] - 2.505) < 0.02
    assert 0.02 < on_pane.mean() < 0.15
    assert np.allclose(points[through, 0][~on_pane], 4.0, atol=1e-3)


def test_a_mirror_shows_the_room_behind_the_wall():
    mirror = ((3.98, -0.5, 0.8), (4.0, 0.5, 2.0), Surface.MIRROR)
    _, points = cast([*ROOM, mirror])
    ghosts = points[points[:, 0] > 4.3]
    assert len(ghosts) > 100
    # Reflected back at the mirror's face, ghosts lie on the real walls, but for the ghost of the robot.
    real = ghosts * [-1, 1, 1] + [2 * 3.98, 0, 0]
    assert off_the_walls(real[np.abs(real[:, 0]) > 0.46]).max() < 0.01


def test_grazing_beams_are_lost():
    boxes = [((-50.0, -50.0, -0.1), (50.0, 50.0, 0.0), Surface.FLOOR)]
    scan, points = cast(boxes)
    incidence = np.rad2deg(np.arctan2(np.hypot(points[:, 0], points[:, 1]), 1.3))
    assert 80.0 < incidence.max() < 88.0
    kept = np.bincount(np.rint(incidence).astype(int), minlength=90) / scan.pattern.columns
    assert kept[70] == 1.0 and kept[86] < 0.5


def test_a_person_is_seen_and_hides_the_wall():
    _, points = cast(ROOM, bodies=(Body(2.5, 0.0),))
    ahead = np.abs(np.arctan2(points[:, 1], points[:, 0])) < 0.05
    standing = ahead & (points[:, 2] > 0.3) & (points[:, 2] < 1.7) & (points[:, 0] > 0)
    assert np.allclose(np.hypot(points[standing, 0] - 2.5, points[standing, 1]), 0.25, atol=0.01)


def test_the_robot_shadows_the_floor_round_itself():
    _, points = cast(ROOM)
    floor = points[np.abs(points[:, 2]) < 0.01]
    assert np.hypot(floor[:, 0], floor[:, 1]).min() > 1.3


def device(faults=None, truth=None, stance=None):
    clock = VirtualClock()
    standing = stance or (lambda: Stance(transforms.planar(0.5, 0.2, 0.3), (0.01, -0.01), (), False))
    scanner = SimulatedScanner(world_of(ROOM), SCANNERS["vz-400"])
    return SimulatedScannerDevice(scanner, standing, clock, faults, truth), clock


def finished(scanner, clock, name):
    clock.sleep(45.0)
    outcome = scanner.status(name)
    for _ in range(500):
        if not isinstance(outcome, Running):
            break
        time.sleep(0.01)
        outcome = scanner.status(name)
    return outcome


def test_a_scan_takes_its_45_seconds_and_is_taken_once(tmp_path):
    scanner, clock = device(truth=TruthLog(tmp_path))
    assert scanner.status("S1") is None
    scanner.start("S1", ScanSettings(STEP), np.eye(4))
    clock.sleep(22.5)
    running = scanner.status("S1")
    assert isinstance(running, Running) and running.fraction == pytest.approx(0.5)
    outcome = finished(scanner, clock, "S1")
    assert isinstance(outcome, Done) and outcome.value.scan_id == "S1"
    scanner.start("S1", ScanSettings(STEP), np.eye(4))
    assert isinstance(scanner.status("S1"), Done)
    (event,) = read_truth(tmp_path)
    pose = np.array(event["world_from_scanner"])
    points = transforms.apply(pose, outcome.value.points)
    assert np.quantile(off_the_walls(points), 0.95) < 0.02


def test_scripted_faults_come_in_order_and_then_all_is_well():
    scanner, clock = device(ScannerFaults(fail_first=1, hang_first=1, truncate_first=1))
    outcomes = []
    for name in ("S1", "S2", "S3", "S4"):
        scanner.start(name, ScanSettings(STEP), np.eye(4))
        outcomes.append(finished(scanner, clock, name) if name != "S2" else scanner.status(name))
    assert isinstance(outcomes[0], Failed) and outcomes[0].failure.code == "SCAN_FAILED"
    clock.sleep(1000.0)
    assert isinstance(scanner.status("S2"), Running)
    assert len(outcomes[2].value.points) < 0.2 * len(outcomes[3].value.points)


def test_the_self_test_tells_the_tilt_and_what_is_scripted():
    well, _ = device()
    assert well.self_test().faults == ()
    assert well.self_test().figures["tilt_deg"] == pytest.approx(np.degrees(np.hypot(0.01, 0.01)), abs=0.001)
    assert device(ScannerFaults(self_test=("too hot",)))[0].self_test().faults == ("too hot",)


def test_a_scanner_whose_base_is_gone_cannot_tell_how_it_stands():
    def gone():
        raise FailureError("AGENT_UNREACHABLE", "nobody tells")

    assert device(stance=gone)[0].self_test().faults == ("the inclinometer does not answer",)


def test_an_aborted_scan_fails_and_its_name_is_free_again():
    scanner, clock = device()
    scanner.start("S1", ScanSettings(STEP), np.eye(4))
    scanner.abort("S1")
    outcome = scanner.status("S1")
    assert isinstance(outcome, Failed) and outcome.failure.code == "CANCELLED"
    scanner.start("S1", ScanSettings(STEP), np.eye(4))
    assert isinstance(finished(scanner, clock, "S1"), Done)
    scanner.abort("unknown")


def standing_at(x=0.5, moving=False):
    return Stance(transforms.planar(x, 0.2, 0.3), (0.01, -0.01), (), moving)


def test_no_scan_is_begun_while_the_base_moves():
    scanner, clock = device(stance=iter([standing_at(moving=True), standing_at(), standing_at()]).__next__)
    with pytest.raises(FailureError, match=r"SCAN_REJECTED.*S1.*moving"):
        scanner.start("S1", ScanSettings(STEP), np.eye(4))
    assert scanner.status("S1") is None
    scanner.start("S1", ScanSettings(STEP), np.eye(4))
    assert isinstance(finished(scanner, clock, "S1"), Done)


@pytest.mark.parametrize("end", [standing_at(0.52), standing_at(moving=True)], ids=["moved", "moving"])
def test_a_scan_during_which_the_base_moved_is_none(end):
    scanner, clock = device(stance=iter([standing_at(), end, standing_at(0.52), standing_at(0.52)]).__next__)
    scanner.start("S1", ScanSettings(STEP), np.eye(4))
    for _ in range(2):
        outcome = finished(scanner, clock, "S1")
        assert isinstance(outcome, Failed) and outcome.failure.code == "SCAN_MOVED"
    scanner.start("S1", ScanSettings(STEP), np.eye(4))
    assert isinstance(finished(scanner, clock, "S1"), Done), "taken anew it is one"


def test_a_base_that_cannot_be_asked_any_more_does_not_spoil_a_scan():
    answers = [standing_at()]

    def stance():
        if not answers:
            raise FailureError("AGENT_UNREACHABLE", "gone")
        return answers.pop()

    scanner, clock = device(stance=stance)
    scanner.start("S1", ScanSettings(STEP), np.eye(4))
    assert isinstance(finished(scanner, clock, "S1"), Done)
