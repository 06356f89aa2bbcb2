"""How long a tick takes while perception uses every core: `python -m benchmarks.tick`.

The whole mission runs, with its sockets, its worker and its files, and beside it one process for each core that never
rests. Prints one JSON object: milliseconds of the wall of a tick, all that is called from it included, alone and with
the neighbours. The bar is 20 ms at the 99th percentile.
"""

import argparse
import json
import multiprocessing
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from mission.journal import read_events
from mission.rehearsal import Rehearsal, rehearse


def measure(world: str, step_deg: float, speed: float, neighbours: int) -> dict[str, Any]:
    """Tick times of one simulated mission, with so many processes that never rest beside it."""
    with tempfile.TemporaryDirectory() as folder, busy(neighbours):
        plan = Rehearsal(world, step_deg=step_deg, speed=speed, profile="vz-400i")
        summary = rehearse(plan, Path(folder))
        events = read_events(Path(summary.run) / "events.jsonl")
        (ended,) = [event for event in events if event["kind"] == "mission_ended"]
        return {"outcome": summary.outcome, "scans": summary.scans, "tick_ms": ended["tick_ms"]}


@contextmanager
def busy(count: int) -> Iterator[None]:
    """So many processes that compute all the time, at the niceness of a perception worker."""
    context = multiprocessing.get_context("spawn")
    processes = [context.Process(target=_spin, daemon=True) for _ in range(count)]
    for process in processes:
        process.start()
    try:
        yield
    finally:
        for process in processes:
            process.terminate()
            process.join()


def _spin() -> None:
    os.nice(10)
    value = 1.0
    while True:
        value = value * 1.0000001 % 3.0


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("world", nargs="?", default="procedural")
    parser.add_argument("--step", type=float, default=0.2)
    parser.add_argument("--speed", type=float, default=20.0)
    asked = parser.parse_args()
    found = {
        name: measure(asked.world, asked.step, asked.speed, neighbours)
        for name, neighbours in (("alone", 0), ("with every core busy", os.cpu_count() or 2))
    }
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
