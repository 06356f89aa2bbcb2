"""Open sides of a contour: where sight ended, not the room."""

import numpy as np
import pytest
import shapely

from perception.findings import RoomShape
from perception.outline.frontier import DEPTH, open_sides, seen_and_beyond
from perception.voxels import room_space

CORNERS = np.array([[0.0, 0.0], [6.0, 0.0], [6.0, 2.0], [0.0, 2.0]])
SIDES = np.hstack([CORNERS, np.roll(CORNERS, -1, axis=0)])


def corridor(walls: np.ndarray) -> RoomShape:
    return RoomShape(CORNERS, 0.0, 3.0, walls)


def test_a_room_of_four_walls_is_closed() -> None:
    assert len(open_sides(corridor(SIDES))) == 0
    assert seen_and_beyond(corridor(SIDES)).area == pytest.approx(12.0)


def test_a_corridor_goes_on_behind_the_end_that_nobody_saw() -> None:
    shape = corridor(np.delete(SIDES, 1, axis=0))
    assert open_sides(shape) == pytest.approx(SIDES[1:2])
    beyond = seen_and_beyond(shape)
    assert beyond.bounds == pytest.approx((0.0, 0.0, 6.0 + DEPTH, 2.0))
    assert beyond.contains(shapely.Point(6.0 + DEPTH - 0.1, 1.0))


def test_a_wall_that_covers_most_of_a_side_closes_it() -> None:
    almost, half = SIDES.copy(), SIDES.copy()
    almost[1, 3], half[1, 3] = 1.5, 1.0
    assert len(open_sides(corridor(almost))) == 0
    assert open_sides(corridor(half)) == pytest.approx(SIDES[1:2])


def test_what_lies_beyond_is_occluded_space_of_the_room() -> None:
    closed, opened = (room_space(corridor(walls)) for walls in (SIDES, np.delete(SIDES, 1, axis=0)))
    assert np.count_nonzero(opened.labels) - np.count_nonzero(closed.labels) == pytest.approx(
        DEPTH * 2.0 * 3.0 * 1000, rel=0.2
    )
