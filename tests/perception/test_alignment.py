"""Alignment against the pose that the scan was taken from."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perception import transforms
from perception.alignment import align
from perception.failure import FailureError
from perception.scan import BeamPattern
from tests.synthetic import Scene, box

PATTERN = BeamPattern.with_step(np.deg2rad(0.6), (np.deg2rad(-40), np.deg2rad(60)), (1.5, 120.0))
TABLES = [box((x, y, 0.70), (x + 1.6, y + 0.8, 0.74)) for x in (0.4, 5.6) for y in (0.3, 1.6, 2.9, 4.2)]
CLASSROOM = Scene(box((0, 0, 0), (8, 6, 3.0)), box((6.2, 0, 2.6), (8, 6, 3.0)), *TABLES)


def _scan(scene, position, roll_deg, pitch_deg, yaw, pattern=PATTERN, seed=0):
    pose = transforms.from_euler(0, 0, yaw) @ transforms.from_euler(np.deg2rad(roll_deg), np.deg2rad(pitch_deg), 0)
    pose[:3, 3] = position
    return scene.take(pose, pattern, seed=seed).points, pose


def _tilt_error_deg(alignment, pose):
    # Up in the scanner's frame, as found and as it was; the cross product keeps precision for small angles.
    return np.rad2deg(np.arcsin(np.linalg.norm(np.cross(alignment.level_from_scanner[2, :3], pose[2, :3]))))


def _yaw_error_deg(alignment, yaw):
    return np.rad2deg((alignment.wall_yaw + yaw + np.pi / 4) % (np.pi / 2) - np.pi / 4)


@settings(max_examples=4, deadline=None, derandomize=True)
@given(st.floats(-5, 5), st.floats(-5, 5), st.floats(-3.1, 3.1))
def test_tilt_height_and_wall_direction_are_found_in_a_furnished_room(roll, pitch, yaw):
    points, pose = _scan(CLASSROOM, (3.8, 3.1, 1.3), roll, pitch, yaw)
    found = align(points)
    assert _tilt_error_deg(found, pose) < 0.05
    assert abs(_yaw_error_deg(found, yaw)) < 0.05
    assert found.scanner_height == pytest.approx(1.3, abs=0.005)
    assert found.ceiling_z == pytest.approx(3.0, abs=0.01)


def test_level_frame_has_the_floor_at_zero_under_the_scanner():
    points, _ = _scan(CLASSROOM, (3.8, 3.1, 1.3), 2.0, -1.0, 0.4)
    found = align(points)
    level = transforms.apply(found.level_from_scanner, points)
    on_floor = level[np.abs(level[:, 2]) < 0.02]
    assert len(on_floor) > 0.1 * len(points)
    assert transforms.to_euler(found.level_from_scanner) == pytest.approx((found.roll, found.pitch, 0.0), abs=1e-9)
    assert found.level_from_scanner[:3, 3] == pytest.approx([0, 0, found.scanner_height])


def test_constant_range_error_does_not_tilt_the_result():
    points, pose = _scan(CLASSROOM, (3.0, 2.0, 1.3), 1.0, 1.5, 0.0)
    ranges = np.linalg.norm(points, axis=1, keepdims=True)
    assert _tilt_error_deg(align(points * (1 + 0.005 / ranges)), pose) < 0.05


@pytest.mark.parametrize("position", [(1.0, 0.9, 1.3), (12.0, 0.9, 1.3)])
def test_a_corridor_is_levelled(position):
    points, pose = _scan(Scene(box((0, 0, 0), (24, 1.9, 2.7))), position, 1.2, -1.4, 0.3)
    found = align(points)
    assert _tilt_error_deg(found, pose) < 0.05
    assert found.ceiling_z == pytest.approx(2.7, abs=0.01)


def test_a_table_larger_than_the_seen_floor_is_not_the_floor():
    table = box((2.0, -4.5, 0.70), (6.5, 4.5, 0.74))
    points, pose = _scan(Scene(box((-2.0, -4.5, 0), (6.5, 4.5, 3.0)), table), (0, 0, 1.3), 0.5, 0.5, 0.0)
    found = align(points, scanner_heights=(0.5, 2.2))
    assert found.scanner_height == pytest.approx(1.3, abs=0.005)
    assert _tilt_error_deg(found, pose) < 0.05


def test_ground_outside_a_window_is_not_the_floor():
    walls = [box((-3, -3, 0), (-2.9, 3, 3)), box((-3, -3, 0), (3, -2.9, 3)), box((-3, 2.9, 0), (3, 3, 3))]
    walls += [box((2.9, -3, 0), (3, 3, 0.6)), box((-3, -3, -0.1), (3, 3, 0)), box((-3, -3, 3), (3, 3, 3.1))]
    ground = box((3.2, -40, -0.7), (60, 40, -0.6))
    points, _ = _scan(Scene(*walls, ground), (0.5, 0, 1.3), 0.0, 1.0, 0.0)
    assert align(points, scanner_heights=(0.5, 2.2)).scanner_height == pytest.approx(1.3, abs=0.005)


def test_the_open_sky_gives_no_ceiling():
    walls = [box((-4, -3, 0), (-3.9, 3, 2.5)), box((3.9, -3, 0), (4, 3, 2.5)), box((-4, 2.9, 0), (4, 3, 2.5))]
    points, pose = _scan(Scene(*walls, box((-4, -3, -0.1), (4, 3, 0))), (0, 0, 1.3), 1.0, -1.0, 0.2)
    found = align(points)
    assert np.isnan(found.ceiling_z)
    assert _tilt_error_deg(found, pose) < 0.05


def test_a_scan_without_a_floor_is_refused():
    points, _ = _scan(CLASSROOM, (3.8, 3.1, 1.3), 0, 0, 0)
    with pytest.raises(FailureError) as error:
        align(points[points[:, 2] > 0.2])
    assert error.value.failure.code == "ALIGN_NO_FLOOR"


@pytest.mark.parametrize("count", [0, 50])
def test_too_few_points_are_refused(count):
    with pytest.raises(FailureError, match="ALIGN_NO_FLOOR"):
        align(np.zeros((count, 3), np.float32))
