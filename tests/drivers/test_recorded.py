"""Scans that somebody else took: 3DTK's frame, the files of a folder, and the beams found again."""

import warnings
from pathlib import Path

import numpy as np
import open3d as o3d
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from drivers.recorded import SUFFIXES, Lattice, RawScan, files_of, read_file, scan_of
from perception import transforms
from perception.failure import FailureError
from perception.scan import BeamPattern, Scan
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


def only(folder: Path) -> RawScan:
    (path,) = files_of(folder)
    (raw,) = read_file(path)
    return raw


def pose_of(folder: Path, text: str) -> np.ndarray:
    write_3dtk(folder, points_of_a_room(), text)
    pose = only(folder).world_from_scanner
    assert pose is not None
    return pose


def refusal(folder: Path) -> FailureError:
    with pytest.raises(FailureError) as refused, warnings.catch_warnings():
        warnings.simplefilter("ignore")
        only(folder)
    return refused.value


# --- 3DTK ------------------------------------------------------------------------------------------------------------


def test_centimetres_of_a_left_handed_frame_become_metres_of_a_right_handed_one(tmp_path: Path) -> None:
    # One metre to the right, two up, three ahead.
    (tmp_path / "scan000.3d").write_text("100 200 300\n101 200 300\n100 201 300\n")
    assert np.abs(only(tmp_path).points - (3.0, -1.0, 2.0)).max() < 0.011


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
    # Intrinsic x, y, z: R = Rx Ry Rz, as EulerToMatrix4 has it.
    x, y, z = Rotation.from_euler("XYZ", angles, degrees=True).apply((100.0, 200.0, 300.0)) + position
    ours = transforms.apply(only(folder).world_from_scanner, np.array([[3.0, -1.0, 2.0]]))[0]
    np.testing.assert_allclose(ours, np.array([z, -x, y]) / 100, atol=1e-5)


def test_a_scan_without_a_pose_has_none(tmp_path: Path) -> None:
    write_3dtk(tmp_path, points_of_a_room())
    assert only(tmp_path).world_from_scanner is None


def test_what_the_scanner_cannot_measure_is_no_return(tmp_path: Path) -> None:
    room = points_of_a_room()
    strange = np.array([[0.1, 0.0, 0.2], [0.0, 45.0, 0.0], [np.nan, 1.0, 1.0]])
    write_3dtk(tmp_path, np.vstack([room, strange]))
    ranges = np.linalg.norm(only(tmp_path).points, axis=1)
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
    raw = only(tmp_path)
    assert raw.world_from_scanner is None
    assert len(raw.points) == len(points)


def test_scans_come_in_the_order_of_their_names_and_other_files_are_left_alone(tmp_path: Path) -> None:
    room = points_of_a_room()
    for name, height in (("b", 0.2), ("a", 0.1), ("c", 0.3)):
        write_3dtk(tmp_path, room, f"0 {100 * height} 0 0 0 0", name)
    (tmp_path / "notes.txt").write_text("nothing")
    found = [raw for path in files_of(tmp_path) for raw in read_file(path)]
    assert [raw.source for raw in found] == ["a.3d", "b.3d", "c.3d"]
    heights = [raw.world_from_scanner[2, 3] for raw in found if raw.world_from_scanner is not None]
    assert heights == pytest.approx([0.1, 0.2, 0.3])


# --- beams -----------------------------------------------------------------------------------------------------------


def found_again(points: np.ndarray) -> Scan:
    scan, gridded = scan_of(RawScan(points.astype(np.float64), "made"), "S01")
    assert not gridded
    return scan


@pytest.mark.parametrize("step", [0.5, 0.7, 1.0, 1.3])
def test_the_beams_are_found_again_by_direction(step: float) -> None:
    pattern = BeamPattern.with_step(np.deg2rad(step), (np.deg2rad(-40), np.deg2rad(60)), (0.5, 120.0))
    points = points_of_a_room(pattern)
    scan = found_again(points)
    assert (scan.pattern.columns, scan.pattern.rows) == (pattern.columns, pattern.rows)
    assert len(scan.points) > 0.97 * len(points)
    off = np.einsum("ij,ij->i", scan.pattern.directions(scan.beam), scan.points)
    assert (off / np.linalg.norm(scan.points, axis=1)).min() > np.cos(np.deg2rad(step))


def test_the_rings_of_a_spinning_scanner_are_its_rows() -> None:
    rings = BeamPattern(1800, 16, np.deg2rad(-15), np.deg2rad(15), 0.5, 120.0)
    points = points_of_a_room(rings)
    scan = found_again(points)
    assert scan.pattern.rows == 16
    assert len(scan.points) > 0.95 * len(points)


def test_beams_that_went_anywhere_are_found_at_the_step_that_they_fill() -> None:
    rng = np.random.default_rng(0)
    away = rng.normal(size=(40_000, 3))
    points = 3.0 * away / np.linalg.norm(away, axis=1, keepdims=True)
    scan = found_again(points)
    # Near the poles a grid of azimuth and elevation is too fine for them.
    assert 0.4 < len(scan.points) / scan.pattern.size < 1.0


def test_of_two_points_in_one_beam_the_nearer_one_was_measured() -> None:
    room = points_of_a_room()
    behind = room[::7] * 1.5
    scan = found_again(np.vstack([behind, room]))
    assert len(np.unique(scan.beam)) == len(scan.beam)
    assert np.linalg.norm(scan.points, axis=1).max() <= np.linalg.norm(room, axis=1).max() + 1e-5


@pytest.mark.parametrize("count", [1, 2, 50])
def test_few_points_have_beams_as_well(count: int) -> None:
    points = np.random.default_rng(count).uniform(1, 2, (count, 3))
    assert len(found_again(points).points) >= 1


def grid(rows: int, columns: int, turn: float, rise: float, noise: float = 0.0) -> RawScan:
    """Points on a sphere by a grid whose columns turn by ``turn`` and rows rise by ``rise`` degrees."""
    row, column = np.divmod(np.arange(rows * columns), columns)
    azimuth = np.deg2rad(17.3 + turn * column)
    elevation = np.deg2rad(-abs(rise) * rows / 2 * np.sign(rise) + rise * row)
    wobble = np.random.default_rng(0).normal(0, np.deg2rad(noise), (2, len(row)))
    azimuth, elevation = azimuth + wobble[0], elevation + wobble[1]
    away = [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    return RawScan(3.0 * np.stack(away, axis=1), "made", lattice=Lattice(row, column, rows, columns))


@pytest.mark.parametrize(("turn", "rise"), [(1.0, 1.0), (-1.0, 1.0), (0.5, -0.5), (-0.36, 0.9)])
def test_the_grid_of_the_file_is_the_pattern_whichever_way_it_turns(turn: float, rise: float) -> None:
    raw = grid(90, round(360 / abs(turn)), turn, rise, noise=0.02)
    scan, gridded = scan_of(raw, "S01")
    assert gridded
    assert (scan.pattern.rows, scan.pattern.columns) == (90, round(360 / abs(turn)))
    assert len(scan.points) > 0.999 * len(raw.points)


def test_a_sector_of_a_grid_is_a_sector_of_the_circle() -> None:
    scan, gridded = scan_of(grid(60, 120, 1.0, 1.0), "S01")
    assert gridded
    assert scan.pattern.columns == 360
    assert np.count_nonzero((scan.range_image() > 0).any(axis=0)) == 120


def test_a_grid_whose_points_lie_elsewhere_is_not_believed() -> None:
    honest = grid(90, 360, 1.0, 1.0)
    assert honest.lattice is not None
    shuffled = np.random.default_rng(0).permutation(honest.points)
    scan, gridded = scan_of(RawScan(shuffled, "made", lattice=honest.lattice), "S01")
    assert not gridded
    assert len(scan.points) > 0.9 * len(shuffled)


# --- what is no scan -------------------------------------------------------------------------------------------------


def test_a_folder_without_clouds_says_what_was_expected(tmp_path: Path) -> None:
    failure = refusal(tmp_path).failure
    assert failure.code == "RECORDED_NONE"
    assert str(tmp_path) in failure.message
    assert all(suffix in failure.message for suffix in SUFFIXES)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("empty.3d", ""), ("words.3d", "one two three\n"), ("short.3d", "1 2\n"), ("far.3d", "5000 0 0\n6000 0 0\n"),
        ("junk.ply", "junk"), ("junk.pcd", "junk"), ("binary.3d", "\x00\xff\x00"),
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
