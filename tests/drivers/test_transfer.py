"""The transfer of a scan: whole and verified or not at all, resumed where it was cut."""

import errno
import hashlib
import os
import threading
from dataclasses import replace

import pytest

from drivers.agent import scanner_agent
from drivers.messages import AnyReply, Chunk, Manifest, Reply
from drivers.wire.codec import Codec, encode
from drivers.wire.endpoints import Endpoints
from drivers.wire.hashing import GrowingHash
from drivers.wire.scanner_client import ScannerClient
from perception import transforms
from tests.drivers.wire_fakes import (
    ANYWHERE,
    IMPATIENT,
    QUICK,
    SETTINGS,
    FakeScanner,
    Proxy,
    eventually,
    failure_of,
    value_of,
)

POINTS = 420_000  # 8.4 MB: nine chunks
replies: Codec = Codec(Reply[AnyReply])


@pytest.fixture(scope="module")
def taken(tmp_path_factory):
    """An agent that holds one scan, its receipt, and the folder it lies in."""
    spool = tmp_path_factory.mktemp("spool")
    with scanner_agent(FakeScanner(0.01, POINTS), ANYWHERE, spool) as agent:
        receipt = value_of(ScannerClient(agent.endpoints, QUICK).take("S01", SETTINGS, transforms.planar(0, 0, 0)))
        yield agent.endpoints, receipt, spool


@pytest.fixture
def endpoints(taken, tmp_path):
    """That agent, with the scan back on its shelf after each test."""
    endpoints, _, spool = taken
    os.link(spool / "S01.scan", tmp_path / "keep")
    yield endpoints
    if not (spool / "S01.scan").exists():
        os.link(tmp_path / "keep", spool / "S01.scan")


def sha256(path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def chunks_seen(counts: list[int], then=lambda number, frame: [frame]):
    """A rule that notes the index of every chunk that passes."""

    def rule(number: int, frame: bytes) -> list[bytes]:
        body = replies.decode(frame).body
        if isinstance(body, Chunk):
            counts.append(body.index)
        return then(number, frame)

    return rule


def fetch_through(proxy: Proxy, endpoints: Endpoints, receipt, destination, patience=QUICK):
    return ScannerClient(Endpoints(endpoints.control, proxy.endpoint), patience).fetch(receipt, destination)


def test_every_chunk_travels_once(endpoints, taken, tmp_path):
    _, receipt, _ = taken
    seen: list[int] = []
    with Proxy(endpoints.bulk, to_client=chunks_seen(seen)) as proxy:
        path = value_of(fetch_through(proxy, endpoints, receipt, tmp_path / "S01.scan"))
    assert sha256(path) == receipt.sha256 and sorted(seen) == list(range(9))
    assert not path.with_name("S01.scan.part").exists()


def test_a_transfer_that_was_cut_goes_on_where_it_was(endpoints, taken, tmp_path):
    _, receipt, _ = taken
    destination, first, second = tmp_path / "S01.scan", [], []
    passing = chunks_seen(first)
    with Proxy(endpoints.bulk, to_client=lambda n, frame: passing(n, frame) if n < 5 else []) as proxy:
        assert failure_of(fetch_through(proxy, endpoints, receipt, destination, IMPATIENT)).code == "AGENT_UNREACHABLE"
    assert not destination.exists()
    with Proxy(endpoints.bulk, to_client=chunks_seen(second)) as proxy:
        value_of(fetch_through(proxy, endpoints, receipt, destination))
    assert sha256(destination) == receipt.sha256
    assert len(first) == 4, "the first reply was the manifest, then four chunks came through"
    assert sorted(first + second) == list(range(9))


def test_what_rotted_in_the_partial_file_is_fetched_again(endpoints, taken, tmp_path):
    _, receipt, spool = taken
    destination, seen = tmp_path / "S01.scan", []
    whole = bytearray((spool / "S01.scan").read_bytes())
    whole[3 << 20] ^= 1
    destination.with_name("S01.scan.part").write_bytes(whole[: (6 << 20) + 500])
    with Proxy(endpoints.bulk, to_client=chunks_seen(seen)) as proxy:
        value_of(fetch_through(proxy, endpoints, receipt, destination))
    assert sha256(destination) == receipt.sha256 and sorted(seen) == [3, 6, 7, 8]


def garble(frame: bytes) -> bytes:
    reply = replies.decode(frame)
    if not isinstance(reply.body, Chunk):
        return frame
    return encode(Reply(reply.version, reply.request_id, Chunk(0, b"x" + reply.body.data[1:]), reply.boot, reply.clock))


def test_a_garbled_chunk_is_asked_for_again(endpoints, taken, tmp_path):
    _, receipt, _ = taken
    with Proxy(endpoints.bulk, to_client=lambda n, frame: [garble(frame) if n in (3, 4) else frame]) as proxy:
        path = value_of(fetch_through(proxy, endpoints, receipt, tmp_path / "S01.scan"))
    assert sha256(path) == receipt.sha256


def test_a_link_that_garbles_everything_is_given_up(endpoints, taken, tmp_path):
    _, receipt, _ = taken
    with Proxy(endpoints.bulk, to_client=lambda n, frame: [garble(frame)]) as proxy:
        failure = failure_of(fetch_through(proxy, endpoints, receipt, tmp_path / "S01.scan"))
    assert failure.code == "XFER_BROKEN" and not (tmp_path / "S01.scan").exists()


def test_lost_and_repeated_chunks_do_no_harm(endpoints, taken, tmp_path):
    _, receipt, _ = taken
    with Proxy(endpoints.bulk, to_client=lambda n, frame: [[], [frame], [frame, frame]][n % 3]) as proxy:
        path = value_of(fetch_through(proxy, endpoints, receipt, tmp_path / "S01.scan"))
    assert sha256(path) == receipt.sha256


def test_never_more_than_eight_chunks_are_asked_ahead(endpoints, taken, tmp_path):
    _, receipt, _ = taken
    answered, chunks = [], threading.Event()

    def hold(number: int, frame: bytes) -> list[bytes]:
        return [frame] if number == 0 or chunks.is_set() else []

    with Proxy(endpoints.bulk, to_client=chunks_seen(answered, hold)) as proxy:
        job = fetch_through(proxy, endpoints, receipt, tmp_path / "S01.scan")
        eventually(lambda: len(answered) > 16)
        assert set(answered) == set(range(8)), "asked again after a silence, but never beyond"
        chunks.set()
        value_of(job)


def test_cancelling_ends_a_transfer_at_once_and_keeps_what_came(endpoints, taken, tmp_path):
    _, receipt, _ = taken
    with Proxy(endpoints.bulk, to_client=lambda n, frame: [frame] if n < 4 else []) as proxy:
        job = fetch_through(proxy, endpoints, receipt, tmp_path / "S01.scan")
        eventually(lambda: job.poll().note.startswith("3 of 9"))
        job.cancel()
        assert failure_of(job, 5.0).code == "CANCELLED"
    assert (tmp_path / "S01.scan.part").exists()


def test_what_is_there_already_is_not_fetched(endpoints, taken, tmp_path):
    _, receipt, spool = taken
    destination = tmp_path / "S01.scan"
    destination.write_bytes((spool / "S01.scan").read_bytes())
    nobody = Endpoints(endpoints.control, "tcp://127.0.0.1:1")
    assert value_of(ScannerClient(nobody, QUICK).fetch(receipt, destination)) == destination


def test_what_is_there_already_and_is_not_the_scan_is_fetched(endpoints, taken, tmp_path):
    _, receipt, spool = taken
    whole = (spool / "S01.scan").read_bytes()
    destination = tmp_path / "S01.scan"
    destination.write_bytes(whole[:100] + bytes([whole[100] ^ 1]) + whole[101:])
    assert value_of(ScannerClient(endpoints, QUICK).fetch(receipt, destination)) == destination
    assert destination.read_bytes() == whole


def test_chunks_that_are_right_one_by_one_but_no_scan_together_are_not_taken_for_one(endpoints, taken, tmp_path):
    _, receipt, spool = taken
    other = b"x" + (spool / "S01.scan").read_bytes()[1 : 1 << 20]

    def forge(number: int, frame: bytes) -> list[bytes]:
        reply = replies.decode(frame)
        body = reply.body
        if isinstance(body, Manifest):
            body = Manifest(body.size, body.sha256, body.chunk, [hashlib.sha256(other).digest(), *body.digests[1:]])
        elif isinstance(body, Chunk) and body.index == 0:
            body = Chunk(0, other)
        return [encode(Reply(reply.version, reply.request_id, body, reply.boot, reply.clock))]

    with Proxy(endpoints.bulk, to_client=forge) as proxy:
        failure = failure_of(fetch_through(proxy, endpoints, receipt, tmp_path / "S01.scan"))
    assert (failure.code, "its hash is wrong" in failure.message) == ("XFER_BROKEN", True)
    assert not list(tmp_path.glob("S01*"))


def test_another_scan_of_the_same_name_is_not_taken_for_it(endpoints, taken, tmp_path):
    _, receipt, _ = taken
    other = replace(receipt, sha256="0" * 64)
    assert failure_of(ScannerClient(endpoints, QUICK).fetch(other, tmp_path / "x")).code == "XFER_BROKEN"


def test_a_scan_that_nobody_took_or_that_was_released_is_named(endpoints, taken, tmp_path):
    _, receipt, spool = taken
    client = ScannerClient(endpoints, QUICK)
    assert failure_of(client.fetch(replace(receipt, scan_id="S99"), tmp_path / "x")).code == "SCAN_UNKNOWN"
    value_of(client.fetch(receipt, tmp_path / "S01.scan"))
    eventually(lambda: not (spool / "S01.scan").exists())
    assert failure_of(client.fetch(receipt, tmp_path / "again.scan")).code == "SCAN_RELEASED"


def test_a_destination_that_cannot_be_written_is_named(endpoints, taken, tmp_path):
    _, receipt, _ = taken
    (tmp_path / "file").write_text("in the way")
    failure = failure_of(ScannerClient(endpoints, QUICK).fetch(receipt, tmp_path / "file" / "S01.scan"))
    assert failure.code == "XFER_WRITE_FAILED" and "S01.scan" in failure.message


def test_the_growing_hash_is_that_of_the_file_however_it_grows(tmp_path):
    path, data = tmp_path / "file", os.urandom((3 << 20) + 77)
    path.write_bytes(data)
    with path.open("rb") as file, GrowingHash(file.fileno()) as growing:
        for end in (0, 5, 5, 1 << 20, 1000, (2 << 20) + 3):
            growing.reach(end)
        assert growing.hexdigest(len(data)) == hashlib.sha256(data).hexdigest()
    with path.open("rb") as file, GrowingHash(file.fileno()) as growing, pytest.raises(EOFError):
        growing.hexdigest(len(data) + 1)


@pytest.mark.parametrize(("number", "code"), [(errno.ENOSPC, "DISK_FULL"), (errno.EIO, "XFER_WRITE_FAILED")])
def test_what_the_disk_did_not_take_is_not_believed_by_the_next_attempt(
    endpoints, taken, tmp_path, monkeypatch, number, code
):
    """A page that could not be written may still be read; only a new file is one that the disk has seen."""
    _, receipt, _ = taken
    fsync = os.fsync
    refused = []

    def refuses(handle: int) -> None:
        if not refused and os.readlink(f"/proc/self/fd/{handle}").endswith("home.scan.part"):  # noqa: PTH115
            refused.append(handle)
            raise OSError(number, os.strerror(number))
        fsync(handle)

    monkeypatch.setattr(os, "fsync", refuses)
    client = ScannerClient(endpoints, QUICK)
    assert failure_of(client.fetch(receipt, tmp_path / "home.scan")).code == code
    assert list(tmp_path.glob("home*")) == []
    assert sha256(value_of(client.fetch(receipt, tmp_path / "home.scan"))) == receipt.sha256
