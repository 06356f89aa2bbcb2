"""Scans that somebody else took: formats, frames, and files that are no scans."""

import warnings
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drivers.recorded import read_folder, scan_of
from perception import transforms
from perception.failure import FailureError
from perception.scan import BeamPattern
from tests.synthetic import COARSE, Scene, box

ROOM = Scene(
    *(box(*corners) for corners in (
        ((-4, -3, -1.5), (4, 3, -1.3)), ((-4, -3, 1.5), (4, 3, 1.7)), ((-4.2, -3, -1.5), (-4, 3, 1.7)),
        ((4, -3, -1.5), (4.2, 3, 1.7)), ((-4, -3.2, -1.5), (4, -3, 1.7)), ((-4, 3, -1.5), (4, 3.2, 1.7)),
    ))
)  # fmt: skip


def points_of_a_room(pattern: BeamPattern = COARSE) -> np.ndarray:
    return ROOM.take(np.eye(4), pattern).points


def write_3dtk(folder: Path, points: np.ndarray, pose: str | None = None, name: str = "scan000") -> None:
    """Right-handed metres as 3DTK's left-handed centimetres: x right, y up, z forward."""
    x, y, z = points.T
    np.savetxt(folder / f"{name}.3d", 100 * np.column_stack([-y, z, x]), fmt="%.4f")
    if pose is not None:
        (folder / f"{name}.pose").write_text(pose)


def pose_of(folder: Path, text: str) -> np.ndarray:
    write_3dtk(folder, points_of_a_room(), text)
    (recorded,) = read_folder(folder)
    assert recorded.world_from_scanner is not None
    return recorded.world_from_scanner


def refusal(folder: Path) -> FailureError:
    with pytest.raises(FailureError) as refused, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        read_folder(folder)
    return refused.value


# --- 3DTK ------------------------------------------------------------------------------------------------------------


def test_centimetres_of_a_left_handed_frame_become_metres_of_a_right_handed_one(tmp_path: Path) -> None:
    # One metre to the right, two up, three ahead.
    (tmp_path / "scan000.3d").write_text("100 200 300\n101 200 300\n100 201 300\n")
    (recorded,) = read_folder(tmp_path)
    assert np.abs(recorded.scan.points - (3.0, -1.0, 2.0)).max() < 0.011


def test_a_pose_computed_by_hand(tmp_path: Path) -> None:
    # A quarter turn about the axis that points up turns ahead to the right, and right to behind.
    pose = pose_of(tmp_path, "100 20 300\n0 90 0\n")
    np.testing.assert_allclose(pose[:3, 3], (3.0, -1.0, 0.2), atol=1e-12)
    ahead, left, up = pose[:3, :3].T
    np.testing.assert_allclose(ahead, (0, -1, 0), atol=1e-12)
    np.testing.assert_allclose(left, (1, 0, 0), atol=1e-12)
    np.testing.assert_allclose(up, (0, 0, 1), atol=1e-12)


def test_each_turn_goes_the_way_that_3dtk_means(tmp_path: Path) -> None:
    for angles, ahead in (("90 0 0", (0, 0, -1)), ("0 0 90", (1, 0, 0))):
        folder = tmp_path / angles.replace(" ", "_")
        folder.mkdir()
        # About the axis to the right, ahead turns down; about the axis ahead, it stays.
        np.testing.assert_allclose(pose_of(folder, f"0 0 0\n{angles}\n")[:3, 0], ahead, atol=1e-12)


@settings(max_examples=20, deadline=None)
@given(st.tuples(*[st.floats(-80, 80)] * 3), st.tuples(*[st.floats(-1000, 1000)] * 3))
def test_points_and_pose_are_changed_alike(
    tmp_path_factory: pytest.TempPathFactory, angles: tuple[float, ...], position: tuple[float, ...]
) -> None:
    """A point put into the world in 3DTK's frame, by 3DTK's own formula, is the one that is put there in ours."""
    folder = tmp_path_factory.mktemp("poses")
    text = " ".join(map(str, position)) + "\n" + " ".join(map(str, angles))
    (folder / "scan000.3d").write_text("100 200 300\n110 210 310\n90 150 250\n")
    (folder / "scan000.pose").write_text(text)
    (recorded,) = read_folder(folder)
    # Intrinsic x, y, z: R = Rx Ry Rz, as EulerToMatrix4 has it.
    x, y, z = Rotation.from_euler("XYZ", angles, degrees=True).apply((100.0, 200.0, 300.0)) + position
    ours = transforms.apply(recorded.world_from_scanner, np.array([[3.0, -1.0, 2.0]]))[0]
    np.testing.assert_allclose(ours, np.array([z, -x, y]) / 100, atol=1e-5)


def test_a_scan_without_a_pose_has_none(tmp_path: Path) -> None:
    write_3dtk(tmp_path, points_of_a_room())
    (recorded,) = read_folder(tmp_path)
    assert recorded.world_from_scanner is None


def test_what_the_scanner_cannot_measure_is_no_return(tmp_path: Path) -> None:
    room = points_of_a_room()
    strange = np.array([[0.1, 0.0, 0.2], [0.0, 45.0, 0.0], [np.nan, 1.0, 1.0]])
    write_3dtk(tmp_path, np.vstack([room, strange]))
    (recorded,) = read_folder(tmp_path)
    ranges = np.linalg.norm(recorded.scan.points, axis=1)
    assert 0.4 < ranges.min() < ranges.max() < 20.0
    assert len(ranges) == len(room)


# --- PLY and PCD -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".ply", ".pcd", ".PLY"])
def test_clouds_are_read_as_they_are(suffix: str, tmp_path: Path) -> None:
    points = points_of_a_room()
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    plain = tmp_path / f"cloud{suffix.lower()}"
    o3d.io.write_point_cloud(str(plain), cloud)
    plain.rename(tmp_path / f"cloud{suffix}")
    (recorded,) = read_folder(tmp_path)
    assert recorded.world_from_scanner is None
    assert len(recorded.scan.points) == len(points)


def test_scans_come_in_the_order_of_their_names_and_other_files_are_left_alone(tmp_path: Path) -> None:
    room = points_of_a_room()
    for name, height in (("b", 0.2), ("a", 0.1), ("c", 0.3)):
        write_3dtk(tmp_path, room, f"0 {100 * height} 0 0 0 0", name)
    (tmp_path / "notes.txt").write_text("nothing")
    found = read_folder(tmp_path)
    assert [recorded.scan.scan_id for recorded in found] == ["S01", "S02", "S03"]
    heights = [recorded.world_from_scanner[2, 3] for recorded in found if recorded.world_from_scanner is not None]
    assert heights == pytest.approx([0.1, 0.2, 0.3])


# --- beams -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("step", [0.5, 1.0])
def test_the_beams_are_found_again_by_direction(step: float) -> None:
    pattern = BeamPattern.with_step(np.deg2rad(step), (np.deg2rad(-40), np.deg2rad(60)), (0.5, 120.0))
    points = points_of_a_room(pattern)
    scan = scan_of(points, "S01")
    assert scan.pattern.columns == pattern.columns
    assert len(scan.points) > 0.97 * len(points)
    off = np.einsum("ij,ij->i", scan.pattern.directions(scan.beam), scan.points)
    assert (off / np.linalg.norm(scan.points, axis=1)).min() > np.cos(np.deg2rad(step))


def test_of_two_points_in_one_beam_the_nearer_one_was_measured() -> None:
    room = points_of_a_room()
    behind = room[::7] * 1.5
    scan = scan_of(np.vstack([behind, room]), "S01")
    assert len(np.unique(scan.beam)) == len(scan.beam)
    assert np.linalg.norm(scan.points, axis=1).max() <= np.linalg.norm(room, axis=1).max() + 1e-5


# --- what is no scan -------------------------------------------------------------------------------------------------


def test_a_folder_without_clouds_says_what_was_expected(tmp_path: Path) -> None:
    failure = refusal(tmp_path).failure
    assert failure.code == "RECORDED_NONE"
    assert str(tmp_path) in failure.message
    assert ".3d, .ply, .pcd" in failure.message


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("empty.3d", ""), ("words.3d", "one two three\n"), ("short.3d", "1 2\n"), ("far.3d", "5000 0 0\n6000 0 0\n"),
        ("one.3d", "1 2 3\n"), ("junk.ply", "junk"), ("junk.pcd", "junk"), ("binary.3d", "\x00\xff\x00"),
    ],
)  # fmt: skip
def test_a_broken_file_is_named(name: str, content: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(content, encoding="latin-1")
    failure = refusal(tmp_path).failure
    assert failure.code == "RECORDED_BROKEN"
    assert name in failure.message


@pytest.mark.parametrize("text", ["", "1 2 3\n", "1 2 3\n4 5 six\n", "1 2 3 4 5 6 7\n"])
def test_a_broken_pose_is_no_pose_of_zero(text: str, tmp_path: Path) -> None:
    write_3dtk(tmp_path, points_of_a_room(), text)
    failure = refusal(tmp_path).failure
    assert failure.code == "RECORDED_BROKEN"
    assert "scan000" in failure.message
