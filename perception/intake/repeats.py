"""Whether a scan is an earlier one again: a scanner that is stuck answers with what it still holds."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perception import transforms
from perception.failure import FailureError
from perception.scan import BeamPattern, Scan
from perception.transforms import Matrix

_BEAMS = 4096
_SAME_RETURNS = 0.98
_SAME_RANGE = 3e-4
"""Metres. Ranges of two real scans differ by their noise, a millimetre or more, wherever they were taken."""
_MOVED_M, _MOVED_RAD = 0.10, np.deg2rad(2.0)


@dataclass(frozen=True)
class Fingerprint:
    """Some kilobytes of a scan by which a copy of it is known.

    Args:
        ranges: of every so many beams, metres; 0 where nothing returned.
        odom_from_base: where the base believed to stand.
    """

    scan_id: str
    pattern: BeamPattern
    ranges: NDArray[np.float32]
    odom_from_base: Matrix


def fingerprint_of(scan: Scan) -> Fingerprint:
    # A power of two, for its remainder is a mask: cheap on five million beams.
    stride = 1 << max(0, scan.pattern.size // _BEAMS).bit_length()
    index = np.flatnonzero((scan.beam & (stride - 1)) == 0)
    ranges = np.zeros(-(-scan.pattern.size // stride), np.float32)
    ranges[scan.beam[index] // stride] = np.linalg.norm(scan.points[index], axis=1)
    return Fingerprint(scan.scan_id, scan.pattern, ranges, scan.odom_from_base)


def check_new(scan: Fingerprint, earlier: Iterable[Fingerprint]) -> None:
    """Refuse a scan that is an earlier one to the bit, or to a fraction of any noise though the base has moved.

    A corridor looks the same from every spot, and a room the same from one spot: only the noise tells.

    Raises:
        FailureError: ``SCAN_REPEATED``.
    """
    for other in earlier:
        if other.scan_id == scan.scan_id or other.pattern != scan.pattern:
            continue
        either, both = (scan.ranges > 0) | (other.ranges > 0), (scan.ranges > 0) & (other.ranges > 0)
        if not both.any() or both.sum() < _SAME_RETURNS * either.sum():
            continue
        difference = float(np.median(np.abs(scan.ranges[both] - other.ranges[both])))
        moved, turned = transforms.difference(scan.odom_from_base, other.odom_from_base)
        identical = np.array_equal(scan.ranges, other.ranges)
        if identical or (difference < _SAME_RANGE and (moved > _MOVED_M or turned > _MOVED_RAD)):
            raise FailureError(
                "SCAN_REPEATED",
                f"this is {other.scan_id} again: its ranges differ by {1000 * difference:.2f} mm, at least "
                f"{1000 * _SAME_RANGE:.1f} mm of noise are expected, and the base moved {moved:.2f} m: the scanner is "
                "stuck; restart it and scan again",
                repeats=other.scan_id,
                difference_m=difference,
                moved_m=moved,
                turned_deg=float(np.rad2deg(turned)),
            )
