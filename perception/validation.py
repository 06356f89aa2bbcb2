"""Whether a scan is one: everything later trusts its points, and libraries accept rotten ones in silence.

Each way to be rotten has a code of its own:

====================  =================================================================================
SCAN_EMPTY            there is no point
SCAN_MISMATCHED       points, intensities and beams are not as many, or not such arrays
SCAN_PATTERN          the scanner's description of its own beams makes no sense
SCAN_BEAMS            points that belong to no beam, to the beam of another, or to none of these
SCAN_NOT_FINITE       too many points that are NaN or infinite
SCAN_UNITS            the numbers are those of another unit
SCAN_RANGE            too many points nearer or further than the scanner measures
SCAN_MIRRORED         the cloud is the mirror image of what its beams saw
SCAN_TURNED           the cloud is turned against its beams: the axes are named otherwise
SCAN_EXTENT           a cloud too small, too large, too near or too far for a room
SCAN_FEW_RETURNS      too few beams came back
SCAN_INCOMPLETE       rows or a sector are missing
SCAN_FLAT             all points lie in one plane or on one line
SCAN_REPEATED         the scanner gave an earlier scan again
====================  =================================================================================
"""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from perception.failure import FailureError
from perception.intake import misfits
from perception.intake.census import Census, Kind, take_census
from perception.intake.repeats import Fingerprint, check_new, fingerprint_of
from perception.scan import BeamPattern, Scan

_SAMPLE = 200_000
"""Points that stand for all where a quantile is wanted."""
_ANGLE_SLACK = 1e-6


@dataclass(frozen=True)
class Limits:
    """What a plausible indoor scan looks like.

    Args:
        bad_share: largest share of points that may be dropped as not finite, out of range or off their beam.
        extent: smallest and largest side of the cloud's bounding box that is longest, metres.
        median_range: smallest and largest median range, metres; tells millimetres and feet from metres.
        return_share: smallest share of the beams that returned.
        empty_sector: widest gap in azimuth without any return, radians; walls nearer than the minimum range leave some.
        cut_sector: widest such gap between directions that did return, radians: jambs leave narrow ones, a scan that
            was broken off a wide one.
        cut_rows: largest share of rows of beams that are empty above rows that did return.
        flatness: smallest deviation (rms, metres) of the points from the plane that fits them best.
    """

    bad_share: float = 0.001
    extent: tuple[float, float] = (0.5, 400.0)
    median_range: tuple[float, float] = (0.3, 60.0)
    return_share: float = 0.15
    empty_sector: float = np.deg2rad(240.0)
    cut_sector: float = np.deg2rad(75.0)
    cut_rows: float = 0.02
    flatness: float = 0.03


@dataclass(frozen=True)
class Verdict:
    """A scan passed: which isolated points of it did not, and its figures without them.

    Args:
        bad: ``(K,)`` ascending places of the points that are to be left out (:meth:`Scan.without`): not finite, beyond
            the scanner's ranges, or off their beam's direction.
        return_share: share of the beams that returned.
        extent: sides of the bounding box, metres.
        median_range: metres, of a sample.
        empty_sector: widest azimuth without return, radians.
        fingerprint: by which a later copy of this scan is known.
    """

    bad: NDArray[np.intp]
    return_share: float
    extent: tuple[float, float, float]
    median_range: float
    empty_sector: float
    fingerprint: Fingerprint

    @property
    def dropped(self) -> int:
        return len(self.bad)


def validate(scan: Scan, limits: Limits | None = None, earlier: Iterable[Fingerprint] = ()) -> Verdict:
    """Check a scan as it came from the scanner and find its isolated bad points.

    One pass over the points; nothing is allocated by what the scan only claims to be.

    Args:
        scan: any arrays whatever, believed to be a scan.
        limits: None for a scanner that turns full circle in a building.
        earlier: fingerprints of the scans before; one of the same name is no other scan and is passed over.

    Raises:
        FailureError: one of the codes above.
    """
    limits = limits or Limits()
    _check_arrays(scan)
    _check_pattern(scan.pattern)
    _check_returns(len(scan.points), scan.pattern, limits)
    census = take_census(scan.points, scan.beam, scan.pattern)
    _check_census(scan, census, limits)
    bad = np.flatnonzero(census.kind)
    cleaned = scan.without(bad)
    sample = cleaned.points[:: 1 + len(cleaned.points) // _SAMPLE].astype(np.float64)
    ranges = np.linalg.norm(sample, axis=1)
    extent = census.high - census.low
    median = float(np.median(ranges))
    _check_size(float(extent.max()), ranges, limits)
    _check_spread(sample, limits)
    _check_returns(len(cleaned.points), scan.pattern, limits)
    sector = _check_complete(census, scan.pattern, limits)
    misfits.check_floor(sample, scan.base_from_scanner)
    fingerprint = fingerprint_of(cleaned)
    check_new(fingerprint, earlier)
    returned = len(cleaned.points) / scan.pattern.size
    sides = (float(extent[0]), float(extent[1]), float(extent[2]))
    return Verdict(bad, returned, sides, median, sector, fingerprint)


def _check_arrays(scan: Scan) -> None:
    count = len(scan.points)
    if count == 0:
        raise FailureError(
            "SCAN_EMPTY",
            "the scan holds no point, some thousands were expected: look whether the scanner's window is covered",
            points=0,
        )
    shapes = [np.shape(scan.points), np.shape(scan.intensity), np.shape(scan.beam)]
    kinds = [np.asarray(array).dtype.kind for array in (scan.points, scan.intensity, scan.beam)]
    if shapes != [(count, 3), (count,), (count,)] or kinds != ["f", "f", "i"]:
        raise FailureError(
            "SCAN_MISMATCHED",
            f"points, intensities and beams have the shapes {shapes}, expected {count} of each: scan again, and look "
            "at the driver if it stays so",
            shapes=[list(shape) for shape in shapes],
            kinds=kinds,
        )


def _check_pattern(pattern: BeamPattern) -> None:
    low, high = pattern.elevation_min, pattern.elevation_max
    ordered = -np.pi / 2 - _ANGLE_SLACK <= low < high <= np.pi / 2 + _ANGLE_SLACK
    if not (ordered and pattern.columns > 0 and pattern.rows > 1 and 0 <= pattern.range_min < pattern.range_max):
        raise FailureError(
            "SCAN_PATTERN",
            f"beams from {np.rad2deg(low):.4g} to {np.rad2deg(high):.4g} degrees elevation and ranges from "
            f"{pattern.range_min:.4g} to {pattern.range_max:.4g} m cannot be a scanner's: set its profile right",
            elevation=[float(low), float(high)],
            ranges=[float(pattern.range_min), float(pattern.range_max)],
            rows=pattern.rows,
            columns=pattern.columns,
        )


def _check_returns(points: int, pattern: BeamPattern, limits: Limits) -> None:
    returned = points / pattern.size
    if returned < limits.return_share:
        raise FailureError(
            "SCAN_FEW_RETURNS",
            f"{returned:.2%} of the {pattern.size:,} beams returned, at least {limits.return_share:.0%} are expected: "
            "look for a covered or dirty window, or scan from another spot",
            return_share=returned,
            limit=limits.return_share,
        )


def _check_census(scan: Scan, census: Census, limits: Limits) -> None:
    """Say of too many bad points the one cause that made them so."""
    total = len(scan.points)
    stray, repeated = int(census.counts[Kind.STRAY_BEAM]), int(census.counts[Kind.REPEATED_BEAM])
    if stray or repeated:
        raise FailureError(
            "SCAN_BEAMS",
            f"{stray} points name a beam beyond the {scan.pattern.size:,} of the pattern and {repeated} one that gave "
            "a point already, expected none: the scanner was set to another pattern than its driver believes",
            stray=stray,
            repeated=repeated,
        )
    allowed = limits.bad_share * total
    if (bad := int(census.counts[Kind.NOT_FINITE])) > allowed or bad == total:
        raise FailureError(
            "SCAN_NOT_FINITE",
            f"{bad / total:.2%} of the points are NaN or infinite, at most {limits.bad_share:.2%} are expected: the "
            "driver must leave missing returns out; scan again",
            share=bad / total,
            limit=limits.bad_share,
        )
    off = int(census.counts[Kind.OFF_BEAM])
    outside = int(census.counts[Kind.TOO_NEAR] + census.counts[Kind.TOO_FAR])
    if bad + off + outside > allowed:
        sample = slice(None, None, 1 + total // _SAMPLE)
        points, beams = scan.points[sample].astype(np.float64), scan.beam[sample]
        finite = np.isfinite(points).all(axis=1)
        found = misfits.Misfit(points[finite], beams[finite], outside / total, off / total)
        raise misfits.range_error(found, scan.pattern) if outside >= off else misfits.beam_error(found, scan.pattern)


def _check_size(extent: float, ranges: NDArray[np.float64], limits: Limits) -> None:
    for what, value, (low, high) in (
        ("widest side of the cloud", extent, limits.extent),
        ("median range", float(np.median(ranges)), limits.median_range),
    ):
        if not low <= value <= high:
            raise misfits.units_error(ranges, limits.median_range) or FailureError(
                "SCAN_EXTENT",
                f"the {what} is {value:.3g} m, expected between {low:g} and {high:g} m: check the units, or move the "
                "scanner to where it sees a room",
                value_m=value,
                limits_m=[low, high],
            )


def _check_spread(sample: NDArray[np.float64], limits: Limits) -> None:
    spread = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(sample.T, bias=True)), 0.0))
    if spread[0] < limits.flatness:
        shape = "on one line" if spread[1] < limits.flatness else "in one plane"
        raise FailureError(
            "SCAN_FLAT",
            f"all points lie {shape} to {1000 * spread[0]:.1f} mm, a room would spread by {limits.flatness:g} m or "
            "more: something covers the scanner, or its mirror does not turn",
            spread_m=spread.tolist(),
        )


def _check_complete(census: Census, pattern: BeamPattern, limits: Limits) -> float:
    """Refuse a scan with a part missing; the widest empty sector in radians otherwise."""
    missing = _missing_top(census.rows / pattern.columns)
    if missing > limits.cut_rows:
        raise FailureError(
            "SCAN_INCOMPLETE",
            f"the upper {missing:.0%} of the rows are missing though those below returned: the scan was broken off; "
            "scan again",
            missing_rows=missing,
        )
    sector, cut = _empty_sector(census.columns / pattern.rows)
    allowed = limits.cut_sector if cut else limits.empty_sector
    if sector > allowed:
        degrees = float(np.rad2deg(sector))
        raise FailureError(
            "SCAN_INCOMPLETE",
            f"nothing returned over {degrees:.0f} degrees, at most {np.rad2deg(allowed):.0f} are expected: the scan "
            "was broken off, or a wall is nearer than the scanner measures; scan again from another spot",
            empty_sector_deg=degrees,
        )
    return sector


def _missing_top(share: NDArray[np.float64]) -> float:
    """Share of empty rows at the top, if the rows below them returned: the sky takes beams little by little."""
    last = int(np.flatnonzero(share > 0)[-1])
    # The last row may itself be cut in its middle.
    broken_off = share[max(last - 3, 0) : last].mean() > 0.5 if last > 0 else False
    return float(len(share) - 1 - last) / len(share) if broken_off else 0.0


def _empty_sector(share: NDArray[np.float64]) -> tuple[float, bool]:
    """Widest azimuth without a return, radians, and whether it is cut off from directions that returned in full."""
    filled = np.flatnonzero(share > 0)
    gaps = np.diff(np.append(filled, filled[0] + len(share))) - 1
    widest = int(gaps.argmax())
    borders = share[[filled[widest], filled[(widest + 1) % len(filled)]]]
    return float(gaps[widest] * 2 * np.pi / len(share)), bool(borders.min() > 0.5)
