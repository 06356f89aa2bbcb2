"""Scans of the school at the paper's data size, and the states of a mission through its largest room.

Scans are rendered once and kept in the system's folder for temporary files.
"""

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from drivers import scan_file
from drivers.simulated.profile import ScannerProfile
from drivers.simulated.scanner import SimulatedScanner
from drivers.simulated.world import World
from drivers.simulated.worlds import load_world
from perception import transforms
from perception.scan import Scan
from perception.transforms import Matrix

STEP_DEG = 0.08
STATIONS = (
    (2.0, -4.0, 0.4),
    (6.6, -3.2, 1.9),
    (4.4, -7.2, -2.4),
    (7.4, -6.4, 0.9),
    (1.2, -1.2, -0.7),
    (6.5, -0.9, 3.0),
)
"""Base poses (x, y, yaw) in the largest room of the school, in the order in which they are scanned."""


@dataclass(frozen=True)
class Placed:
    """A scan and where it was truly taken."""

    scan: Scan
    map_from_scanner: Matrix


@lru_cache(maxsize=1)
def school() -> World:
    return load_world("school", 0)


def largest_room(stations: Sequence[tuple[float, float, float]] = STATIONS) -> Iterator[Placed]:
    """The scans of the largest room (72 square metres, room-5), one after another."""
    for number, pose in enumerate(stations, 1):
        yield placed(pose, f"S{number:02d}")


def placed(pose: tuple[float, float, float], scan_id: str, step_deg: float = STEP_DEG) -> Placed:
    """One scan of the school from a pose of the base, tilted a little, as a floor tilts a robot."""
    profile = ScannerProfile()
    map_from_base = transforms.planar(*pose)
    tilt = (np.deg2rad(0.6), np.deg2rad(-0.4))
    name = f"school-{step_deg}-{scan_id}-" + "_".join(f"{value:.3f}" for value in pose)
    path = cache() / f"{name}.scan"
    if not path.exists():
        scan = SimulatedScanner(school(), profile, 1).cast(
            map_from_base, np.deg2rad(step_deg), scan_id, map_from_base, tilt
        )
        partial = path.with_suffix(".partial")
        scan_file.write(partial, scan)
        partial.replace(path)
    return Placed(scan_file.read(path), map_from_base @ transforms.from_euler(*tilt, 0.0) @ profile.base_from_scanner)


def cache() -> Path:
    folder = Path(tempfile.gettempdir()) / "building-scan-benchmarks"
    folder.mkdir(exist_ok=True)
    return folder
