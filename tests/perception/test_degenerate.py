"""Places where a scan fits in more than one way; the full table is ``python -m benchmarks.degenerate``."""

import pytest

from benchmarks.degenerate import outcome


@pytest.mark.parametrize(
    ("kind", "seed"), [("40 m corridor", 1), ("round stairwell", 1), ("corridor with pilasters", 4)]
)
def test_what_fits_in_more_than_one_way_is_refused(kind, seed):
    """Each of these was accepted in a wrong place by a plain ICP with its residual alone."""
    assert outcome(kind, seed).verdict in ("REG_DEGENERATE", "REG_AMBIGUOUS")


@pytest.mark.parametrize(
    ("kind", "seed"),
    [("square room", 0), ("square room", 3), ("glass on two sides", 1), ("corridor with pilasters", 2)],
)
def test_what_odometry_can_tell_apart_is_placed_right(kind, seed):
    assert outcome(kind, seed).verdict == "right"
