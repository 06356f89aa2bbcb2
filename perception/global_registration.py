"""Registration without a trustworthy guess: search every heading and place, then refine and compare the best.

Gravity is known (section 3.1 levels each scan), so three unknowns remain, few enough for an exhaustive search. That
finds every place where a scan would fit, which is what tells a right answer from one of two equal ones; sampled feature
matches (FPFH) do not, and find little to hold on to on plain walls.
"""

from dataclasses import replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from perception import transforms
from perception.failure import FailureError
from perception.findings import Registration
from perception.matching.judgement import NEAR_ODOMETRY, RegistrationLimits, is_faultless, is_held
from perception.matching.surfels import Surface, Surfels
from perception.registration import Reference, plausibility, register, settle
from perception.transforms import Matrix

_CELL = 0.15
_HEADINGS = 8
_SLABS = 4
_SLAB_HEIGHT = 0.8
_YAW_STEP = np.deg2rad(3.0)
_SAMPLES = 1200
_REACH = 15.0
_HYPOTHESES = 24
_FINISHED = 6
_FAULTLESS_SHARE = 0.6
_RIVAL_SCORE = 0.6


def register_globally(
    source: Surface,
    reference: Reference,
    near: Matrix,
    radius: float = 3.0,
    yaw: float = float(np.pi),
    rival: float = 0.9,
) -> Registration:
    """Find the pose of a scan within ``radius`` metres and ``yaw`` radians of a rough guess.

    Args:
        source: the thinned scan in the scanner's frame.
        reference: the model in the map frame.
        near: rough ``map_from_scanner``; its roll, pitch and height are taken as right within some centimetres.
        rival: share of the best plausibility from which on another pose counts as just as good.

    Returns:
        The best pose with ``method`` "global", its correction measured from ``near``; to be judged like any other.

    Raises:
        FailureError: ``REG_AMBIGUOUS`` when two different poses fit alike, ``REG_DIVERGED`` when there is no surface.
    """
    hypotheses = _hypotheses(source.surfels, reference.surfels, near, radius, yaw)
    found: list[Registration] = []
    for rest in _hollows(source, reference, hypotheses):
        result = register(source, reference, rest.map_from_scanner, "global", starts=(1,))
        if all(not _same(result, other) for other in found):
            found = sorted([*found, result], key=plausibility, reverse=True)
            # The rest settled in less plausible places, so two that fit alike are enough to know.
            _refuse_rivals(found[0], found[1:], rival)
    if not found:
        raise FailureError("REG_DIVERGED", "there is no wall to search along", surfels=len(source.surfels))
    best = found[0]
    correction_m, correction_rad = transforms.difference(near, best.map_from_scanner)
    return replace(best, correction_m=correction_m, correction_rad=correction_rad)


def challenge(
    found: Registration,
    source: Surface,
    reference: Reference,
    guess: Matrix,
    expected_error: tuple[float, float],
    limits: RegistrationLimits = NEAR_ODOMETRY,
    rival: float = 0.9,
) -> None:
    """Return if no other pose that odometry would allow fits about as well as the one found.

    ICP comes to rest in the first hollow. Along a row of equal niches that is the one nearest to the guess, right or
    not; so the neighbourhood is searched for others.

    Args:
        found: from ``guess`` by :func:`registration.register`, judged good with the same ``expected_error``.
        rival: share of the plausibility of ``found`` from which on another pose counts as just as good.

    Raises:
        FailureError: ``REG_AMBIGUOUS``.
    """
    radius, yaw = limits.allowed(expected_error)
    others = []
    hypotheses = _hypotheses(source.surfels, reference.surfels, guess, radius, yaw, found.map_from_scanner)
    for rest in _hollows(source, reference, hypotheses):
        distance, angle = transforms.difference(guess, rest.map_from_scanner)
        if distance <= radius and angle <= yaw and not _same(rest, found):
            others.append(register(source, reference, rest.map_from_scanner, found.method, starts=(1,)))
    others = [other for other in others if not _same(other, found)]
    _refuse_rivals(found, sorted(others, key=plausibility, reverse=True), rival)


def _refuse_rivals(best: Registration, others: list[Registration], rival: float) -> None:
    rivals = [other for other in others if _is_rival(other, best, rival)]
    if rivals:
        distance, angle = transforms.difference(best.map_from_scanner, rivals[0].map_from_scanner)
        raise FailureError(
            "REG_AMBIGUOUS",
            f"two poses {distance:.2f} m and {np.rad2deg(angle):.0f} degrees apart fit alike "
            f"({best.fitness:.0%} and {rivals[0].fitness:.0%})",
            poses=[r.map_from_scanner.tolist() for r in (best, rivals[0])],
            fitness=[r.fitness for r in (best, rivals[0])],
        )


def _is_rival(other: Registration, best: Registration, rival: float) -> bool:
    """Whether another pose fits about as well, or fits without a fault although it overlaps less.

    The way that a scan overlaps most is not the likelier for it: turned about, it often covers more of what is known.
    """
    share = plausibility(other) / max(plausibility(best), 1e-9)
    if share >= _FAULTLESS_SHARE and is_faultless(other):
        return True
    # A pose that slides or turns freely is not found but left where it was: it does not speak against one that is held.
    return share >= rival and (is_held(other) or not is_held(best))


def _hollows(source: Surface, reference: Reference, hypotheses: list[Matrix]) -> list[Registration]:
    """The different places where a scan comes to rest from the hypotheses, the most plausible first.

    At most ``_FINISHED``, and none that is less than half as plausible as the first.
    """
    rests: list[Registration] = []
    for hypothesis in hypotheses:
        rest = settle(source, reference, hypothesis)
        if all(not _same(rest, other) for other in rests):
            rests.append(rest)
    rests.sort(key=plausibility, reverse=True)
    return [rest for rest in rests[:_FINISHED] if plausibility(rest) >= 0.5 * plausibility(rests[0])]


def _same(a: Registration, b: Registration) -> bool:
    distance, angle = transforms.difference(a.map_from_scanner, b.map_from_scanner)
    return distance < 0.2 and angle < np.deg2rad(5.0)


def _hypotheses(
    source: Surfels, reference: Surfels, near: Matrix, radius: float, yaw: float, besides: Matrix | None = None
) -> list[Matrix]:
    """The best peaks of the correlation over yaw, x and y, as ``map_from_scanner``.

    With ``besides`` a pose, only peaks away from it, and of those what comes near to its score.
    """
    level = near.copy()
    level[:2, 3] = 0.0
    upright = _searchable(source.moved(level), np.zeros(2))
    model = _searchable(reference, near[:2, 3])
    if len(upright) < 20 or len(model) < 20:
        return []
    upright = upright.pick(np.random.default_rng(0).permutation(len(upright))[:_SAMPLES])
    reach = int(np.ceil(radius / _CELL))
    volume = _volume(model, near[:2, 3], level[2, 3])
    count = max(1, round(2 * yaw / _YAW_STEP))
    yaws = np.linspace(-yaw, yaw, count, endpoint=yaw < 3.14)
    scores = np.stack([_score(upright, volume, angle, level[2, 3], reach) for angle in yaws])
    least = int(_RIVAL_SCORE * scores.max())
    if besides is not None:
        turned = np.angle(np.exp(1j * (yaws - _turn(near, besides))))
        k = int(np.argmin(np.abs(turned)))
        i, j = np.rint((besides[:2, 3] - near[:2, 3]) / _CELL).astype(int) + reach
        own = np.s_[max(0, k - 1) : k + 2, max(0, i - 1) : i + 2, max(0, j - 1) : j + 2]
        least = int(_RIVAL_SCORE * scores[own].max(initial=0))
        scores[own] = 0
    peaks = _peaks(scores, max(least, 1), wrap=yaw >= 3.14)
    return [_pose(level, yaws[k], near[:2, 3] + (np.array([i, j]) - reach) * _CELL) for k, i, j in peaks]


def _searchable(surfels: Surfels, centre: NDArray[np.float64]) -> Surfels:
    """Surfels that change when the scan is shifted or turned: all but the floor and the ceiling, and in reach."""
    near = np.abs(surfels.points[:, :2] - centre).max(axis=1) < _REACH
    return surfels.pick(near & (np.abs(surfels.normals[:, 2]) < 0.5))


def _channel(surfels: Surfels, height: float) -> NDArray[np.int64]:
    """Which image each surfel belongs to: eight headings of the normal times four slabs of height."""
    heading = np.arctan2(surfels.normals[:, 1], surfels.normals[:, 0])
    heading = np.rint(heading / (2 * np.pi / _HEADINGS)).astype(np.int64) % _HEADINGS
    slab = np.floor((surfels.points[:, 2] - height) / _SLAB_HEIGHT).astype(np.int64) + _SLABS // 2
    return heading * _SLABS + np.clip(slab, 0, _SLABS - 1)


def _volume(model: Surfels, centre: NDArray[np.float64], height: float) -> NDArray[np.uint8]:
    """``(channels, side, side)`` images of the reference: 4 where a surfel is, less beside it."""
    side = int(2 * _REACH / _CELL) + 1
    image = np.zeros((_HEADINGS * _SLABS, side, side), np.uint8)
    cells = np.floor((model.points[:, :2] - centre + _REACH) / _CELL).astype(np.int64)
    channel = _channel(model, height)
    for (dx, dy), value in {(-1, 0): 2, (1, 0): 2, (0, -1): 2, (0, 1): 2, (0, 0): 4}.items():
        x, y = np.clip(cells[:, 0] + dx, 0, side - 1), np.clip(cells[:, 1] + dy, 0, side - 1)
        np.maximum.at(image, (channel, x, y), value)
    # A normal near the border of two headings may fall on either side of it.
    spread = image.reshape(_HEADINGS, _SLABS, side, side)
    return np.maximum(spread, np.maximum(np.roll(spread, 1, 0), np.roll(spread, -1, 0)) // 2).reshape(image.shape)


def _score(upright: Surfels, volume: NDArray[np.uint8], yaw: float, height: float, reach: int) -> NDArray[np.int32]:
    turned = upright.moved(transforms.planar(0, 0, yaw))
    cells = np.floor((turned.points[:, :2] + _REACH) / _CELL).astype(np.int64)
    return _correlate(volume, _channel(turned, height), cells, reach)


@njit(cache=True)
def _correlate(
    volume: NDArray[np.uint8], channel: NDArray[np.int64], cells: NDArray[np.int64], reach: int
) -> NDArray[np.int32]:
    side = volume.shape[1]
    scores = np.zeros((2 * reach + 1, 2 * reach + 1), np.int32)
    for n in range(len(channel)):
        image = volume[channel[n]]
        for i in range(2 * reach + 1):
            x = cells[n, 0] + i - reach
            if 0 <= x < side:
                for j in range(2 * reach + 1):
                    y = cells[n, 1] + j - reach
                    if 0 <= y < side:
                        scores[i, j] += image[x, y]
    return scores


def _turn(near: Matrix, pose: Matrix) -> float:
    """Heading of a pose from another that is tilted alike."""
    turn = pose[:3, :3] @ near[:3, :3].T
    return float(np.arctan2(turn[1, 0] - turn[0, 1], turn[0, 0] + turn[1, 1]))


def _peaks(scores: NDArray[np.int32], least: int, wrap: bool) -> list[tuple[int, int, int]]:
    """Best ``_HYPOTHESES`` maxima of at least ``least``, no two of them within 15 degrees and 0.6 m of each other."""
    scores = scores.copy()
    turn, shift = round(np.deg2rad(15.0) / _YAW_STEP), round(0.6 / _CELL)
    peaks = []
    for _ in range(_HYPOTHESES):
        k, i, j = (int(v) for v in np.unravel_index(int(np.argmax(scores)), scores.shape))
        if scores[k, i, j] < least:
            break
        peaks.append((k, i, j))
        turns = np.arange(k - turn, k + turn + 1)
        turns = turns % len(scores) if wrap else turns[(turns >= 0) & (turns < len(scores))]
        scores[turns, max(0, i - shift) : i + shift + 1, max(0, j - shift) : j + shift + 1] = 0
    return peaks


def _pose(level: Matrix, yaw: float, xy: NDArray[np.float64]) -> Matrix:
    pose = transforms.planar(0, 0, yaw) @ level
    pose[:2, 3] = xy
    return pose
