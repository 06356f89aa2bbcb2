"""Registration of a new scan to the cloud (paper section 5): odometry guess, then ICP, then doubt.

The smallest residual is not proof of the right place: along a bare corridor every slide fits. So the result carries
how well the pairs hold each direction and how far it moved from the odometry, and :func:`judgement.judge` refuses what
is not certain.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from perception import transforms
from perception.failure import FailureError
from perception.findings import Registration
from perception.matching.constraint import hold
from perception.matching.judgement import NEAR_ODOMETRY, RegistrationLimits, judge
from perception.matching.surfels import SPACING, Surface, Surfels, first_per_voxel, surface_of
from perception.transforms import Matrix

__all__ = [
    "NEAR_ODOMETRY",
    "Reference",
    "RegistrationLimits",
    "anchor",
    "judge",
    "reference_from",
    "register",
    "surface_of",
]


@dataclass(frozen=True)
class Level:
    """One step from coarse to fine: largest correspondence distance (metres), source surfels used, iterations."""

    distance: float
    samples: int
    iterations: int


LEVELS = (Level(0.5, 2000, 25), Level(0.2, 3000, 20), Level(0.08, 5000, 15), Level(0.03, 10000, 12))

_OFFSET_DAMPING = 1e-3
_WORTH_A_THREAD = 4000
_SETTLING = 1500


class Reference:
    """The thinned model of earlier scans around a place, in the map frame, with its search tree.

    Pairs are sought in six dimensions (position, and normal times ``NORMAL_WEIGHT`` metres), so that a surfel finds its
    own wall's face and not the nearer one behind it.
    """

    NORMAL_WEIGHT = 0.3

    def __init__(self, surfels: Surfels, views: Sequence[tuple[Surface, Matrix]]) -> None:
        self.surfels = surfels
        self._views = views
        self._tree = cKDTree(self._features(surfels), balanced_tree=False, compact_nodes=False)

    def _features(self, surfels: Surfels) -> NDArray[np.float32]:
        return np.hstack([surfels.points, self.NORMAL_WEIGHT * surfels.normals])

    def pairs(self, source: Surfels, distance: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Index of each paired source surfel and of its partner, about ``distance`` metres and 20 degrees apart."""
        workers = 2 if len(source) > _WORTH_A_THREAD else 1
        _, partner = self._tree.query(self._features(source), distance_upper_bound=distance + 0.1, workers=workers)
        found = np.flatnonzero(partner < len(self.surfels))
        return found, partner[found]

    def conflict(self, source: Surface, map_from_scanner: Matrix) -> float:
        """Share of known surface that one of the two sides saw through, of all that either side could test."""
        confirmed, through = source.compare(self.surfels.moved(transforms.inverse(map_from_scanner)))
        for view, map_from_view in self._views:
            more = view.compare(source.surfels.moved(transforms.inverse(map_from_view) @ map_from_scanner))
            confirmed, through = confirmed + more[0], through + more[1]
        return through / max(confirmed + through, 1)


def reference_from(
    scans: Sequence[tuple[Surface, Matrix]], near: tuple[float, float] | None = None, radius: float = 15.0
) -> Reference:
    """Model to register a new scan to, built once per cycle.

    Args:
        scans: each earlier scan's surface and its ``map_from_scanner``, oldest first: where scans overlap the first
            keeps its surfels, so that small errors of later ones do not creep along the chain.
        near: (x, y) in the map frame to keep the surroundings of, or None for everything.
        radius: metres around ``near``.
    """
    surfels = Surfels.joined([surface.surfels.moved(pose) for surface, pose in scans])
    views = list(scans)
    if near is not None:
        surfels = surfels.pick(np.hypot(*(surfels.points[:, :2] - near).T) <= radius)
        views = [view for view in scans if np.hypot(*(view[1][:2, 3] - near)) <= radius]
    facing = np.argmax(np.abs(surfels.normals), axis=1)
    sense = np.take_along_axis(surfels.normals, facing[:, None], axis=1)[:, 0] > 0
    return Reference(surfels.pick(first_per_voxel(surfels.points, SPACING, 2 * facing + sense)), views)


def anchor(map_from_scanner: Matrix) -> Registration:
    """The registration of the first scan, which defines the map frame."""
    return Registration(map_from_scanner, 1.0, 0.0, 1.0, 1 / 3, (0.0, 0.0, 1.0), 0.0, 0.0, "anchor")


def register(
    source: Surface, reference: Reference, guess: Matrix, method: str = "icp", starts: Sequence[int] = (0, 1)
) -> Registration:
    """Align a scan to the reference by point-to-plane ICP, coarse to fine, with Tukey's weights.

    Args:
        source: the thinned scan in the scanner's frame (:func:`surface_of`).
        reference: the model (:func:`reference_from`) in the map frame.
        guess: ``map_from_scanner`` as odometry (or a global search) has it.
        method: name to put into the result.
        starts: levels to start from; the more plausible result wins. Where little of the scan is known ground, coarse
            pairs can drag it away from a guess that was good enough.

    Returns:
        The pose with its figures, good or bad; :func:`judge` decides.

    Raises:
        FailureError: ``REG_DIVERGED`` when there is too little surface to pair at all.
    """
    if min(len(source.surfels), len(reference.surfels)) < 50:
        raise FailureError(
            "REG_DIVERGED",
            f"too little flat surface to register: {len(source.surfels)} surfels to {len(reference.surfels)}",
            source=len(source.surfels),
            reference=len(reference.surfels),
        )
    shuffled = _shuffled(source)
    poses = [_descend(shuffled, reference, guess, LEVELS[start:]) for start in starts]
    judged = Surface(shuffled.pick(np.s_[: LEVELS[-1].samples]), source.sight)
    return max((_assess(judged, reference, guess, pose, method) for pose in poses), key=plausibility)


def settle(source: Surface, reference: Reference, guess: Matrix) -> Registration:
    """Where a scan comes to rest from a guess, to some centimetres and quickly: to tell one hollow from another."""
    few = _shuffled(source).pick(np.s_[:_SETTLING])
    pose = _descend(few, reference, guess, LEVELS[:2])
    return _assess(Surface(few, source.sight), reference, guess, pose, "settled")


def _shuffled(source: Surface) -> Surfels:
    return source.surfels.pick(np.random.default_rng(0).permutation(len(source.surfels)))


def plausibility(registration: Registration) -> float:
    """Fitness, less ten times the share of surface that would have been seen through: orders rival poses.

    Fitness alone prefers the pose that overlaps most; where a scan is right it sees through nothing.
    """
    return registration.fitness * max(0.0, 1.0 - 10.0 * registration.conflict)


def _descend(shuffled: Surfels, reference: Reference, guess: Matrix, levels: Sequence[Level]) -> Matrix:
    pose = guess.astype(np.float64, copy=True)
    for level in levels:
        sample = shuffled.pick(np.s_[: level.samples])
        for _ in range(level.iterations):
            step = _gauss_newton_step(sample.moved(pose), reference, level.distance, pose[:3, 3])
            pose = step @ pose
            if np.abs(step - np.eye(4)).max() < 1e-3 * level.distance:
                break
    return pose


@dataclass(frozen=True)
class _Pairs:
    """Paired surfels: source positions, partners' normals, distance along and off the normal, difference of slants."""

    positions: NDArray[np.float64]
    normals: NDArray[np.float64]
    residuals: NDArray[np.float64]
    asides: NDArray[np.float64]
    slants: NDArray[np.float64]


def _pair(source: Surfels, reference: Reference, distance: float) -> _Pairs:
    found, partner = reference.pairs(source, distance)
    positions = source.points[found].astype(np.float64)
    normals = reference.surfels.normals[partner].astype(np.float64)
    offset = positions - reference.surfels.points[partner]
    residuals = np.einsum("ij,ij->i", offset, normals)
    asides = np.sqrt(np.maximum(np.einsum("ij,ij->i", offset, offset) - residuals**2, 0.0))
    slants = source.slants[found].astype(np.float64) - reference.surfels.slants[partner]
    return _Pairs(positions, normals, residuals, asides, slants)


def _gauss_newton_step(moved: Surfels, reference: Reference, distance: float, pivot: NDArray[np.float64]) -> Matrix:
    """The small rigid motion of the source that lessens the weighted point-to-plane distances.

    The last steps also solve for the range offset of the instrument, a seventh unknown: a scanner that measures 5 mm
    too long sees a wall 5 mm too far head-on but less so from aside, which would bend a chain of poses.
    """
    pairs = _pair(moved, reference, distance)
    count = len(pairs.residuals)
    if count < 12:
        return np.eye(4)
    weight = np.where(np.abs(pairs.residuals) < distance, (1 - (pairs.residuals / distance) ** 2) ** 2, 0.0)
    arm = pairs.positions - pivot
    jacobian = np.hstack([np.cross(arm, pairs.normals), pairs.normals, pairs.slants[:, None]])
    information = jacobian.T @ (weight[:, None] * jacobian)
    # The tiny damping keeps an unheld direction where odometry put it instead of letting rounding drive it.
    offset_damping = _OFFSET_DAMPING if distance <= LEVELS[2].distance else 1e6
    information += count * np.diag([1e-4] * 6 + [offset_damping])
    update = -np.linalg.solve(information, jacobian.T @ (weight * pairs.residuals))
    step = np.eye(4)
    step[:3, :3] = Rotation.from_rotvec(update[:3]).as_matrix()
    step[:3, 3] = update[3:6] + pivot - step[:3, :3] @ pivot
    return step


def _assess(source: Surface, reference: Reference, guess: Matrix, pose: Matrix, method: str) -> Registration:
    pairs = _pair(source.surfels.moved(pose), reference, 0.10)
    on_surface = (pairs.asides < 0.10) & (np.abs(pairs.residuals) < 0.10)
    close = on_surface & (np.abs(pairs.residuals) < LEVELS[-1].distance)
    count = int(np.count_nonzero(close))
    held = hold(pairs.positions[close], pairs.normals[close])
    correction_m, correction_rad = transforms.difference(guess, pose)
    return Registration(
        map_from_scanner=pose,
        fitness=count / len(source.surfels),
        rmse=float(np.sqrt(np.mean(pairs.residuals[close] ** 2))) if count else float("inf"),
        overlap=float(np.count_nonzero(on_surface) / len(source.surfels)),
        min_eigenvalue=held.shift,
        weak_axis=held.shift_axis,
        correction_m=correction_m,
        correction_rad=correction_rad,
        method=method,
        conflict=reference.conflict(source, pose),
        turn_hold=held.turn,
        turn_axis=held.turn_axis,
    )
