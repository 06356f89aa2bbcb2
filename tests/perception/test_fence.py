"""The operator's fence: what is one, where it lies in the map, and that no way leads across."""

import numpy as np
import pytest
from scipy import ndimage

from perception import fence, robot_map, transforms
from perception.grids import Cell, Grid

YARD = ((-2.0, -1.5), (4.0, -1.5), (5.0, 2.0), (-2.0, 2.5))


@pytest.mark.parametrize(
    ("vertices", "why"),
    [
        (((0.0, 0.0), (1.0, 0.0)), "at least 3"),
        (((-1.0, -1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, 1.0)), "crosses"),
        (((-1.0, 0.0), (1.0, 0.0), (2.0, 0.0)), "crosses"),
        (((1.0, 1.0), (2.0, 1.0), (2.0, 2.0)), "start"),
    ],
    ids=["a line", "a bow tie", "flat", "elsewhere"],
)
def test_what_is_no_fence_is_refused(vertices, why):
    with pytest.raises(ValueError, match=why):
        fence.check(vertices)


def test_it_lies_as_the_robot_stood_at_the_start():
    fence.check(YARD)
    placed = fence.in_map(((1.0, 0.0), (0.0, 1.0), (-1.0, -1.0)), transforms.planar(5.0, 3.0, np.pi / 2))
    assert placed == pytest.approx(np.array([[5.0, 4.0], [4.0, 3.0], [6.0, 2.0]]))


@pytest.mark.parametrize("yaw", np.linspace(0.0, 3.0, 7))
def test_no_way_leads_across(yaw):
    """Also where it runs aslant, and where it leaves the map."""
    place = transforms.planar(0.3, -0.2, yaw)
    floor = Grid(np.full((160, 200), Cell.FREE, np.uint8), (-4.0, -4.0), 0.05)
    fenced = robot_map.fenced(floor, fence.in_map(YARD, place))
    regions, _ = ndimage.label(fenced.data == Cell.FREE, np.ones((3, 3)))
    row, column = fenced.cells_of(place[:2, 3])
    centres = fenced.centres_of(np.argwhere(regions == regions[row, column]))
    seen = transforms.apply(transforms.inverse(place), np.column_stack([centres, np.zeros(len(centres))]))
    assert seen[:, 0].min() > -2.0 and seen[:, 0].max() < 5.0
    assert seen[:, 1].min() > -1.5 and seen[:, 1].max() < 2.5
    assert len(centres) * 0.05**2 > 0.7 * 20.0, "the yard itself stays free"
    assert (floor.data == Cell.FREE).all(), "the map that was given is left alone"
