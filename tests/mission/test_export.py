"""Exports, read back by an independent reader where there is one."""

import json
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pye57
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from drivers import scan_file
from mission.export import read_ros_map, write_e57, write_ros_map
from mission.export.e57 import gps_seconds
from perception import transforms
from perception.failure import FailureError
from perception.grids import Cell, Grid
from tests.mission.fake_run import FakeRun, write_run


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> FakeRun:
    made = write_run(tmp_path_factory.mktemp("export"))
    write_e57(made.folder)
    return made


def test_every_set_up_keeps_its_name_its_frame_and_its_pose(run: FakeRun) -> None:
    state = json.loads((run.folder / "state.json").read_text())
    with pye57.E57(str(run.folder / "building.e57")) as image:
        assert image.scan_count == 3
        assert [image.get_header(i)["name"].value() for i in range(3)] == ["R01/S01", "R02/S02", "R02/S03"]
        for index, record in enumerate(state["scans"]):
            pose = np.array(record["map_from_scanner"])
            header = image.get_header(index)
            assert np.allclose(header.rotation_matrix, pose[:3, :3], atol=1e-9)
            assert np.allclose(header.translation, pose[:3, 3], atol=1e-12)
            scan = scan_file.read(run.folder / record["file"])
            raw = image.read_scan_raw(index)
            local = np.column_stack([raw[f"cartesian{axis}"] for axis in "XYZ"])
            assert np.allclose(local, scan.points, atol=1e-6)
            assert np.allclose(raw["intensity"], scan.intensity)
            beams = raw["rowIndex"].astype(int) * scan.pattern.columns + raw["columnIndex"]
            assert np.array_equal(beams, scan.beam)


def test_the_reader_puts_the_points_into_the_map(run: FakeRun) -> None:
    record = json.loads((run.folder / "state.json").read_text())["scans"][2]
    scan = scan_file.read(run.folder / record["file"])
    with pye57.E57(str(run.folder / "building.e57")) as image:
        data = image.read_scan(2, ignore_missing_fields=True)
    placed = np.column_stack([data[f"cartesian{axis}"] for axis in "XYZ"])
    assert np.allclose(placed, transforms.apply(np.array(record["map_from_scanner"]), scan.points), atol=1e-4)


def test_dates_sensor_limits_and_bounds_are_filled(run: FakeRun) -> None:
    with pye57.E57(str(run.folder / "building.e57")) as image:
        header = image.get_header(0)
        assert header["acquisitionStart"]["dateTimeValue"].value() == gps_seconds("2026-01-02T03:05:00Z")
        length = header["acquisitionEnd"]["dateTimeValue"].value() - header["acquisitionStart"]["dateTimeValue"].value()
        assert length == 45.0
        assert image.root["creationDateTime"]["dateTimeValue"].value() == gps_seconds("2026-01-02T03:09:05Z")
        assert (header["sensorModel"].value(), header["sensorSerialNumber"].value()) == ("vz-400", "S1234")
        assert header["intensityLimits"]["intensityMaximum"].value() == 1.0
        scan = scan_file.read(run.folder / "scans" / "S01.scan")
        assert header["cartesianBounds"]["xMinimum"].value() == pytest.approx(scan.points[:, 0].min())
        guids = {image.get_header(i).guid for i in range(3)}
    assert len(guids) == 3


def test_gps_time_of_a_known_moment() -> None:
    # 2017-01-01: 37 years of 365 days, 10 leap days (1980 after January to 2016), less the 5 days before the epoch.
    days = (datetime(2017, 1, 1, tzinfo=UTC) - datetime(1980, 1, 6, tzinfo=UTC)).days
    assert gps_seconds("2017-01-01T00:00:00+00:00") == days * 86400 + 18
    assert gps_seconds("2017-01-01T01:00:00+01:00") == days * 86400 + 18
    assert gps_seconds(None) == 0.0


def test_nothing_to_export_leaves_no_file(tmp_path: Path) -> None:
    made = write_run(tmp_path)
    for path in (made.folder / "scans").iterdir():
        path.unlink()
    with pytest.raises(FailureError, match="EXPORT_NOTHING"):
        write_e57(made.folder)
    assert not list(made.folder.glob("building*"))


@settings(max_examples=40, deadline=None)
@given(
    arrays.arrays(np.uint8, st.tuples(st.integers(1, 12), st.integers(1, 12)), elements=st.integers(0, 2)),
    st.tuples(st.floats(-100, 100), st.floats(-100, 100)),
    st.sampled_from([0.05, 0.1, 0.025]),
)
def test_a_map_survives_the_way_through_ros(
    tmp_path_factory: pytest.TempPathFactory, data: np.ndarray, origin: tuple[float, float], resolution: float
) -> None:
    stem = tmp_path_factory.getbasetemp() / "round_trip"
    _, description = write_ros_map(Grid(data, origin, resolution), stem)
    back = read_ros_map(description)
    assert np.array_equal(back.data, data)
    assert (back.origin, back.resolution) == (origin, resolution)


def test_the_image_has_its_top_where_y_is_largest(tmp_path: Path) -> None:
    data = np.array([[Cell.FREE, Cell.OBSTACLE], [Cell.UNKNOWN, Cell.FREE]], np.uint8)
    image, description = write_ros_map(Grid(data, (1.0, 2.0), 0.05), tmp_path / "map")
    magic, size, depth, pixels = image.read_bytes().split(b"\n", 3)
    assert (magic, size, depth) == (b"P5", b"2 2", b"255")
    assert list(pixels) == [205, 254, 254, 0]
    fields = yaml.safe_load(description.read_text())
    assert fields["image"] == "map.pgm"
    assert (fields["occupied_thresh"], fields["free_thresh"], fields["negate"]) == (0.65, 0.196, 0)


def test_a_turned_or_missing_map_is_refused(tmp_path: Path) -> None:
    _, description = write_ros_map(Grid(np.zeros((2, 2), np.uint8), (0.0, 0.0), 0.05), tmp_path / "map")
    description.write_text(description.read_text().replace("- 0.0\nnegate", "- 0.5\nnegate"))
    with pytest.raises(FailureError, match="turned"):
        read_ros_map(description)
    with pytest.raises(FailureError, match="MAP_UNREADABLE"):
        read_ros_map(tmp_path / "none.yaml")
