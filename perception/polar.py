"""Seen gaps: what lies between two points of a floor or a ceiling that beams of one direction hit."""

import numpy as np
from numpy.typing import NDArray

_BIN = 0.025


def crossed_between(
    hits: NDArray[np.floating],
    places: NDArray[np.floating],
    height: float,
    clearance: float,
    azimuth_step: float,
    reach: float,
) -> NDArray[np.bool_]:
    """Which places a beam crossed close to a plane, on its way to a point of that plane further out.

    The points of a floor or a ceiling become sparse with distance. A place between two of them in one direction is
    free of walls if the beam to the further one had come within ``clearance`` of the plane at the nearer one. The
    points are entered into a polar image (direction, distance) whose gaps are filled along the distance.

    Args:
        hits: ``(N, 2)`` points of the plane relative to the scanner, metres.
        places: ``(M, 2)`` to ask for, relative to the scanner, metres.
        height: distance of the scanner from the plane, metres.
        clearance: metres.
        azimuth_step: of the scan or coarser, radians.
        reach: largest distance, metres.

    Returns:
        ``(M,)`` mask.
    """
    directions, distances = int(np.ceil(2 * np.pi / azimuth_step)), int(reach / _BIN) + 1
    polar = np.zeros((directions, distances), bool)
    direction, distance = _polar(hits[np.hypot(hits[:, 0], hits[:, 1]) < reach], directions)
    polar[direction, distance] = True
    index = np.arange(distances, dtype=np.int32)
    before = np.maximum.accumulate(np.where(polar, index, -1), axis=1)
    after = np.minimum.accumulate(np.where(polar, index, distances)[:, ::-1], axis=1)[:, ::-1]
    # Similar triangles: the beam that ends at `after` is at `before` this far from the plane.
    near = (before >= 0) & (after < distances) & ((after - before) * height <= clearance * np.maximum(after, 1))
    crossed = np.zeros(len(places), bool)
    within = np.hypot(places[:, 0], places[:, 1]) < reach
    crossed[within] = near[_polar(places[within], directions)]
    return crossed


def _polar(offset: NDArray[np.floating], directions: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    turn = np.arctan2(offset[:, 1], offset[:, 0]) / (2 * np.pi) % 1.0
    direction = np.minimum((turn * directions).astype(int), directions - 1)
    return direction, (np.hypot(offset[:, 0], offset[:, 1]) / _BIN).astype(int)
