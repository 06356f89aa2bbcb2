"""Every format of a recorded scan: what was written is what is read, and rotten bytes are refused by name."""

import builtins
import struct
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.recorded import RawScan, read_file, scan_of
from perception import transforms
from perception.failure import FailureError
from tests.drivers.recorded_files import (
    PATTERN,
    POSE,
    WITH_BEAMS,
    WITH_POSE,
    WRITERS,
    scan_of_a_room,
    write_e57,
    write_las,
    write_ptx,
)

CODES = {"RECORDED_BROKEN"}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """One file of each kind, of the same scan."""
    folder = tmp_path_factory.mktemp("formats")
    for name, write in WRITERS.items():
        write(folder / name, scan_of_a_room())
    return {name: folder / name for name in WRITERS}


def only(path: Path) -> RawScan:
    (raw,) = read_file(path)
    return raw


def in_order(points: np.ndarray) -> np.ndarray:
    return points[np.argsort(PATTERN.beams_towards(points))]


def refusal(path: Path) -> FailureError:
    with pytest.raises(FailureError) as refused:
        read_file(path)
    return refused.value


def by_beam(raw: RawScan) -> dict[int, np.ndarray]:
    """Points by direction, to the nearest beam of the scan that was written."""
    return dict(zip(PATTERN.beams_towards(raw.points).tolist(), raw.points, strict=True))


# --- round trips -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", WRITERS)
def test_the_points_come_back(name: str, files: dict[str, Path]) -> None:
    written, found = scan_of_a_room(), by_beam(only(files[name]))
    assert found.keys() == set(written.beam.tolist())
    apart = [
        np.abs(found[beam] - point).max() for beam, point in zip(written.beam.tolist(), written.points, strict=True)
    ]
    assert max(apart) < 6e-4


@pytest.mark.parametrize("name", WRITERS)
def test_the_pose_comes_back_where_the_format_has_one(name: str, files: dict[str, Path]) -> None:
    pose = only(files[name]).world_from_scanner
    assert (pose is not None) == (name in WITH_POSE)
    if pose is not None:
        np.testing.assert_allclose(pose, POSE, atol=1e-5)


@pytest.mark.parametrize("name", sorted(WITH_BEAMS))
def test_the_beams_come_back_where_the_format_has_them(name: str, files: dict[str, Path]) -> None:
    written, (scan, gridded) = scan_of_a_room(), scan_of(only(files[name]), "S01")
    assert gridded
    assert (scan.pattern.columns, scan.pattern.rows) == (PATTERN.columns, PATTERN.rows)
    assert scan.pattern.elevation_min == pytest.approx(PATTERN.elevation_min, abs=0.1 * PATTERN.elevation_step)
    assert set(scan.beam.tolist()) == set(written.beam.tolist())


def test_a_scan_upside_down_and_backwards_in_its_grid_has_the_same_beams(files: dict[str, Path]) -> None:
    leica, _ = scan_of(only(files["scan.ptx"]), "S01")
    e57, _ = scan_of(only(files["scan.e57"]), "S01")
    np.testing.assert_array_equal(leica.range_image() > 0, e57.range_image() > 0)
    np.testing.assert_allclose(leica.range_image(), e57.range_image(), atol=1e-4)


@pytest.mark.parametrize(("write", "name"), [(write_e57, "many.e57"), (write_ptx, "many.ptx")])
def test_every_set_up_of_a_file_is_read(write, name: str, tmp_path: Path) -> None:
    write(tmp_path / name, scan_of_a_room(), times=3)
    found = read_file(tmp_path / name)
    assert len(found) == 3
    assert len({raw.source for raw in found}) == 3
    assert all(raw.source.startswith(name) for raw in found)


def test_coordinates_of_a_country_keep_their_millimetres(tmp_path: Path) -> None:
    offset = (3_512_345.0, 5_404_321.0, 312.0)
    write_las(tmp_path / "utm.laz", scan_of_a_room(), offset)
    points = only(tmp_path / "utm.laz").points - offset
    assert np.abs(in_order(points) - in_order(scan_of_a_room().points)).max() < 6e-4


# --- text ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "text",
    [
        "1 2 3\n4 5 6\n",
        "1,2,3\n4,5,6\n",
        "1;2;3;255;0\n4;5;6;0;0\n",
        "x,y,z\n1,2,3\n4,5,6\n",
        "# made by hand\n1 2 3\n4 5 6\n",
        "//X Y Z R G B\n1 2 3 9 9 9\n4 5 6 9 9 9\n",
        "Intensity;Z (cm);Y (cm);X (cm)\n7;300;200;100\n7;600;500;400\n",
        "y[mm]\tx[mm]\tz[mm]\n2000\t1000\t3000\n5000\t4000\t6000\n",
        '"x","y","z"\n1,2,3\n\n4,5,6\n',
        "x y z\n1 2 3\nnan nan nan\n0 0 0\n4 5 6\n",
    ],
)
def test_text_is_read_by_its_heading_and_in_its_unit(text: str, tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_text(text)
    np.testing.assert_allclose(only(tmp_path / "points.csv").points, [[1, 2, 3], [4, 5, 6]])


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("x,y\n1,2\n", "x, y, z"),
        ("x_furlong,y,z\n1,2,3\n", "furlong"),
        ("x_mm,y,z\n1,2,3\n", "unit"),
        ("x,y,z\n1,2\n", "3 numbers"),
        ("1 2\n", "3 numbers"),
        ("", "none"),
        ("x,y,z\n", "none"),
        ("row,column,x,y,z\n-1,0,1,2,3\n", "rows and columns"),
        ("row,column,x,y,z\n1e18,0,1,2,3\n", "rows and columns"),
    ],
)
def test_text_that_is_no_cloud_says_what_was_expected(text: str, word: str, tmp_path: Path) -> None:
    (tmp_path / "points.csv").write_text(text)
    failure = refusal(tmp_path / "points.csv").failure
    assert failure.code == "RECORDED_BROKEN"
    assert "points.csv" in failure.message and word in failure.message


# --- rotten bytes ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", WRITERS)
def test_a_file_cut_off_is_refused_or_is_what_is_left_of_a_text(
    name: str, files: dict[str, Path], tmp_path: Path
) -> None:
    """Text without a count may end at any line; all others say how much there should be."""
    data = files[name].read_bytes()
    counted = name not in ("scan.3d", "scan.xyz", "scan.csv")
    for share in (0.0, 0.01, 0.3, 0.6, 0.95):
        path = tmp_path / name
        path.write_bytes(data[: int(share * len(data))])
        try:
            (raw,) = read_file(path)
        except FailureError as error:
            assert error.failure.code in CODES
            assert name in error.failure.message
        else:
            assert not counted, share
            whole = by_beam(only(files[name]))
            # The last number may have lost digits.
            assert len(raw.points) < len(whole)


@pytest.mark.parametrize("name", WRITERS)
@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_bytes_that_changed_are_read_or_refused_and_never_crash(
    name: str, data: st.DataObject, files: dict[str, Path], tmp_path: Path
) -> None:
    """Half of the changes hit the first kilobyte, where the headers are."""
    whole = bytearray(files[name].read_bytes())
    for _ in range(data.draw(st.integers(1, 8))):
        end = data.draw(st.sampled_from([min(1024, len(whole)), len(whole)]))
        whole[data.draw(st.integers(0, end - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path / name
    path.write_bytes(whole)
    try:
        found = read_file(path)
    except FailureError as error:
        assert error.failure.code in CODES
    else:
        assert all(np.isfinite(raw.points).all() and len(raw.points) for raw in found)


def lying(name: str, path: Path, data: bytes) -> None:
    """The same file with a header that promises a hundred thousand million points."""
    many = b"99999999999"
    count = str(len(scan_of_a_room().points)).encode()
    match name:
        case "scan.ply" | "ascii.ply":
            data = data.replace(b"vertex " + count, b"vertex " + many)
        case "ascii.pcd" | "binary.pcd" | "compressed.pcd":
            data = data.replace(b"WIDTH " + count, b"WIDTH " + many).replace(b"POINTS " + count, b"POINTS " + many)
        case "organised.pcd":
            data = data.replace(b"HEIGHT ", b"HEIGHT 9999999").replace(b"POINTS ", b"POINTS 9999999")
        case "scan.ptx":
            data = b"99999999" + data[data.index(b"\n") :]
        case "scan.las" | "scan.laz":
            data = data[:247] + struct.pack("<Q", int(many)) + data[255:]
    path.write_bytes(data)


@pytest.mark.parametrize(
    "name",
    [
        "scan.ply",
        "ascii.ply",
        "ascii.pcd",
        "binary.pcd",
        "compressed.pcd",
        "organised.pcd",
        "scan.ptx",
        "scan.las",
        "scan.laz",
    ],
)
def test_a_header_that_lies_costs_no_memory(name: str, files: dict[str, Path], tmp_path: Path) -> None:
    lying(name, tmp_path / name, files[name].read_bytes())
    tracemalloc.start()
    failure = refusal(tmp_path / name).failure
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert failure.code == "RECORDED_BROKEN"
    assert name in failure.message
    assert peak < 200e6


def test_a_mirror_or_a_scale_is_no_pose(files: dict[str, Path], tmp_path: Path) -> None:
    lines = files["scan.ptx"].read_text().splitlines()
    for row in ("-1 0 0 0", "2 0 0 0", "nan 0 0 0"):
        head = [*lines[:6], row, "0 1 0 0", "0 0 1 0", "0 0 0 1"]
        (tmp_path / "mirror.ptx").write_text("\n".join([*head, *lines[10:]]))
        assert "pose" in refusal(tmp_path / "mirror.ptx").failure.message


def test_las_without_its_extra_names_the_extra(files: dict[str, Path], monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def without_laspy(name: str, *rest: object) -> object:
        if name.startswith("laspy"):
            raise ImportError(name=name)
        return real(name, *rest)  # type: ignore[arg-type]

    monkeypatch.setattr(builtins, "__import__", without_laspy)
    failure = refusal(files["scan.laz"]).failure
    assert failure.code == "RECORDED_NEEDS_EXTRA"
    assert "[las]" in failure.message


def test_all_formats_put_the_points_at_the_same_place_in_the_world(files: dict[str, Path]) -> None:
    truth = transforms.apply(POSE, in_order(scan_of_a_room().points))
    for name in WITH_POSE:
        raw = only(files[name])
        assert raw.world_from_scanner is not None
        world = transforms.apply(raw.world_from_scanner, in_order(raw.points))
        assert np.abs(world - truth).max() < 6e-4, name
