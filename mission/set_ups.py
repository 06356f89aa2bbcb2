"""The set-ups of recorded files as scans: read, given back their origin where they lost it, and their beams."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drivers import recorded
from drivers.recorded import RawScan
from perception import transforms
from perception.intake import stations
from perception.scan import Scan
from perception.transforms import Matrix


@dataclass(frozen=True)
class SetUp:
    """One scan of a file.

    Args:
        source: file, and name within it.
        scan: with its beams.
        world_from_scanner: where its taker says it was taken, or where the cloud's floor shows it; None if neither.
        origin: ``file`` (the points are where a scanner saw them), ``pose`` (they were in the world's frame) or
            ``floor`` (a merged cloud: the view from one of its blind discs; views of one cloud share points).
        gridded: the beams are the file's rows and columns.
    """

    source: str
    scan: Scan
    world_from_scanner: Matrix | None
    origin: str
    gridded: bool


def set_ups(path: Path, first: int) -> Iterator[SetUp]:
    """The scans of a file, named from S01 on.

    Args:
        first: number of the first.

    Raises:
        FailureError: as :func:`drivers.recorded.read_file`; ``ORIGIN_UNKNOWN`` where the points were not taken from
            their origin and nothing shows from where.
    """
    number = first
    for raw in recorded.read_file(path):
        for view, origin in _views(raw):
            scan, gridded = recorded.scan_of(view, f"S{number:02d}")
            yield SetUp(view.source, scan, view.world_from_scanner, origin, gridded)
            number += 1


def _views(raw: RawScan) -> Iterator[tuple[RawScan, str]]:
    if stations.taken_from_origin(raw.points):
        yield raw, "file"
        return
    if raw.world_from_scanner is not None:
        # Some programs move the points to the world and write the pose as well.
        pose = raw.world_from_scanner
        own = (raw.points - pose[:3, 3]) @ pose[:3, :3]
        if stations.taken_from_origin(own):
            yield replace(raw, points=own), "pose"
            return
    # In a building's frame coordinates may have seven digits before the point.
    middle = np.round(np.median(raw.points, axis=0))
    near = raw.points - middle
    for number, station in enumerate(stations.find_stations(near), 1):
        source = f"{raw.source}, station {number}"
        pose = transforms.from_euler(0.0, 0.0, 0.0, middle + station)
        yield RawScan(stations.seen_from(near, station), source, pose), "floor"
