import subprocess
import sys

import pytest
from hypothesis import given
from hypothesis import strategies as st

from perception.failure import FailureError
from perception.findings import LabelCounts
from perception.stopping import StopThresholds, assess, growing_rate, occluded_decrease_rate

COUNT = st.integers(0, 300_000)


@st.composite
def cycles(draw):
    """Two cycles of one room: V may grow, and nothing that was seen is forgotten."""
    before = LabelCounts(draw(COUNT), draw(COUNT), draw(COUNT))
    growth = draw(st.integers(0, 50_000))
    resolved = draw(st.integers(0, before.occluded + growth))
    occupied = draw(st.integers(0, resolved))
    after = LabelCounts(
        before.occupied + occupied, before.empty + resolved - occupied, before.occluded + growth - resolved
    )
    return before, after, resolved


@given(cycles())
def test_mu_never_exceeds_lambda_and_neither_is_negative(pair):
    before, after, _ = pair
    rate, decrease = growing_rate(before, after), occluded_decrease_rate(before, after)
    assert 0 <= decrease <= rate + 1e-12
    assert rate <= 1


@given(cycles())
def test_both_rates_count_the_voxels_that_the_cycle_resolved(pair):
    before, after, resolved = pair
    assert growing_rate(before, after) * after.seen == pytest.approx(resolved)
    assert occluded_decrease_rate(before, after) * after.total == pytest.approx(resolved)


def test_rates_of_the_papers_first_room():
    # Table 1, room 1: V = 211,200, V_s = 185,927, lambda = 0.039, mu = 0.034.
    resolved = round(0.039 * 185_927)
    after = LabelCounts(40_000, 145_927, 211_200 - 185_927)
    before = LabelCounts(40_000, 145_927 - resolved, 211_200 - 185_927 + resolved)
    assert growing_rate(before, after) == pytest.approx(0.039, abs=1e-5)
    assert occluded_decrease_rate(before, after) == pytest.approx(0.0343, abs=1e-4)


def test_first_cycle_is_all_new():
    counts = LabelCounts(10, 30, 60)
    assert growing_rate(None, counts) == 1.0
    assert occluded_decrease_rate(None, counts) == pytest.approx(0.4)


def test_growth_of_the_space_alone_is_no_progress():
    before, after = LabelCounts(10, 30, 60), LabelCounts(10, 30, 160)
    assert growing_rate(before, after) == 0.0
    assert occluded_decrease_rate(before, after) == 0.0


def test_a_space_that_shrank_is_refused():
    with pytest.raises(FailureError, match="STOP_SPACE_SHRANK"):
        occluded_decrease_rate(LabelCounts(10, 30, 60), LabelCounts(10, 30, 50))


BEGUN = LabelCounts(200, 600, 200)
STALLED = LabelCounts(205, 615, 180)


@pytest.mark.parametrize(
    ("history", "gain", "reason"),
    [
        ([BEGUN], 150, ""),
        ([BEGUN], None, "no_candidate"),
        ([BEGUN], 5, "predicted_gain"),
        ([BEGUN, STALLED], 150, "lambda_mu"),
        ([BEGUN, STALLED], None, "lambda_mu"),
        ([LabelCounts(100, 300, 600), BEGUN], 150, ""),
        ([LabelCounts(100, 300, 600)] * 11 + [BEGUN], 150, "max_scans"),
        ([LabelCounts(0, 0, 1000)], 150, ""),
    ],
)
def test_reason_of_the_decision(history, gain, reason):
    decision = assess(history, gain)
    assert (decision.stop, decision.reason) == (bool(reason), reason)


def test_predicted_rate_is_the_gain_over_the_seen_voxels():
    assert assess([BEGUN], 80).predicted_rate == pytest.approx(0.1)
    assert assess([BEGUN], None).predicted_rate is None


def test_each_rule_can_be_switched_off():
    off = StopThresholds(growing_rate=0, occluded_decrease_rate=0, predicted_rate=0)
    assert not assess([BEGUN, BEGUN], 0, off).stop


def test_both_criteria_are_needed_for_the_papers_rule():
    strict = StopThresholds(occluded_decrease_rate=0.001, predicted_rate=0)
    assert not assess([BEGUN, STALLED], 150, strict).stop


def test_the_tree_can_import_it_without_the_heavy_libraries():
    code = (
        "import sys, perception.stopping; print([m for m in ('open3d', 'numba', 'cv2', 'scipy') if m in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.strip()
    assert found == "[]"
