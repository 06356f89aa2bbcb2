"""An executive reduced to what moves a base: a process that owns it, sends it to and fro, and beats at every tick.

It says on stdout, one JSON line each, that it owns the base and how each drive ended. SIGUSR1 wedges its tick loop for
``WEDGED_S``, while its other threads live on.
"""

import json
import signal
import sys
import time
from itertools import cycle
from pathlib import Path

import numpy as np

from drivers.interfaces import DriveGoal, Lease
from drivers.jobs import Failed, Running, wait_for
from drivers.wire.base_client import BaseClient
from drivers.wire.client import Patience
from drivers.wire.endpoints import Endpoints
from perception import transforms
from perception.grids import Grid

TICK_S = 0.1
WEDGED_S = 1.2
START = (1.0, 1.0, 0.0)
PLACES = ((3.2, 1.0), (3.2, 3.2), (1.0, 3.2), (1.0, 1.0))


def save_map(path: Path, grid: Grid) -> None:
    np.savez(path, data=grid.data, origin=grid.origin, resolution=grid.resolution)


def load_map(path: Path) -> Grid:
    with np.load(path) as file:
        x, y = file["origin"]
        return Grid(file["data"], (float(x), float(y)), float(file["resolution"]))


def say(**what: object) -> None:
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


def goal(name: str, robot_map: Grid, place: tuple[float, float], base: BaseClient) -> DriveGoal:
    """A place to go to; a base that was never told where it stands is at the start."""
    while (state := base.state()) is None:
        time.sleep(0.01)
    known = transforms.planar(*START) if state.map_from_base is None else None
    return DriveGoal(name, robot_map, "M1", known, *place)


def main(owner: str, control: str, telemetry: str, map_file: str) -> None:
    signal.signal(signal.SIGUSR1, lambda *_: time.sleep(WEDGED_S))
    robot_map = load_map(Path(map_file))
    base = BaseClient(Endpoints(control, telemetry=telemetry), Patience(first=0.5, longest=2.0, total=60.0))
    lease = wait_for(base.acquire(owner), 60.0)
    if not isinstance(lease, Lease):
        say(refused=lease.code, message=lease.message)
        return
    say(owns=lease.sequence)
    goals = (goal(f"{owner} {n}", robot_map, place, base) for n, place in enumerate(cycle(PLACES)))
    tick, drive = 0, base.drive(next(goals))
    while True:
        tick += 1
        base.beat(tick, may_move=True)
        outcome = drive.poll()
        if not isinstance(outcome, Running):
            say(ended=outcome.failure.code if isinstance(outcome, Failed) else "DONE")
            drive = base.drive(next(goals))
        time.sleep(TICK_S)


if __name__ == "__main__":
    main(*sys.argv[1:])
