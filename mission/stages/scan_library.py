"""The worker's memory: what stages need again and again of the scans of a run, read once."""

from collections import OrderedDict
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from drivers import scan_file
from mission.store import RunFolder
from perception import transforms
from perception.scan import Scan
from perception.segmentation import one_per_voxel
from perception.surfels import Surface, surface_of
from perception.transforms import Matrix
from perception.validation import Limits, ValidScan, validate

T = TypeVar("T")

PlacedScans = Sequence[tuple[str, Sequence[Sequence[float]]]]
"""Scan ids with their ``map_from_scanner`` as nested lists."""

_WHOLE_SCANS = 12
_THINNED = 0.025
_OWN_BODY = (0.50, 0.35)
"""Half the length and width, metres, of what the robot covers, with a margin for tilt and noise."""


class Library:
    """Scans of one run: the whole ones while there is room, thinned ones and surfaces of all.

    What is kept of each scan for good is some megabytes, so that a mission of many rooms fits.

    Args:
        run: the run folder.
        limits: what a scan must be like to be believed; None for a scanner that turns full circle.
    """

    def __init__(self, run: RunFolder, limits: Limits | None = None) -> None:
        self.run = run
        self.limits = limits
        self._scans: OrderedDict[str, ValidScan] = OrderedDict()
        self._kept: dict[tuple[str, str], Any] = {}

    def valid(self, scan_id: str) -> ValidScan:
        """A validated scan with its figures, whole but for what the scanner saw of the robot that carries it."""
        if scan_id not in self._scans:
            valid = validate(scan_file.read(self.run.scan_file(scan_id)), self.limits)
            self._scans[scan_id] = replace(valid, scan=without_own_body(valid.scan))
        self._scans.move_to_end(scan_id)
        while len(self._scans) > _WHOLE_SCANS:
            self._scans.popitem(last=False)
        return self._scans[scan_id]

    def scan(self, scan_id: str) -> Scan:
        """The scan that :meth:`valid` has."""
        return self.valid(scan_id).scan

    def surface(self, scan_id: str) -> Surface:
        """What registration sees of a scan."""
        return self._keep("surface", scan_id, lambda: surface_of(self.scan(scan_id).points))

    def thinned(self, scan_id: str) -> NDArray[np.float32]:
        """``(N, 3)`` points of a scan, scanner frame, at most one in each cube of 2.5 cm."""

        def thin() -> NDArray[np.float32]:
            points = self.scan(scan_id).points
            return points[one_per_voxel(points, _THINNED, limit=600_000)]

        return self._keep("thinned", scan_id, thin)

    def cloud(self, placed: PlacedScans) -> tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.int64]]:
        """Thinned points of several scans in the map frame, the stations ``(S, 3)``, and each point's station."""
        poses = [matrix(pose) for _, pose in placed]
        parts = [transforms.apply(pose, self.thinned(name)) for (name, _), pose in zip(placed, poses, strict=True)]
        stations = np.array([pose[:3, 3] for pose in poses])
        return np.concatenate(parts), stations, np.repeat(np.arange(len(parts)), [len(part) for part in parts])

    def placed(self, placed: PlacedScans) -> list[tuple[Scan, Matrix]]:
        """Whole scans with their poses."""
        return [(self.scan(name), matrix(pose)) for name, pose in placed]

    def _keep(self, kind: str, scan_id: str, make: Callable[[], T]) -> T:
        if (kind, scan_id) not in self._kept:
            self._kept[kind, scan_id] = make()
        value: T = self._kept[kind, scan_id]
        return value


def without_own_body(scan: Scan) -> Scan:
    """A scan without the returns from over the base's footprint, below the scanner: a short minimum range lets them
    in, and they would wall the robot in wherever it stands."""
    x, y, z = transforms.apply(scan.base_from_scanner, scan.points).T
    length, width = _OWN_BODY
    own = (np.abs(x) < length) & (np.abs(y) < width) & (z > 0) & (z < scan.base_from_scanner[2, 3])
    return replace(scan, points=scan.points[~own], intensity=scan.intensity[~own], beam=scan.beam[~own])


def matrix(pose: Sequence[Sequence[float]]) -> Matrix:
    return np.asarray(pose, np.float64)
