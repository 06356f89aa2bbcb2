"""The two simulated agents as processes: each announces on stdout where it listens, then serves until it is ended."""

import json
import math
import sys
import threading
from pathlib import Path

import numpy as np

from drivers.agent import serve_base, serve_scanner
from drivers.interfaces import DriveGoal
from drivers.simulated.base import SimulatedBase
from drivers.simulated.clock import ScaledClock
from drivers.simulated.desertion import deserted
from drivers.simulated.profile import SCANNERS
from drivers.simulated.scanner import SimulatedScanner
from drivers.simulated.scanner_device import SimulatedScannerDevice
from drivers.simulated.scenario import Scenario, load_scenario
from drivers.simulated.side_channel import StanceServer, ask_stance
from drivers.simulated.truth_log import TruthLog
from drivers.simulated.whereabouts import Whereabouts
from drivers.simulated.world import World, read_world
from drivers.wire.endpoints import Endpoints
from drivers.wire.keys import Keyring
from perception.failure import FailureError
from perception.grids import Cell, Grid


def run_scanner_agent(
    world: Path,
    truth: Path,
    plant: str,
    endpoints: Endpoints,
    profile: str = "vz-400",
    seed: int = 0,
    speed: float = 1.0,
    scenario: Path | None = None,
    keys: Path | None = None,
    serves: Path | None = None,
) -> None:
    """Serve a simulated scanner in a world until SIGTERM.

    Args:
        world: file written by :func:`drivers.simulated.world.save_world`.
        truth: folder of the truth log and of the scanner's spool.
        plant: side channel of the simulated base, on which the scanner stands.
        keys: folder of the keys that may come in; without one only this machine can.
        serves: file that names the process of the one mission it is there for; without such a process it ends after a
            while by itself (:mod:`drivers.simulated.desertion`).

    Raises:
        FailureError: ``PROFILE_UNKNOWN``, or as :func:`drivers.agent.serve_scanner`.
    """
    if profile not in SCANNERS:
        raise FailureError("PROFILE_UNKNOWN", f"no scanner profile '{profile}'; known: {', '.join(SCANNERS)}")
    device = SimulatedScannerDevice(
        SimulatedScanner(read_world(world), SCANNERS[profile], seed),
        lambda: ask_stance(plant),
        ScaledClock(speed),
        _scenario(scenario).scanner,
        TruthLog(truth),
    )
    serve_scanner(device, endpoints, truth / "spool", lambda bound: announce(bound), _end_of(serves), _keyring(keys))


def run_base_agent(
    world: Path,
    truth: Path,
    plant: str,
    endpoints: Endpoints,
    seed: int = 0,
    speed: float = 1.0,
    scenario: Path | None = None,
    keys: Path | None = None,
    serves: Path | None = None,
) -> None:
    """Serve a simulated base in a world until SIGTERM; see :func:`run_scanner_agent`.

    Started again with the same ``truth`` it stands where it stood, and its odometry begins anew.
    """
    building = read_world(world)
    warm_up(building)
    base = SimulatedBase(
        building, scenario=_scenario(scenario), seed=seed, truth=TruthLog(truth), whereabouts=Whereabouts(truth)
    )
    channel = StanceServer(base.stance, plant)
    ended = threading.Event()
    motion = threading.Thread(target=base.run, args=(ScaledClock(speed), ended.is_set), name="motion", daemon=True)
    motion.start()
    try:
        serve_base(
            base, endpoints, lambda bound: announce(bound, plant=channel.endpoint), _end_of(serves), _keyring(keys)
        )
    finally:
        ended.set()
        motion.join()
        channel.close()


def warm_up(world: World) -> None:
    """Drive a throw-away base a little, before any real one may move.

    What is compiled at its first use would cost the first goal its deadline, and hold the control loop for seconds
    while the wheels turn.
    """
    nowhere = Grid(np.full((120, 120), Cell.FREE, np.uint8), (-3.0, -3.0), 0.05)
    base = SimulatedBase(world)
    base.permit(math.inf)
    base.start_drive(DriveGoal("warm-up", nowhere, "nowhere", np.eye(4), 0.5, 0.0))
    for _ in range(100):
        base.step(0.05)


def announce(bound: Endpoints, **more: str) -> None:
    """One JSON line on stdout with every address, for whoever started the process."""
    told = {"control": bound.control, "bulk": bound.bulk, "telemetry": bound.telemetry, **more}
    sys.stdout.write(json.dumps(told) + "\n")
    sys.stdout.flush()


def _end_of(served: Path | None) -> threading.Event:
    return deserted(served) if served else threading.Event()


def _keyring(folder: Path | None) -> Keyring | None:
    return Keyring(folder) if folder else None


def _scenario(path: Path | None) -> Scenario:
    return load_scenario(path) if path else Scenario()
