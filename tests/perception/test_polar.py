"""Cells crossed near a plane, against the definition for each cell in plain words."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from perception.grids import Grid
from perception.rays.polar import crossed_between

BIN, STEP, REACH = 0.025, np.deg2rad(2.0), 6.0


def oracle(hits, station, frame, height, clearance):
    """For each cell the hits of its direction right before and behind it, by search."""
    directions = int(np.ceil(2 * np.pi / STEP))

    def polar(xy):
        offset = xy - station
        turn = np.arctan2(offset[:, 1], offset[:, 0]) / (2 * np.pi) % 1.0
        distance = np.hypot(*offset.T)
        return np.minimum((turn * directions).astype(int), directions - 1), (distance / BIN).astype(int), distance

    direction, distance, true = polar(hits)
    image = np.zeros(frame.shape, bool)
    cells = np.argwhere(~image)
    for cell, at, bin_, away in zip(cells, *polar(frame.centres_of(cells)), strict=True):
        same = distance[(direction == at) & (true < REACH)]
        before, after = same[same <= bin_], same[same >= bin_]
        if away < REACH and len(before) and len(after):
            gap = after.min() - before.max()
            image[tuple(cell)] = gap * height <= clearance * max(after.min(), 1)
    return image


@settings(max_examples=25, deadline=None)
@given(st.integers(0, 9999), st.integers(0, 400), st.floats(0.5, 2.0), st.floats(0.05, 0.5))
def test_a_cell_is_crossed_if_the_beam_to_the_hit_behind_it_was_low_at_the_hit_before(seed, count, height, clearance):
    rng = np.random.default_rng(seed)
    station = rng.uniform(-1, 1, 2)
    hits = rng.uniform(-5, 7, (count, 2))
    frame = Grid(np.zeros((40, 50), bool), (-4.0, -3.0), 0.2)
    found = crossed_between(hits, station, frame, height, clearance, STEP, REACH)
    assert np.array_equal(found, oracle(hits, station, frame, height, clearance))
