"""The scan format: what goes in comes out, and nothing else is ever taken for a scan."""

import dataclasses
import struct
import tracemalloc
import zlib

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers import scan_file
from perception.failure import FailureError
from perception.scan import Scan
from tests.drivers.wire_fakes import make_scan

ENCODED = scan_file.encode(make_scan(points=50))
CODES = {"SCAN_TRUNCATED", "SCAN_FOREIGN", "SCAN_HEADER", "SCAN_CORRUPT"}


def assert_same(a: Scan, b: Scan) -> None:
    for field in dataclasses.fields(Scan):
        left, right = getattr(a, field.name), getattr(b, field.name)
        if isinstance(left, np.ndarray):
            assert left.dtype == right.dtype and left.shape == right.shape and left.tobytes() == right.tobytes()
        else:
            assert left == right


@settings(max_examples=30, deadline=None)
@given(points=st.integers(0, 300), seed=st.integers(0, 1000), name=st.text(min_size=1, max_size=20))
def test_decode_gives_back_every_bit(points, seed, name):
    try:
        name.encode()
    except UnicodeEncodeError:
        return
    scan = make_scan(name, points, seed)
    assert_same(scan_file.decode(scan_file.encode(scan)), scan)


def test_a_written_file_is_what_encode_gives_and_reads_back_as_writable_arrays(tmp_path):
    scan = make_scan(points=777)
    path = tmp_path / "S01.scan"
    scan_file.write(path, scan)
    assert path.read_bytes() == scan_file.encode(scan)
    found = scan_file.read(path)
    assert_same(found, scan)
    assert found.points.ctypes.data % 16 == 0
    found.points[:] = 0
    assert path.read_bytes() == scan_file.encode(scan), "what is written to the arrays stays out of the file"


def test_the_layout_is_the_documented_one():
    scan = make_scan(points=50)
    magic, version, metadata, arrays, _ = struct.unpack("<8sIIQI", ENCODED[:28])
    assert (magic, version, arrays) == (b"SCAN\r\n\x1a\n", 1, 50 * 20)
    assert len(ENCODED) == -(-(28 + metadata) // 64) * 64 + arrays
    assert np.frombuffer(ENCODED[-200:], "<i4").tolist() == scan.beam.tolist()


@pytest.mark.parametrize("length", [0, 1, 7, 8, 27, 28, 100, len(ENCODED) - 1, len(ENCODED) + 1])
def test_a_file_of_the_wrong_length_is_refused_by_name(tmp_path, length):
    path = tmp_path / "cut.scan"
    path.write_bytes((ENCODED + b"\0")[:length])
    with pytest.raises(FailureError) as error:
        scan_file.read(path)
    failure = error.value.failure
    assert failure.code == ("SCAN_TRUNCATED" if length < len(ENCODED) else "SCAN_HEADER")
    assert str(path) in failure.message and failure.evidence["file"] == str(path)
    assert "expected" in failure.evidence and "found" in failure.evidence


def test_every_flipped_bit_is_noticed():
    for position in range(len(ENCODED)):
        garbled = bytearray(ENCODED)
        garbled[position] ^= 1 << (position % 8)
        with pytest.raises(FailureError) as error:
            scan_file.decode(garbled)
        assert error.value.failure.code in CODES


def test_a_bit_that_rotted_among_the_points_is_a_wrong_checksum():
    garbled = bytearray(ENCODED)
    garbled[-300] ^= 1
    with pytest.raises(FailureError, match=r"SCAN_CORRUPT.*checksum"):
        scan_file.decode(garbled)


def test_another_kind_of_file_is_foreign():
    for data in (b"ply\nformat binary_little_endian 1.0\n" + bytes(99), ENCODED[:8] + b"\2" + ENCODED[9:]):
        with pytest.raises(FailureError, match="SCAN_FOREIGN"):
            scan_file.decode(data)


@settings(max_examples=200, deadline=None)
@given(st.binary(max_size=200))
def test_noise_is_refused(noise):
    for data in (noise, ENCODED[:28] + noise, scan_file.MAGIC + noise):
        with pytest.raises(FailureError) as error:
            scan_file.decode(data)
        assert error.value.failure.code in CODES


@pytest.mark.parametrize(
    ("arrays", "code"), [(1 << 50, "SCAN_HEADER"), (1 << 29, "SCAN_TRUNCATED"), (0, "SCAN_HEADER")]
)
def test_a_lying_header_allocates_nothing(tmp_path, arrays, code):
    path = tmp_path / "lie.scan"
    path.write_bytes(struct.pack("<8sIIQI", scan_file.MAGIC, 1, 200, arrays, 0) + bytes(1000))
    tracemalloc.start()
    try:
        with pytest.raises(FailureError, match=code):
            scan_file.read(path)
        assert tracemalloc.get_traced_memory()[1] < 1 << 20
    finally:
        tracemalloc.stop()


def rewritten(**changes) -> bytes:
    """A file whose metadata says something else and whose checksum and lengths agree with that."""
    metadata_length = struct.unpack_from("<I", ENCODED, 12)[0]
    metadata = msgspec.msgpack.decode(ENCODED[28 : 28 + metadata_length]) | changes
    packed = msgspec.msgpack.encode(metadata)
    fields = struct.pack("<8sIIQ", scan_file.MAGIC, 1, len(packed), 50 * 20)
    body = packed + bytes(-(28 + len(packed)) % 64) + ENCODED[-50 * 20 :]
    return fields + struct.pack("<I", zlib.crc32(body, zlib.crc32(fields))) + body


def test_a_rewritten_file_is_a_scan_if_it_says_the_truth():
    assert rewritten() == ENCODED


@pytest.mark.parametrize(
    "lie",
    [
        {"points": 49},
        {"points": 51},
        {"points": -1},
        {"points": 1 << 62},
        {"columns": 0},
        {"columns": 1 << 26, "rows": 2},
        {"rows": 1},
        {"elevation": [1.0]},
        {"range": [float("nan"), 1.0]},
        {"odom_from_base": [0.0] * 16},
        {"base_from_scanner": [1.0] * 15},
        {"scan_id": ""},
        {"extra": 1},
    ],
)
def test_metadata_that_lies_is_refused(lie):
    with pytest.raises(FailureError, match="SCAN_HEADER"):
        scan_file.decode(rewritten(**lie))


def test_a_missing_file_is_a_typed_failure(tmp_path):
    with pytest.raises(FailureError, match=r"SCAN_UNREADABLE.*cannot be read"):
        scan_file.read(tmp_path / "nowhere.scan")


def test_beams_outside_the_pattern_are_refused():
    scan = make_scan(points=50)
    stray = dataclasses.replace(scan, beam=scan.beam + scan.pattern.size)
    with pytest.raises(FailureError, match=r"SCAN_HEADER.*beams"):
        scan_file.decode(scan_file.encode(stray))


def test_arrays_of_different_lengths_are_not_encoded():
    scan = make_scan(points=50)
    with pytest.raises(ValueError, match="50 rows"):
        scan_file.encode(dataclasses.replace(scan, beam=scan.beam[:-1]))


def test_a_transform_that_is_none_is_not_encoded():
    with pytest.raises(ValueError, match="orthonormal"):
        scan_file.encode(dataclasses.replace(make_scan(), odom_from_base=np.diag([2.0, 1, 1, 1])))
