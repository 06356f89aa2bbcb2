"""How wide a gap is, with and without a leaf in it."""

import numpy as np
import pytest

from perception.passage import passage


def _line(start: tuple[float, float], end: tuple[float, float]) -> np.ndarray:
    """Dense points (u, d) between two places, each several times over as many heights give them."""
    points = np.linspace(start, end, 200)
    return np.repeat(points, 5, axis=0)


def test_an_empty_opening_is_as_wide_as_between_its_jambs() -> None:
    found = passage(np.empty((0, 2)), 0.0, 0.9, 0.15)
    assert found.clearance == pytest.approx(0.9, abs=0.04)
    assert found.centre == pytest.approx(0.45, abs=0.03)


def test_a_leaf_at_right_angles_beside_the_jamb_takes_its_thickness() -> None:
    leaf = _line((0.04, 0.15), (0.04, 1.0))
    assert 0.8 < passage(leaf, 0.0, 0.9, 0.15).clearance <= 0.9


@pytest.mark.parametrize(("angle_deg", "expected"), [(30.0, 0.6), (45.0, 0.85), (60.0, 1.04)])
def test_a_half_open_leaf_leaves_what_a_disc_finds_between_it_and_the_far_jamb(
    angle_deg: float, expected: float
) -> None:
    angle = np.deg2rad(angle_deg)
    leaf = _line((0.0, 0.0), (1.2 * np.cos(angle), 1.2 * np.sin(angle)))
    assert passage(leaf, 0.0, 1.2, 0.02).clearance == pytest.approx(expected, abs=0.08)


def test_a_shut_leaf_leaves_nothing() -> None:
    assert passage(_line((0.0, 0.05), (0.9, 0.05)), 0.0, 0.9, 0.15).clearance == 0.0


def test_single_stray_points_are_no_obstacle() -> None:
    stray = np.array([[0.3, 0.4], [0.6, -0.2], [0.45, 0.1]])
    assert passage(stray, 0.0, 0.9, 0.15).clearance == pytest.approx(0.9, abs=0.04)
