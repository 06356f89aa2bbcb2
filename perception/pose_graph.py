"""The building's pose graph (beyond section 5): all poses reconsidered together when doors close loops.

Each scan was registered to what stood in the map before it, so small errors creep along the chain and meet where a
loop closes. Here every scan is compared once more, by itself, with the few that see most of the same surface, and
Open3D spreads the disagreement over all of them. The first scan stays where it is: it made the map frame.

No comparison is believed unseen. One that contradicts the map is refused before it enters the graph, one that
contradicts the others loses its weight in it (line process, Choi et al. 2015), and a result that fits worse than
the chain, or moves a scan further than registration can have been wrong, is not taken.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from perception import transforms
from perception.findings import PoseAdjustment
from perception.matching.surfels import Surface
from perception.registration import LEVELS, Reference, RegistrationLimits, judge, reference_from, register
from perception.transforms import Matrix

Poses = Mapping[str, Matrix]
"""``map_from_scanner`` by scan id, in the order in which the scans were placed."""

_CELL = 0.5
_MIN_SHARED = 0.12
_BEST, _FAR, _FAR_HOPS = 2, 2, 3

_LIMITS = RegistrationLimits(min_overlap=0.10, max_conflict=0.06, min_eigenvalue=0.0, min_turn=0.0, sigmas=0.0)
"""For two scans alone: little overlap is enough, and the information says which direction the pair does not hold.
What remains of the limits on the correction is their slack, for the map is good to centimetres."""

_CLOSE = LEVELS[-1].distance
_OFFSET_DAMPING = 1e-3
_FULL_SHARE = 0.5

_CHAIN_WEIGHT = 0.02
_CHAIN_INFORMATION = np.diag([4.0, 4.0, 4.0, 1 / 3, 1 / 3, 1 / 3])
"""What registration said, faintly: it holds a scan that no comparison holds, and decides nothing else."""

_PER_SQUARE_METRE = 1e6
_BELIEF = (0.05, 0.02, 0.01, 0.004)
"""Disagreement, metres rms, at which a comparison is disbelieved: generous while a loop still gapes, then strict,
for true comparisons agree to a millimetre once it is closed."""
_PRUNED = 0.25

_UNHEARD_OF = 0.003
"""A comparison that contradicts the map by more, metres rms, needs another one that says the same."""

_MENDED = 0.5

PLAUSIBLE_M = 0.10
"""No accepted registration can have been wrong by more, metres."""


@dataclass(frozen=True)
class Comparison:
    """Two scans compared with each other alone.

    Args:
        target, source: ids of the scans, the earlier one first.
        target_from_source: 4x4, as measured.
        information: ``(6, 6)``; ``x @ information @ x`` is the mean square distance, square metres, that a small motion
            x (rotation vector, translation) of the source in its own frame puts between the surfaces.
        rmse: distance of the surfaces where they fit best, metres.
        overlap: share of the source on the target's surface.
    """

    target: str
    source: str
    target_from_source: Matrix
    information: NDArray[np.float64]
    rmse: float
    overlap: float

    @property
    def weight(self) -> float:
        """In (0, 1]. Not the number of pairs: what errors the instrument has in common no number averages out."""
        return min(1.0, self.overlap / _FULL_SHARE)

    def disagreement(self, poses: Poses) -> float:
        """Root mean square distance, metres, that these poses put between the surfaces on top of ``rmse``."""
        off = transforms.inverse(self.target_from_source) @ transforms.inverse(poses[self.target]) @ poses[self.source]
        turn = np.array([off[2, 1] - off[1, 2], off[0, 2] - off[2, 0], off[1, 0] - off[0, 1]]) / 2
        motion = np.concatenate([turn, off[:3, 3]])
        return float(np.sqrt(max(motion @ self.information @ motion, 0.0)))


# --- which scans to compare -----------------------------------------------------------------------------------------


def footprint(surface: Surface, map_from_scanner: Matrix) -> NDArray[np.int64]:
    """Sorted keys of the half-metre cells that a scan has surface in, each of the six ways it may face apart."""
    surfels = surface.surfels.moved(map_from_scanner)
    facing = np.argmax(np.abs(surfels.normals), axis=1)
    sense = np.take_along_axis(surfels.normals, facing[:, None], axis=1)[:, 0] > 0
    cells = np.floor(surfels.points / _CELL).astype(np.int64) + (1 << 15)
    keys = ((cells[:, 0] << 40) | (cells[:, 1] << 20) | cells[:, 2]) << 3 | (2 * facing + sense)
    return np.unique(keys)


def pairs_to_compare(footprints: Mapping[str, NDArray[np.int64]]) -> list[tuple[str, str]]:
    """The pairs (earlier scan, later scan) worth comparing, at most four for each scan.

    A scan is paired with the two that share most surface with it, and with up to two that share some and are far from
    it by the pairs chosen so far: those close loops, and two of them bear each other out.

    Args:
        footprints: of all scans by id (:func:`footprint`), in the order in which they were placed.
    """
    chosen: list[tuple[str, str]] = []
    joined: dict[str, set[str]] = {name: set() for name in footprints}

    def choose(earlier: str, later: str) -> None:
        chosen.append((earlier, later))
        joined[earlier].add(later)
        joined[later].add(earlier)

    names = list(footprints)
    for number, later in enumerate(names):
        shared = {name: _share(footprints[name], footprints[later]) for name in names[:number]}
        ranked = sorted((name for name in shared if shared[name] >= _MIN_SHARED), key=lambda name: -shared[name])
        for earlier in ranked[:_BEST]:
            choose(earlier, later)
        near = _near(joined, later)
        for earlier in [name for name in ranked[_BEST:] if name not in near][:_FAR]:
            choose(earlier, later)
    return chosen


def _share(a: NDArray[np.int64], b: NDArray[np.int64]) -> float:
    """Part of the smaller footprint that both have."""
    return len(np.intersect1d(a, b, assume_unique=True)) / max(1, min(len(a), len(b)))


def _near(joined: Mapping[str, set[str]], start: str) -> set[str]:
    """Scans that few pairs lead to from this one."""
    reached = {start}
    for _ in range(_FAR_HOPS - 1):
        reached |= set().union(*(joined[name] for name in reached))
    return reached


# --- comparing two of them ------------------------------------------------------------------------------------------


def compare(target: tuple[str, Surface], source: tuple[str, Surface], target_from_source: Matrix) -> Comparison:
    """Register two scans with each other alone, from where the map has them.

    Args:
        target, source: id and surface of each.
        target_from_source: 4x4, by the map.

    Raises:
        FailureError: ``REG_*`` if the two do not fit, or only in another place than the map's.
    """
    reference = reference_from([(target[1], np.eye(4))])
    found = register(source[1], reference, target_from_source, "pair", starts=(len(LEVELS) - 2,))
    judge(found, (0.0, 0.0), _LIMITS)
    information = _information(source[1], reference, found.map_from_scanner)
    return Comparison(target[0], source[0], found.map_from_scanner, information, found.rmse, found.overlap)


def _information(source: Surface, reference: Reference, pose: Matrix) -> NDArray[np.float64]:
    """Mean over the pairs of J^T J, point to plane, in the source's frame, with the range offset solved for."""
    moved = source.surfels.moved(pose)
    index, partner = reference.pairs(moved, _CLOSE)
    normals = reference.surfels.normals[partner].astype(np.float64)
    gaps = np.einsum("ij,ij->i", moved.points[index] - reference.surfels.points[partner], normals)
    close = np.abs(gaps) < _CLOSE
    index, partner, own = index[close], partner[close], normals[close] @ pose[:3, :3]
    slants = source.surfels.slants[index].astype(np.float64) - reference.surfels.slants[partner]
    jacobian = np.hstack([np.cross(source.surfels.points[index].astype(np.float64), own), own])
    count = max(1, len(index))
    by_offset = jacobian.T @ slants / count
    return jacobian.T @ jacobian / count - np.outer(by_offset, by_offset) / (slants @ slants / count + _OFFSET_DAMPING)


# --- all of them together -------------------------------------------------------------------------------------------


def optimise(poses: Poses, comparisons: Sequence[Comparison]) -> PoseAdjustment:
    """The poses that agree best with all comparisons (Open3D's pose graph, Levenberg-Marquardt with a line process).

    Args:
        poses: as registration has them; the first one is not moved.
        comparisons: of pairs of these scans; a false one among good ones does no harm.

    Returns:
        The new poses, or the old ones with the reason why the new ones are not taken.
    """
    if not comparisons:
        return PoseAdjustment(dict(poses), {}, 0, (), 0.0, 0.0, 0.0)
    moved, kept = _solve(poses, _credible(poses, comparisons))
    furthest = max(transforms.difference(poses[name], moved[name])[0] for name in poses)
    before, after = _disagreement(poses, kept), _disagreement(moved, kept)
    reason = ""
    if furthest > PLAUSIBLE_M:
        reason = f"a scan would move by {furthest:.3f} m, more than a registration can be wrong ({PLAUSIBLE_M} m)"
    elif after > before:
        reason = f"the scans would fit worse than before ({1000 * after:.2f} mm instead of {1000 * before:.2f} mm)"
    result = poses if reason else moved
    return PoseAdjustment(
        poses=dict(result),
        residuals=residuals(result, kept),
        compared=len(comparisons),
        disbelieved=tuple((edge.target, edge.source) for edge in comparisons if edge not in kept),
        rms_before=before,
        rms_after=_disagreement(result, kept),
        moved_m=0.0 if reason else furthest,
        reason=reason,
    )


def _credible(poses: Poses, comparisons: Sequence[Comparison]) -> list[Comparison]:
    """Those that agree with the map, and those that contradict it together with another that wants the same."""
    agreeing = [edge for edge in comparisons if edge.disagreement(poses) <= _UNHEARD_OF]
    contradicting = [edge for edge in comparisons if _UNHEARD_OF < edge.disagreement(poses) < PLAUSIBLE_M]
    return agreeing + [
        edge
        for edge in contradicting
        if any(_bears_out(witness, edge, poses) for witness in contradicting if witness is not edge)
    ]


def _bears_out(witness: Comparison, edge: Comparison, poses: Poses) -> bool:
    """Whether the motion that one comparison wants, of its later scan and what hangs on it, mends the other as well."""
    correction = poses[edge.target] @ edge.target_from_source @ transforms.inverse(poses[edge.source])
    mended = {witness.target: poses[witness.target], witness.source: correction @ poses[witness.source]}
    return witness.disagreement(mended) < _MENDED * witness.disagreement(poses)


def residuals(poses: Poses, comparisons: Sequence[Comparison]) -> dict[str, float]:
    """Root mean square distance, metres, between each scan's surface and that of the scans it was compared with.

    A scan that was compared with none has no entry.
    """
    squares: dict[str, list[tuple[float, float]]] = {}
    for edge in comparisons:
        square = edge.rmse**2 + edge.disagreement(poses) ** 2
        for name in (edge.target, edge.source):
            squares.setdefault(name, []).append((edge.overlap, square))
    return {name: float(np.sqrt(_mean(squares[name]))) for name in poses if name in squares}


def _disagreement(poses: Poses, comparisons: Sequence[Comparison]) -> float:
    return float(np.sqrt(_mean([(edge.weight, edge.disagreement(poses) ** 2) for edge in comparisons])))


def _mean(weighted: Sequence[tuple[float, float]]) -> float:
    return sum(weight * value for weight, value in weighted) / max(sum(weight for weight, _ in weighted), 1e-9)


def _solve(poses: Poses, comparisons: Sequence[Comparison]) -> tuple[dict[str, Matrix], list[Comparison]]:
    """The graph's solution, and the comparisons that the line process still believes."""
    from open3d.pipelines import registration as o3d

    names = list(poses)
    number = {name: index for index, name in enumerate(names)}
    nodes = [poses[name] for name in names]
    edges = [_link(nodes, later) for later in range(1, len(nodes))] + [
        o3d.PoseGraphEdge(
            number[edge.source],
            number[edge.target],
            edge.target_from_source,
            _PER_SQUARE_METRE * edge.weight * edge.information,
            uncertain=True,
        )
        for edge in comparisons
    ]
    for belief in _BELIEF:
        graph = _levenberg_marquardt(nodes, edges, belief)
        nodes = [np.array(node.pose) for node in graph.nodes]
    believed = {(edge.source_node_id, edge.target_node_id) for edge in graph.edges if edge.uncertain}
    kept = [edge for edge in comparisons if (number[edge.source], number[edge.target]) in believed]
    return dict(zip(names, nodes, strict=True)), kept


def _link(nodes: Sequence[Matrix], later: int) -> Any:
    """Each scan hangs on the one before it: the graph must hold together whatever is disbelieved."""
    from open3d.pipelines.registration import PoseGraphEdge

    information = _PER_SQUARE_METRE * _CHAIN_WEIGHT * _CHAIN_INFORMATION
    earlier_from_later = transforms.inverse(nodes[later - 1]) @ nodes[later]
    return PoseGraphEdge(later, later - 1, earlier_from_later, information, uncertain=False)


def _levenberg_marquardt(nodes: Sequence[Matrix], edges: Sequence[Any], belief: float) -> Any:
    """The graph after Open3D's optimisation, without the edges that it pruned."""
    from open3d.pipelines import registration as o3d

    graph = o3d.PoseGraph()
    for pose in nodes:
        graph.nodes.append(o3d.PoseGraphNode(pose))
    for edge in edges:
        graph.edges.append(edge)
    # Open3D takes entry (5, 5) for a number of point pairs and multiplies its mean by the square of this "distance".
    mean = float(np.mean([edge.information[5, 5] for edge in edges]))
    distance = belief * float(np.sqrt(_PER_SQUARE_METRE / mean))
    o3d.global_optimization(
        graph,
        o3d.GlobalOptimizationLevenbergMarquardt(),
        o3d.GlobalOptimizationConvergenceCriteria(),
        o3d.GlobalOptimizationOption(distance, _PRUNED, reference_node=0),
    )
    return graph
