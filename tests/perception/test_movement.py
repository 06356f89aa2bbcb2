"""People in a scan: found by an earlier scan that had seen through where they stand, and nothing else taken for one."""

import numpy as np
import pytest

from drivers.simulated.bodies import SHAPES, Body
from drivers.simulated.profile import SCANNERS
from drivers.simulated.scanner import SimulatedScanner
from drivers.simulated.world import Surface as Kind
from perception import transforms
from perception.findings import Movement, RoomShape
from perception.matching.surfels import surface_of
from perception.movement import find_movement
from tests.drivers.simulated_rooms import shell, world_of

STEP = float(np.deg2rad(0.4))
ROOM = RoomShape(np.array([[0.0, 0.0], [10.0, 0.0], [10.0, 8.0], [0.0, 8.0]]), 0.0, 3.0, np.empty((0, 4)))
FURNISHED = [*shell(0.0, 0.0, 10.0, 8.0), ((4.0, 3.4, 0.0), (5.2, 4.2, 0.75), Kind.FURNITURE)]
FIRST, SECOND = (2.0, 2.0, 0.3), (7.0, 5.0, 1.0)


def scan(place, bodies=(), pose_error=(0.0, 0.0, 0.0), seed=0):
    """Points and the pose that registration gives them, which may be a little off."""
    scanner = SimulatedScanner(world_of(FURNISHED), SCANNERS["vz-400"], seed)
    at = transforms.planar(*place)
    taken = scanner.cast(at, STEP, f"S{seed}", np.eye(4), (0.0, 0.0), bodies)
    return taken.points, transforms.planar(*pose_error) @ scanner.map_from_scanner(at)


def person(x, y):
    shape = SHAPES["person"]
    return Body(x, y, 0.0, shape.length, shape.width, shape.height, shape.round)


def movement(bodies=(), earlier=(), **options) -> Movement:
    """In the second scan, with the given bodies in it, the earlier ones in the first."""
    points, pose = scan(FIRST, earlier)
    return find_movement(*scan(SECOND, bodies, seed=1, **options), [(surface_of(points), pose)], ROOM)


@pytest.mark.parametrize(
    "pose_error", [(0.0, 0.0, 0.0), (0.03, -0.03, 0.0), (0.0, 0.0, 0.005)], ids=["exact", "4 cm", "0.3 degrees"]
)
def test_an_empty_room_is_empty_however_it_is_furnished(pose_error):
    assert movement(pose_error=pose_error).share < 0.001


@pytest.mark.parametrize(("x", "y", "least"), [(5.2, 5.6, 0.01), (7.5, 2.8, 0.01), (3.0, 5.5, 0.003)])
def test_a_person_is_found_and_where(x, y, least):
    found = movement([person(x, y)])
    assert found.share > least
    assert found.place == pytest.approx((x, y), abs=0.4)


def test_somebody_who_stood_there_all_the_time_is_furniture():
    """Nothing tells: no scan ever saw through."""
    standing = [person(5.2, 5.6)]
    assert movement(standing, earlier=standing).share < 0.001


def test_somebody_who_came_and_stays_is_new_once():
    """The second scan is the one to be taken again; to a third one they were there before."""
    staying = [person(5.2, 5.6)]
    earlier = [(surface_of(points), pose) for points, pose in (scan(FIRST), scan(SECOND, staying, seed=1))]
    third = scan((3.0, 6.5, 0.0), staying, seed=2)
    assert find_movement(*third, earlier[:1], ROOM).share > 0.01
    assert find_movement(*third, earlier, ROOM).share < 0.002


def test_what_is_outside_the_room_or_at_its_walls_does_not_count():
    points, pose = scan(FIRST)
    small = RoomShape(ROOM.contour * 0.5, 0.0, 3.0, ROOM.walls)
    taken = scan(SECOND, [person(7.5, 2.8)], seed=1)
    assert find_movement(*taken, [(surface_of(points), pose)], small).share == 0.0


def test_a_station_outside_the_room_says_nothing():
    points, pose = scan(FIRST)
    right = RoomShape(np.array([[3.0, 0.0], [10.0, 0.0], [10.0, 8.0], [3.0, 8.0]]), 0.0, 3.0, ROOM.walls)
    taken = scan(SECOND, [person(7.5, 2.8)], seed=1)
    assert find_movement(*taken, [(surface_of(points), pose)], right) == Movement(0.0, None)


def test_without_an_earlier_scan_nothing_has_moved():
    assert find_movement(*scan(SECOND, [person(7.5, 2.8)]), [], ROOM) == Movement(0.0, None)
