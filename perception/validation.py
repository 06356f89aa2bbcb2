"""Whether a scan is one: everything later trusts its points, and libraries accept rotten ones in silence."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from perception.failure import FailureError
from perception.scan import Scan


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
    """

    bad_share: float = 0.001
    extent: tuple[float, float] = (0.5, 400.0)
    median_range: tuple[float, float] = (0.3, 60.0)
    return_share: float = 0.15
    empty_sector: float = np.deg2rad(240.0)
    cut_sector: float = np.deg2rad(75.0)
    cut_rows: float = 0.02


@dataclass(frozen=True)
class ValidScan:
    """A scan that passed, without the isolated points that did not, and its figures.

    Args:
        scan: cleaned.
        dropped: points that were not finite, beyond the scanner's ranges, or off their beam's direction.
        return_share: share of the beams that returned.
        extent: sides of the bounding box, metres.
        median_range: metres.
        empty_sector: widest azimuth without return, radians.
    """

    scan: Scan
    dropped: int
    return_share: float
    extent: tuple[float, float, float]
    median_range: float
    empty_sector: float


def validate(scan: Scan, limits: Limits | None = None) -> ValidScan:
    """Check a scan as it came from the scanner and drop its isolated bad points.

    Raises:
        FailureError: ``SCAN_INVALID`` (empty, arrays that do not match, beams out of range or repeated, too many bad
            points, wrong units, mirrored) or ``SCAN_INCOMPLETE`` (too few returns, a sector missing).
    """
    limits = limits or Limits()
    _check_arrays(scan)
    good = _good(scan)
    dropped = int(np.count_nonzero(~good))
    cleaned = replace(scan, points=scan.points[good], intensity=scan.intensity[good], beam=scan.beam[good])
    finite = scan.points[_finite(scan.points)]
    _check_scale(finite, limits)
    if dropped > limits.bad_share * len(good):
        share = dropped / len(good)
        raise _invalid(f"{share:.2%} of the points are not finite, out of range or off their beam", dropped=dropped)
    sector = _check_complete(cleaned, limits)
    low, high = cleaned.points.min(axis=0), cleaned.points.max(axis=0)
    extent = (float(high[0] - low[0]), float(high[1] - low[1]), float(high[2] - low[2]))
    returned = len(cleaned.points) / scan.pattern.size
    return ValidScan(cleaned, dropped, returned, extent, _median_range(cleaned.points), sector)


def _invalid(message: str, **evidence: object) -> FailureError:
    return FailureError("SCAN_INVALID", message, **evidence)


def _check_arrays(scan: Scan) -> None:
    count = len(scan.points)
    if count == 0:
        raise _invalid("the scan is empty")
    if scan.points.shape != (count, 3) or len(scan.intensity) != count or len(scan.beam) != count:
        raise _invalid(
            "points, intensities and beams do not match",
            points=list(scan.points.shape),
            intensities=len(scan.intensity),
            beams=len(scan.beam),
        )
    if scan.beam.min() < 0 or scan.beam.max() >= scan.pattern.size:
        raise _invalid("beam indices beyond the pattern", largest=int(scan.beam.max()), size=scan.pattern.size)
    repeated = count - np.count_nonzero(np.bincount(scan.beam))
    if repeated:
        raise _invalid(f"{repeated} beams gave more than one point", repeated=int(repeated))


def _finite(points: NDArray[np.floating]) -> NDArray[np.bool_]:
    return np.logical_and.reduce(np.isfinite(points), axis=1)


def _good(scan: Scan) -> NDArray[np.bool_]:
    """Finite points within the scanner's ranges that lie in the direction of their beam."""
    finite = _finite(scan.points)
    points = np.where(finite[:, None], scan.points, 0.0)
    distance = np.linalg.norm(points, axis=1)
    # A tenth of slack, for noise and calibration move ranges at the limits.
    in_range = (distance > 0.9 * scan.pattern.range_min) & (distance < 1.1 * scan.pattern.range_max)
    along = np.einsum("ij,ij->i", points, scan.pattern.directions(scan.beam))
    tolerance = max(np.deg2rad(1.0), 2 * scan.pattern.azimuth_step, 2 * scan.pattern.elevation_step)
    return finite & in_range & (along > np.cos(tolerance) * distance)


def _check_scale(finite: NDArray[np.floating], limits: Limits) -> None:
    if len(finite) == 0:
        raise _invalid("no point is finite")
    # Few stray points are dropped later; they must not look like a wrong unit.
    low, high = np.percentile(finite, (0.1, 99.9), axis=0)
    extent = float((high - low).max())
    if not limits.extent[0] <= extent <= limits.extent[1]:
        raise _invalid(f"the cloud is {extent:.2f} m wide, beyond {limits.extent} m", extent_m=extent)
    median = _median_range(finite)
    if not limits.median_range[0] <= median <= limits.median_range[1]:
        raise _invalid(f"the median range is {median:.2f} m: wrong units?", median_range_m=median)


def _median_range(points: NDArray[np.floating]) -> float:
    return float(np.median(np.linalg.norm(points, axis=1)))


def _check_complete(scan: Scan, limits: Limits) -> float:
    """Refuse a scan with a part missing; the widest empty sector in radians otherwise."""
    image = scan.range_image() > 0
    returned = float(image.mean())
    if returned < limits.return_share:
        raise FailureError("SCAN_INCOMPLETE", f"only {returned:.1%} of the beams returned", return_share=returned)
    missing = _missing_top(image)
    if missing > limits.cut_rows:
        raise FailureError("SCAN_INCOMPLETE", f"the upper {missing:.0%} of the rows are missing", missing_rows=missing)
    sector, cut = _empty_sector(image)
    if sector > limits.empty_sector or (cut and sector > limits.cut_sector):
        degrees = float(np.rad2deg(sector))
        raise FailureError("SCAN_INCOMPLETE", f"no return over {degrees:.0f} degrees", empty_sector_deg=degrees)
    return sector


def _missing_top(image: NDArray[np.bool_]) -> float:
    """Share of empty rows at the top, if the rows below them returned: the sky takes beams little by little."""
    share = image.mean(axis=1)
    last = int(np.flatnonzero(share > 0)[-1])
    # The last row may itself be cut in its middle.
    broken_off = share[max(last - 3, 0) : last].mean() > 0.5 if last > 0 else False
    return float(len(share) - 1 - last) / len(share) if broken_off else 0.0


def _empty_sector(image: NDArray[np.bool_]) -> tuple[float, bool]:
    """Widest azimuth without a return, radians, and whether it is cut off from directions that returned in full."""
    share = image.mean(axis=0)
    filled = np.flatnonzero(share > 0)
    gaps = np.diff(np.append(filled, filled[0] + len(share))) - 1
    widest = int(gaps.argmax())
    borders = share[[filled[widest], filled[(widest + 1) % len(filled)]]]
    return float(gaps[widest] * 2 * np.pi / len(share)), bool(borders.min() > 0.5)
