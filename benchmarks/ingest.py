"""A scan of five million points from the scanner's last beam to a validated, durable file: ours against two others.

``python -m benchmarks.ingest [--repeats 5]`` prints one table. The scanner's agent is a process of its own, reached
over the loopback. The others carry the same scan the short way (one ZeroMQ message and ``numpy.save``; a PLY file by
Open3D), without hashes and without a look at a single point; both are brought to the disk as ours is.
"""

import argparse
import hashlib
import os
import shutil
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np
import zmq

from benchmarks.data import STATIONS, placed
from drivers import scan_file
from drivers.interfaces import ScannerInfo, ScanSettings, SelfTest
from drivers.jobs import Done, Failed, Job, Outcome, Running
from drivers.wire.endpoints import Endpoints
from drivers.wire.scanner_client import ScannerClient
from drivers.wire.spool import sync_folder
from perception.scan import Scan
from perception.transforms import Matrix
from perception.validation import validate

ANY_PORT = "tcp://127.0.0.1:*"
BAR_S = 0.8
OURS = "receive, validate, store"


@dataclass(frozen=True)
class Row:
    """One step: wall seconds, median and worst of several, and whose it is."""

    step: str
    median: float
    worst: float
    remark: str = ""


class ReadyScanner:
    """A scanner that has its scan already and only gives it another name; it notes when it was done."""

    def __init__(self, scan: Scan, ended: Connection) -> None:
        self._scan = scan
        self._ended = ended

    def info(self) -> ScannerInfo:
        return ScannerInfo("ready", "0001", 1)

    def self_test(self) -> SelfTest:
        return SelfTest()

    def start(self, scan_id: str, settings: ScanSettings, odom_from_base: Matrix) -> None:
        self._ended.send(time.monotonic())

    def status(self, scan_id: str) -> Outcome[Scan]:
        return Done(replace(self._scan, scan_id=scan_id))

    def abort(self, scan_id: str) -> None:
        """Nothing runs."""


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeats", type=int, default=5)
    scan = placed(STATIONS[0], "S01").scan
    print(f"{len(scan.points):,} points, {len(scan.points) * scan_file.BYTES_PER_POINT / 1e6:.0f} MB")
    for row in rows(scan, parser.parse_args().repeats):
        print(f"{row.step:38s} {row.median:7.3f} s  worst {row.worst:6.3f} s  {row.remark}")
    print(f"load average {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores")


def rows(scan: Scan, repeats: int = 5) -> list[Row]:
    """All rows of the table, the ways interleaved so that a busy machine is busy for each."""
    with tempfile.TemporaryDirectory() as name, _agent(scan, Path(name)) as way:
        folder = Path(name)
        ways: dict[str, Callable[[int], dict[str, float]]] = {
            "ours": lambda number: _ours(way, folder, number),
            "numpy": lambda number: _one_message(scan, folder),
            "ply": lambda number: _ply(scan, folder),
            "alone": lambda number: _alone(scan, folder),
        }
        runs = [{key: run(number) for key, run in ways.items()} for number in range(repeats + 1)][1:]
    remarks = {OURS: f"bar {BAR_S} s on an idle machine"}
    table = []
    for key in ways:
        for step in runs[0][key]:
            seconds = [run[key][step] for run in runs]
            table.append(Row(step, statistics.median(seconds), max(seconds), remarks.get(step, "")))
    return table


def _ours(way: tuple[ScannerClient, Connection], folder: Path, number: int) -> dict[str, float]:
    client, ended = way
    destination = folder / "ours.scan"
    destination.unlink(missing_ok=True)
    receipt = _value(client.take(f"S{number:02d}", ScanSettings(0.01), np.eye(4)))
    done, shelved = ended.recv(), time.monotonic()
    busy = time.process_time()
    _value(client.fetch(receipt, destination))
    received = time.monotonic()
    found = scan_file.read(destination)
    read = time.monotonic()
    validate(found)
    valid = time.monotonic()
    return {
        "scanner's shelf: write, hash, fsync": shelved - done,
        "receive: wire, hash, write, fsync": received - shelved,
        "read back, checksum": read - received,
        "validate": valid - read,
        OURS: valid - shelved,
        "the same, processor of this side": time.process_time() - busy,
        "from scanner done to all that": valid - done,
    }


def _one_message(scan: Scan, folder: Path) -> dict[str, float]:
    """Three arrays in one multipart message, each to an ``.npy``."""
    context = zmq.Context.instance()
    arrays = (scan.points, scan.intensity, scan.beam)
    with context.socket(zmq.PUSH) as near, context.socket(zmq.PULL) as far:
        port = near.bind_to_random_port("tcp://127.0.0.1")
        far.connect(f"tcp://127.0.0.1:{port}")
        began = time.monotonic()
        near.send_multipart([memoryview(array).cast("B") for array in arrays], copy=False)
        frames = far.recv_multipart(copy=False)
        for index, (frame, array) in enumerate(zip(frames, arrays, strict=True)):
            path = folder / f"{index}.npy"
            with path.open("wb") as file:
                np.save(file, np.frombuffer(frame.buffer, array.dtype))
                os.fsync(file.fileno())
        sync_folder(folder)
        stored = time.monotonic()
    for index in range(len(arrays)):
        np.load(folder / f"{index}.npy")
    return {"one message, numpy.save": stored - began, "numpy.load": time.monotonic() - stored}


def _ply(scan: Scan, folder: Path) -> dict[str, float]:
    import open3d as o3d

    path = folder / "scan.ply"
    began = time.monotonic()
    cloud = o3d.t.geometry.PointCloud(o3d.core.Tensor(np.ascontiguousarray(scan.points)))
    cloud.point["intensity"] = o3d.core.Tensor(np.ascontiguousarray(scan.intensity[:, None]))
    cloud.point["beam"] = o3d.core.Tensor(np.ascontiguousarray(scan.beam[:, None]))
    o3d.t.io.write_point_cloud(str(path), cloud)
    with path.open("rb") as file:
        os.fsync(file.fileno())
    sync_folder(folder)
    stored = time.monotonic()
    o3d.t.io.read_point_cloud(str(path))
    return {"Open3D PLY, no wire": stored - began, "Open3D PLY read back": time.monotonic() - stored}


def _alone(scan: Scan, folder: Path) -> dict[str, float]:
    """What single steps cost on the same bytes with nothing beside them."""
    data = scan_file.encode(scan)
    path = folder / "alone.scan"
    times = {}
    for name in ("sha256", "blake2b"):
        began = time.monotonic()
        hashlib.new(name, data)
        times[f"{name} alone"] = time.monotonic() - began
    with path.open("wb", buffering=0) as file:
        began = time.monotonic()
        file.write(data)
        written = time.monotonic()
        os.fsync(file.fileno())
    return times | {"write alone": written - began, "fsync alone": time.monotonic() - written}


@contextmanager
def _agent(scan: Scan, folder: Path) -> Iterator[tuple[ScannerClient, Connection]]:
    """A client of an agent in a process of its own, and what tells when its scanner was done."""
    stored = folder / "held.scan"
    scan_file.write(stored, scan)
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    agent = context.Process(target=_serve, args=(stored, folder / "shelf", theirs), daemon=True)
    agent.start()
    theirs.close()
    try:
        control, bulk = ours.recv()
        yield ScannerClient(Endpoints(control, bulk=bulk)), ours
    finally:
        agent.terminate()
        agent.join()
        shutil.rmtree(folder / "shelf", ignore_errors=True)


def _serve(stored: Path, shelf: Path, connection: Connection) -> None:
    from drivers.agent import serve_scanner

    scanner = ReadyScanner(scan_file.read(stored), connection)
    anywhere = Endpoints(ANY_PORT, bulk=ANY_PORT)
    serve_scanner(scanner, anywhere, shelf, lambda bound: connection.send((bound.control, bound.bulk)))


def _value(job: Job) -> object:
    while isinstance(outcome := job.poll(), Running):
        time.sleep(0.001)
    if isinstance(outcome, Failed):
        raise RuntimeError(outcome.failure)
    return outcome.value


if __name__ == "__main__":
    main()
