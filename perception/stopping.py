"""When a room is finished (paper section 5, Eq. 3 and 4), and a rule that knows it before the last scan is wasted.

Definitions. V(t) and V_s(t) of Eq. (3) are one series: the seen voxels, occupied + empty, after cycle t (Table 1 has
V_s = O + E in every room). V of Eq. (4) is the size of the voxel space after cycle t, seen or not.

- First cycle: nothing was known before, V_s(0) = 0 and O_c(0) = V, so lambda = 1 and mu = V_s / V.
- V grows between cycles (a scan showed more of the contour): the new voxels had not been seen before either, so they
  count as occluded in the cycle before. Growth alone is thus no progress, and mu never turns negative by it.

With this mu = lambda * V_s / V <= lambda: the second criterion binds only where its threshold is the lower one.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from perception.failure import FailureError
from perception.findings import LabelCounts

LAMBDA_MU = "lambda_mu"
PREDICTED_GAIN = "predicted_gain"
NO_CANDIDATE = "no_candidate"
MAX_SCANS = "max_scans"


@dataclass(frozen=True)
class StopThresholds:
    """When to stop.

    Args:
        growing_rate, occluded_decrease_rate: lambda and mu must both fall below these (the paper's 0.04 and 0.05);
            0 switches the rule off.
        predicted_rate: the best view's predicted gain over V_s must fall below this; 0 switches the rule off.
        max_scans: no more scans than this in one room.
    """

    growing_rate: float = 0.04
    occluded_decrease_rate: float = 0.05
    predicted_rate: float = 0.012
    max_scans: int = 12


@dataclass(frozen=True)
class StopDecision:
    """Whether the room is finished, why, and the figures it was decided by.

    Args:
        reason: ``lambda_mu``, ``no_candidate``, ``predicted_gain``, ``max_scans``, or empty to go on.
        growing_rate, occluded_decrease_rate: lambda and mu of the last cycle.
        predicted_rate: predicted gain of the best view over V_s, None without a candidate.
    """

    stop: bool
    reason: str
    growing_rate: float
    occluded_decrease_rate: float
    predicted_rate: float | None


def growing_rate(previous: LabelCounts | None, current: LabelCounts) -> float:
    """lambda, Eq. (3): share of the seen voxels that are new in this cycle; 1 in the first cycle."""
    if previous is None:
        return 1.0
    return (current.seen - previous.seen) / current.seen if current.seen else 0.0


def occluded_decrease_rate(previous: LabelCounts | None, current: LabelCounts) -> float:
    """mu, Eq. (4): occluded voxels that this cycle resolved, over the size V of the space.

    Raises:
        FailureError: ``STOP_SPACE_SHRANK`` if V is smaller than before, which makes the two cycles incomparable.
    """
    if current.total == 0:
        return 0.0
    if previous is None:
        return current.seen / current.total
    growth = current.total - previous.total
    if growth < 0:
        raise FailureError("STOP_SPACE_SHRANK", f"the voxel space lost {-growth} voxels", previous=previous.total)
    return (previous.occluded + growth - current.occluded) / current.total


def assess(
    history: Sequence[LabelCounts], predicted_gain: int | None, thresholds: StopThresholds = StopThresholds()
) -> StopDecision:
    """Decide after a cycle whether the room is finished.

    Args:
        history: the counts after each cycle so far, oldest first, at least one.
        predicted_gain: voxels that the next best view would show, None if no position meets the requirements.

    The rules in their order: lambda and mu below their thresholds (the paper's; never in the first cycle, where
    lambda is 1); no candidate; the best view predicts too little, which saves the scan that would only confirm the
    end; too many scans.
    """
    current = history[-1]
    previous = history[-2] if len(history) > 1 else None
    growing, decrease = growing_rate(previous, current), occluded_decrease_rate(previous, current)
    predicted = None if predicted_gain is None else predicted_gain / max(current.seen, 1)
    if growing < thresholds.growing_rate and decrease < thresholds.occluded_decrease_rate:
        reason = LAMBDA_MU
    elif predicted is None:
        reason = NO_CANDIDATE
    elif predicted < thresholds.predicted_rate:
        reason = PREDICTED_GAIN
    elif len(history) >= thresholds.max_scans:
        reason = MAX_SCANS
    else:
        reason = ""
    return StopDecision(bool(reason), reason, growing, decrease, predicted)
