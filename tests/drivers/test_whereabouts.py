"""A simulated base whose process is gone stands where it stood."""

import math
from pathlib import Path

import numpy as np

from drivers.interfaces import DriveGoal
from drivers.simulated.base import SimulatedBase
from drivers.simulated.whereabouts import Whereabouts
from tests.drivers.simulated_rooms import perfect_map, two_rooms


def test_a_base_that_is_made_anew_stands_where_it_stood_and_its_odometry_begins_anew(tmp_path: Path) -> None:
    world = two_rooms()
    x, y, _ = world.start
    first = SimulatedBase(world, whereabouts=Whereabouts(tmp_path))
    first.permit(math.inf)
    first.start_drive(DriveGoal("G1", perfect_map(world), "M", first.stance().map_from_base, x + 1.0, y))
    for _ in range(60):
        first.step(0.05)
    second = SimulatedBase(world, whereabouts=Whereabouts(tmp_path))
    assert np.hypot(*(first.stance().map_from_base[:2, 3] - (x, y))) > 0.3
    assert np.allclose(second.stance().map_from_base, first.stance().map_from_base)
    assert np.allclose(second.telemetry().odom_from_base, np.eye(4))


def test_a_base_that_was_never_there_stands_at_the_start(tmp_path: Path) -> None:
    world = two_rooms()
    assert Whereabouts(tmp_path).read() is None
    base = SimulatedBase(world, whereabouts=Whereabouts(tmp_path))
    assert np.allclose(base.stance().map_from_base, SimulatedBase(world).stance().map_from_base)
