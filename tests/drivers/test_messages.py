"""The messages: values survive the trip, and only well-formed ones make it."""

import random
import tracemalloc
import zlib

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.interfaces import DriveReport
from drivers.messages import (
    MAX_MESSAGE,
    PROTOCOL,
    AnyReply,
    BaseRequest,
    Chunk,
    Drive,
    DriveDone,
    Goal,
    Identify,
    Manifest,
    Pose,
    Problem,
    Reply,
    Request,
    RobotMap,
    ScannerRequest,
    ScanStatus,
    Take,
)
from drivers.wire.codec import Codec, UndecodableError, encode
from perception import transforms
from perception.failure import Failure, FailureError
from perception.grids import Grid
from tests.drivers.wire_fakes import make_goal

scanner_requests: Codec = Codec(Request[ScannerRequest])
base_requests: Codec = Codec(Request[BaseRequest])
replies: Codec = Codec(Reply[AnyReply])

angles = st.floats(-3.1, 3.1)
metres = st.floats(-1e4, 1e4)


@settings(max_examples=50, deadline=None)
@given(roll=angles, pitch=st.floats(-1.5, 1.5), yaw=angles, translation=st.tuples(metres, metres, metres))
def test_a_pose_survives_the_trip(roll, pitch, yaw, translation):
    matrix = transforms.from_euler(roll, pitch, yaw, translation)
    sent = encode(Request(PROTOCOL, "r", Take("S01", 0.01, Pose.of(matrix))))
    np.testing.assert_allclose(scanner_requests.decode(sent).body.odom_from_base.matrix(), matrix, atol=1e-12)


@pytest.mark.parametrize(
    "matrix", [np.diag([1, 1, -1, 1.0]), np.full((4, 4), np.nan), 2 * np.eye(4), np.eye(3), np.ones((4, 4))]
)
def test_what_is_no_rigid_transform_is_not_sent(matrix):
    with pytest.raises(FailureError, match="BAD_TRANSFORM"):
        Pose.of(matrix)


@pytest.mark.parametrize("rotation", [[0, 0, 0, 0.0], [0, 0, 0, 2.0], [float("nan"), 0, 0, 1.0], [0, 0, 1.0]])
def test_what_is_no_rotation_is_not_received(rotation):
    body = {"type": "Take", "scan_id": "S01", "step": 0.01, "odom_from_base": None}
    body["odom_from_base"] = {"translation": [0.0, 0, 0], "rotation": rotation}
    frame = msgspec.msgpack.encode({"version": PROTOCOL, "request_id": "r", "body": body})
    with pytest.raises(UndecodableError, match="rotation"):
        scanner_requests.decode(frame)


def test_a_goal_survives_the_trip_and_its_map_is_small():
    goal = make_goal()
    frame = encode(Request(PROTOCOL, "r", Drive(Goal.of(goal), (1, 1), 7)))
    found = base_requests.decode(frame).body.goal.value()
    assert len(frame) < goal.robot_map.data.size / 5
    np.testing.assert_array_equal(found.robot_map.data, goal.robot_map.data)
    assert (found.robot_map.origin, found.robot_map.resolution) == (goal.robot_map.origin, goal.robot_map.resolution)
    np.testing.assert_allclose(found.map_from_base, goal.map_from_base, atol=1e-12)
    assert (found.goal_id, found.map_id, found.x, found.y, found.yaw) == ("G01", "M01", 1.0, 0.5, None)


def test_a_map_never_inflates_beyond_its_announced_size():
    bomb = RobotMap("M", 10, 10, (0.0, 0.0), 0.05, zlib.compress(bytes(50_000_000)))
    tracemalloc.start()
    try:
        with pytest.raises(FailureError, match="BAD_MESSAGE"):
            bomb.grid()
        assert tracemalloc.get_traced_memory()[1] < 1_000_000
    finally:
        tracemalloc.stop()


@pytest.mark.parametrize("cells", [b"", b"no deflate", zlib.compress(bytes(99)), zlib.compress(b"\7" * 100)])
def test_a_map_of_the_wrong_cells_is_refused(cells):
    with pytest.raises(FailureError, match="BAD_MESSAGE"):
        RobotMap("M", 10, 10, (0.0, 0.0), 0.05, cells).grid()


def test_a_map_of_absurd_size_is_refused_before_it_is_inflated():
    with pytest.raises(ValueError, match="at most"):
        RobotMap("M", 60_000_000, 60_000_000, (0.0, 0.0), 0.05, b"")


def test_a_message_too_large_for_the_other_side_is_not_sent():
    noise = np.random.default_rng(0).integers(0, 3, (4000, 4000), np.uint8)
    goal = Goal("G", RobotMap.of("M", Grid(noise, (0.0, 0.0), 0.05)), None, 0.0, 0.0, None)
    with pytest.raises(FailureError, match="MESSAGE_TOO_LARGE"):
        encode(Request(PROTOCOL, "r", Drive(goal, (1, 1), 7)))


def test_a_frame_that_is_too_large_is_not_read_however_it_came():
    def frame(size: int) -> bytes:
        body = {"type": "Chunk", "index": 0, "data": bytes(size)}
        reply = {"version": PROTOCOL, "request_id": "r", "body": body, "boot": "b", "clock": 0.0}
        return msgspec.msgpack.encode(reply)

    assert isinstance(replies.decode(frame(MAX_MESSAGE - 200)).body, Chunk)
    with pytest.raises(UndecodableError, match=f"over {MAX_MESSAGE}"):
        replies.decode(frame(MAX_MESSAGE))


def test_a_drive_report_survives_the_trip():
    report = DriveReport("G01", transforms.planar(1, 2, 0.3), ((0.0, 0.0, 0.0), (1.0, 2.0, 0.3)), 2.2)
    found = replies.decode(encode(Reply(PROTOCOL, "r", DriveDone.of(report), "boot", 1.0))).body.value()
    assert (found.goal_id, found.track, found.distance) == (report.goal_id, report.track, report.distance)


def test_a_failure_survives_the_trip_with_arrays_and_odd_keys_in_its_evidence():
    failure = Failure("NAV_BLOCKED", "in the way", {"pose": np.eye(2), "code": np.int64(3), "where": {"x": 1.5}})
    frame = encode(Reply(PROTOCOL, "r", Problem.of(failure), "boot", 1.0))
    found = replies.decode(frame).body.error().failure
    assert (found.code, found.message) == ("NAV_BLOCKED", "in the way")
    assert found.evidence == {"pose": [[1.0, 0.0], [0.0, 1.0]], "code": 3, "where": {"x": 1.5}}


@pytest.mark.parametrize("name", ["", "../up", "a/b", ".hidden", "x" * 65, "S01\n", "ü"])
def test_a_scan_name_that_could_be_a_path_is_refused(name):
    frame = msgspec.msgpack.encode(
        {"version": PROTOCOL, "request_id": "r", "body": {"type": "ScanStatus", "scan_id": name}}
    )
    with pytest.raises(UndecodableError, match="scan_id"):
        scanner_requests.decode(frame)


def test_unknown_fields_and_messages_are_refused():
    good = {"version": PROTOCOL, "request_id": "r", "body": {"type": "Identify"}}
    assert scanner_requests.decode(msgspec.msgpack.encode(good)).body == Identify()
    for bad in (good | {"extra": 1}, good | {"body": {"type": "Identify", "x": 1}}, good | {"body": {"type": "Fly"}}):
        with pytest.raises(UndecodableError):
            scanner_requests.decode(msgspec.msgpack.encode(bad))


def test_another_version_is_told_from_garbage():
    frame = msgspec.msgpack.encode({"version": PROTOCOL + 1, "request_id": "r7", "body": {"type": "Novelty"}})
    with pytest.raises(UndecodableError) as error:
        scanner_requests.decode(frame)
    assert error.value.foreign and error.value.request_id == "r7"
    with pytest.raises(UndecodableError) as error:
        scanner_requests.decode(b"\xc1garbage")
    assert not error.value.foreign


def test_a_manifest_whose_chunks_do_not_add_up_is_refused():
    with pytest.raises(ValueError, match="do not fit"):
        Manifest(3 << 20, "0" * 64, 1 << 20, [bytes(32)] * 2)


def test_mutated_frames_raise_one_kind_of_error_only():
    rng = random.Random(7)
    frames = [
        encode(Request(PROTOCOL, "r1", Take("S01", 0.01, Pose.of(np.eye(4))), "boot", 12.5)),
        encode(Request(PROTOCOL, "r2", ScanStatus("S01"))),
        encode(Reply(PROTOCOL, "r3", Problem("CODE", "text", {"deep": [[[1, 2.0, "x"]]]}), "boot", 1.0)),
    ]
    refused = 0
    for _ in range(20_000):
        frame = bytearray(rng.choice(frames))
        for _ in range(rng.randint(1, 4)):
            frame[rng.randrange(len(frame))] = rng.randrange(256)
        frame = frame[: rng.randint(0, len(frame))] if rng.random() < 0.3 else frame
        for codec in (scanner_requests, replies):
            try:
                codec.decode(bytes(frame))
            except UndecodableError:
                refused += 1
    assert refused > 30_000
    with pytest.raises(UndecodableError):
        replies.decode(b"\x91" * MAX_MESSAGE)  # lists in lists: deeper than the stack
