"""Garbage at length: ``python -m benchmarks.fuzz``.

Mutated frames through every codec, and raw connections with half handshakes against an agent in a process of its own,
plain and with keys, while a good client goes on asking. Prints what it cost, and exits 1 when a bar is missed.
"""

import argparse
import contextlib
import gc
import multiprocessing
import statistics
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from multiprocessing.connection import Connection
from pathlib import Path

from drivers.agent import serve_base
from drivers.wire.endpoints import Endpoints
from drivers.wire.keys import Keyring
from drivers.wire.roles import Role
from drivers.wire.sockets import Sockets
from tests.drivers.fuzzing import CODECS, mutated_frames, open_files, read_all_ways, resident, round_trip, storm
from tests.drivers.wire_fakes import ANYWHERE, FakeBase

MEGABYTE = 1 << 20
MEMORY_BAR = 5 * MEGABYTE
WAIT_BAR_S = 0.050
WARM_UP = 20_000
HELD = 200


def main() -> int:
    """Run both parts; 0 when every bar was kept."""
    parser = argparse.ArgumentParser(description=__doc__.partition(":")[0])
    parser.add_argument("--frames", type=int, default=1_000_000)
    parser.add_argument("--connections", type=int, default=5_000)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    kept = [fuzz_frames(arguments.seed, arguments.frames)]
    with tempfile.TemporaryDirectory() as folder:
        for guarded in (False, True):
            kept += [fuzz_connections(arguments.seed, arguments.connections, Path(folder), guarded)]
    return 0 if all(kept) else 1


def fuzz_frames(seed: int, count: int) -> bool:
    """Mutated frames through every codec; whether memory stayed within its bar. An uncaught exception ends it all."""
    for frame in mutated_frames(seed + 1, min(WARM_UP, count)):
        read_all_ways(frame)
    gc.collect()
    before, started, taken, most = resident(), time.process_time(), 0, 0
    for number, frame in enumerate(mutated_frames(seed, count)):
        taken += read_all_ways(frame)
        if number % 10_000 == 0:
            most = max(most, resident() - before)
    gc.collect()
    growth, cpu = resident() - before, time.process_time() - started
    print(
        f"frames: {count} mutated, {count * len(CODECS)} readings, {taken} taken, 0 uncaught exceptions; "
        f"memory {growth / MEGABYTE:+.2f} MB (most {most / MEGABYTE:+.2f}); {cpu:.0f} s of CPU, seed {seed}"
    )
    return growth < MEMORY_BAR


def fuzz_connections(seed: int, count: int, folder: Path, guarded: bool) -> bool:
    """Raw connections against an agent; whether a good client, the agent's files and its memory stayed as they were."""
    keyring, friend = (Keyring(folder / "agent"), Keyring(folder / "friend")) if guarded else (None, None)
    if keyring is not None and friend is not None:
        keyring.authorise(friend.own.public, Role.OBSERVER, "friend")
    with (
        _agent(keyring) as (pid, endpoints),
        Sockets(friend, endpoints.server_key).dealer(endpoints.control) as good,
    ):
        quiet = [_slowly(good) for _ in range(300)]
        for _ in storm(endpoints.control, seed + 1, min(2 * HELD, count), HELD):
            pass
        time.sleep(3.0)
        files, memory, started = open_files(pid), resident(pid), time.perf_counter()
        waits, newcomers, most_files = [], [], 0
        for number in storm(endpoints.control, seed, count, HELD):
            if number % 10 == 0:
                waits.append(round_trip(good))
                most_files = max(most_files, open_files(pid))
            if number % 100 == 0:
                with Sockets(friend, endpoints.server_key).dealer(endpoints.control) as newcomer:
                    newcomers.append(round_trip(newcomer))
        seconds = time.perf_counter() - started
        time.sleep(3.0)
        more_files, growth = open_files(pid) - files, resident(pid) - memory
    print(
        f"connections, {'with keys' if guarded else 'plain'}: {count} in {seconds:.0f} s; good client "
        f"{_figures(waits)} (before: {_figures(quiet)}), newcomer {_figures(newcomers)}; "
        f"files {more_files:+d} (most {most_files - files:+d}), memory {growth / MEGABYTE:+.2f} MB, seed {seed}"
    )
    # A machine that is busy with something else keeps even a client waiting that is alone.
    return max(waits) < max(WAIT_BAR_S, *quiet) and more_files <= 0 and growth < MEMORY_BAR


def _slowly(good: object) -> float:
    time.sleep(0.01)  # within its rate
    return round_trip(good)  # type: ignore[arg-type]


def _figures(seconds: list[float]) -> str:
    ordered = sorted(seconds)
    p99 = ordered[int(0.99 * (len(ordered) - 1))]
    return f"{1e3 * statistics.median(ordered):.1f}/{1e3 * p99:.1f}/{1e3 * ordered[-1]:.1f} ms (median/p99/worst)"


@contextlib.contextmanager
def _agent(keyring: Keyring | None) -> Iterator[tuple[int, Endpoints]]:
    """A base's agent in a process of its own: its id and its addresses."""
    spawn = multiprocessing.get_context("spawn")
    ours, theirs = spawn.Pipe()
    process = spawn.Process(target=_serve, args=(theirs, None if keyring is None else keyring.folder))
    process.start()
    try:
        assert process.pid is not None
        yield process.pid, ours.recv()
    finally:
        ours.send("stop")
        process.join(20.0)


def _serve(pipe: Connection, keys: Path | None) -> None:
    stop = threading.Event()
    threading.Thread(target=lambda: (pipe.recv(), stop.set()), daemon=True).start()
    serve_base(FakeBase(), ANYWHERE, pipe.send, stop, None if keys is None else Keyring(keys))


if __name__ == "__main__":
    sys.exit(main())
