"""Which scans shape a room when there are many."""

import numpy as np
import shapely

from mission.stages.selection import of_room
from perception import transforms

CORRIDOR = shapely.box(0, 0, 40, 2)


def scans_at(*places):
    return [(f"S{n:02d}", transforms.planar(x, y, 0.0).tolist()) for n, (x, y) in enumerate(places)]


def names(scans):
    return [name for name, _ in scans]


def test_few_scans_are_all_taken():
    scans = scans_at(*[(x, 1) for x in range(5)])
    assert of_room(scans, CORRIDOR, enough=5) == scans


def test_of_many_in_a_room_those_are_taken_that_are_spread_over_it_with_the_newest():
    scans = scans_at(*[(x, 1) for x in np.linspace(0, 40, 30)], (20.0, 1.0))
    chosen = of_room(scans, CORRIDOR, most=6)
    x = np.sort([pose[0][3] for _, pose in chosen])
    assert names(chosen) == sorted(names(chosen)) and names(chosen)[-1] == "S30"
    assert x[0] == 0 and x[-1] == 40 and np.diff(x).max() < 12


def test_scans_of_the_room_come_before_those_of_its_neighbours_and_near_ones_before_far_ones():
    far, near, own = [(x, 30) for x in range(5)], [(x, 6) for x in range(5)], [(10.0 * n, 1) for n in range(4)]
    scans = scans_at(*far, *near, *own)
    chosen = of_room(scans, CORRIDOR, enough=6)
    assert len(chosen) == 6 and set(names(chosen)) > {"S10", "S11", "S12", "S13"}
    assert all(pose[1][3] < 10 for _, pose in chosen)
    assert names(of_room(scans, CORRIDOR, enough=4)) == ["S10", "S11", "S12", "S13"]


def test_before_a_room_has_a_contour_the_scans_nearest_to_its_seed_are_taken():
    scans = scans_at(*[(x, 0) for x in range(20)], (3.0, 0.5))
    chosen = of_room(scans, shapely.Point(3.0, 1.0), enough=4)
    assert all(abs(pose[0][3] - 3.0) <= 2.0 for _, pose in chosen)
