"""The worker's memory: what stages need again and again of the scans of a run.

Scans stay on the disk. What is kept of them is bounded by bytes and not by their number, so that the last room of a
building finds the worker as it was in the first.
"""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from drivers import scan_file
from mission.stages.memory import Memory
from mission.store import RunFolder
from perception import transforms
from perception.matching.surfels import Surface, surface_of
from perception.scan import Scan
from perception.segmentation import one_per_voxel
from perception.transforms import Matrix
from perception.validation import Limits, Verdict, validate

T = TypeVar("T")

PlacedScans = Sequence[tuple[str, Sequence[Sequence[float]]]]
"""Scan ids with their ``map_from_scanner`` as nested lists."""

_MEGABYTE = 1 << 20
_WHOLE, _PRODUCTS = 330 * _MEGABYTE, 260 * _MEGABYTE
"""Bytes kept of whole scans (three of five million points) and of what was made of them."""
_THINNED = 0.025
_THINNED_POINTS = 600_000
_CLOUD_POINTS = 6_000_000
"""Of several scans in one cloud: those of a room and its neighbours, as dense as one alone; of a hall, less so."""
_PLACED_POINTS = 8_000_000
"""Of several scans side by side. More are coarsened: five million points each are more than a wall needs of ten."""
_COARSE_POINTS = 300_000
"""Of a scan that was labelled before."""
_OWN_BODY = (0.50, 0.35)
"""Half the length and width, metres, of what the robot covers, with a margin for tilt and noise."""


class Library:
    """Scans of one run: whole ones, and what is made of them, read or made again when it was forgotten.

    Args:
        run: the run folder.
        limits: what a scan must be like to be believed; None for a scanner that turns full circle.
    """

    def __init__(self, run: RunFolder, limits: Limits | None = None) -> None:
        self.run = run
        self.limits = limits
        self._verdicts: dict[str, Verdict] = {}
        self._left_out: dict[str, NDArray[np.intp]] = {}
        self._whole: Memory[Scan] = Memory(_WHOLE)
        self._products: Memory[Any] = Memory(_PRODUCTS)

    def verdict(self, scan_id: str) -> Verdict:
        """What validation found of a scan, the first time it was read. Raises as :func:`validate`, or as reading."""
        if scan_id not in self._verdicts:
            self.scan(scan_id)
        return self._verdicts[scan_id]

    def scan(self, scan_id: str) -> Scan:
        """A valid scan, whole but for its bad points and for what the scanner saw of the robot that carries it."""
        return self._whole.get(scan_id, lambda: self._read(scan_id))

    def _read(self, scan_id: str) -> Scan:
        known = scan_id in self._verdicts
        scan = scan_file.read(self.run.scan_file(scan_id), checked=known)
        if not known:
            verdict = validate(scan, self.limits, [earlier.fingerprint for earlier in self._verdicts.values()])
            self._left_out[scan_id] = np.union1d(verdict.bad, own_body(scan))
            self._verdicts[scan_id] = verdict
        return scan.without(self._left_out[scan_id])

    def surface(self, scan_id: str) -> Surface:
        """What registration sees of a scan."""
        return self._keep("surface", scan_id, lambda: surface_of(self.scan(scan_id).points))

    def thinned(self, scan_id: str) -> NDArray[np.float32]:
        """``(N, 3)`` points of a scan, scanner frame, at most one in each cube of 2.5 cm."""

        def thin() -> NDArray[np.float32]:
            points = self.scan(scan_id).points
            return points[one_per_voxel(points, _THINNED, limit=_THINNED_POINTS)]

        return self._keep("thinned", scan_id, thin)

    def cloud(self, placed: PlacedScans) -> tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.int64]]:
        """Thinned points of several scans in the map frame, the stations ``(S, 3)``, and each point's station."""
        poses = [matrix(pose) for _, pose in placed]
        share = -(-len(placed) * _THINNED_POINTS // _CLOUD_POINTS)
        parts = [
            transforms.apply(pose, self.thinned(name)[::share]) for (name, _), pose in zip(placed, poses, strict=True)
        ]
        stations = np.array([pose[:3, 3] for pose in poses])
        return np.concatenate(parts), stations, np.repeat(np.arange(len(parts)), [len(part) for part in parts])

    def placed(self, placed: PlacedScans) -> list[tuple[Scan, Matrix]]:
        """Scans with their poses, each with every k-th row and column of its beams where whole ones are too many."""
        return [(self._coarse(name, len(placed)), matrix(pose)) for name, pose in placed]

    def coarse(self, scan_id: str) -> Scan:
        """A scan with about as many beams as it takes to look again at some voxels, far cheaper to keep and to read."""
        return self._coarse(scan_id, _PLACED_POINTS // _COARSE_POINTS)

    def _coarse(self, scan_id: str, scans: int) -> Scan:
        step = int(np.ceil(np.sqrt(scans * self.verdict(scan_id).fingerprint.pattern.size / _PLACED_POINTS)))
        if step == 1:
            return self.scan(scan_id)
        return self._keep(f"every {step}", scan_id, lambda: self.scan(scan_id).every(step))

    def _keep(self, kind: str, scan_id: str, make: Callable[[], T]) -> T:
        value: T = self._products.get((kind, scan_id), make)
        return value


def without_own_body(scan: Scan) -> Scan:
    """A scan without the returns from over the base's footprint, below the scanner: a short minimum range lets them
    in, and they would wall the robot in wherever it stands."""
    return scan.without(own_body(scan))


def own_body(scan: Scan) -> NDArray[np.intp]:
    """Places of the points on the robot itself, ascending."""
    length, width = _OWN_BODY
    x, y, mounted = scan.base_from_scanner[:3, 3]
    reach = np.hypot(np.hypot(abs(x) + length, abs(y) + width), max(mounted, 0.0))
    # Most points are far away; only the near ones are worth a transform.
    near = np.flatnonzero(np.einsum("ij,ij->i", scan.points, scan.points) < reach**2)
    x, y, z = transforms.apply(scan.base_from_scanner, scan.points[near]).T
    return near[(np.abs(x) < length) & (np.abs(y) < width) & (z > 0) & (z < mounted)]


def matrix(pose: Sequence[Sequence[float]]) -> Matrix:
    return np.asarray(pose, np.float64)
