"""Points beyond the walls: through a door they count, through a window and in a mirror they do not."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perception.findings import Door
from perception.rays.sightlines import believable

ROOM = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 3.0], [0.0, 3.0]])
STATION = (1.0, 1.5, 1.3)


def beams_through(x: float, y: tuple[float, float], z: tuple[float, float], reach: float = 3.0) -> np.ndarray:
    """Points behind the plane at ``x``, seen through a rectangle in it."""
    grid = np.stack(np.meshgrid(np.linspace(*y, 30), np.linspace(*z, 40)), axis=-1).reshape(-1, 2)
    crossing = np.column_stack([np.full(len(grid), x), grid])
    return np.asarray(STATION) + (crossing - STATION) * (1 + reach / (x - STATION[0]))


def test_points_in_the_room_are_kept() -> None:
    points = np.random.default_rng(0).uniform((0, 0, 0), (4, 3, 2.5), (500, 3))
    assert believable(points, STATION, ROOM).all()


def test_points_through_a_door_are_kept() -> None:
    assert believable(beams_through(4.0, (1.0, 1.9), (0.02, 2.0)), STATION, ROOM).all()


@pytest.mark.parametrize("sill", [0.4, 0.9])
def test_points_through_a_window_or_in_a_mirror_are_not(sill: float) -> None:
    assert not believable(beams_through(4.0, (1.0, 1.9), (sill, 2.0)), STATION, ROOM).any()


def test_a_mirror_beside_a_door_does_not_profit_from_it() -> None:
    door, mirror = beams_through(4.0, (0.3, 1.1), (0.02, 2.0)), beams_through(4.0, (1.6, 2.4), (0.4, 2.0))
    kept = believable(np.concatenate([door, mirror]), STATION, ROOM)
    assert kept[: len(door)].all()
    assert not kept[len(door) :].any()


def test_wall_points_a_little_behind_the_contour_are_kept() -> None:
    wall = beams_through(4.0, (0.5, 2.5), (0.5, 2.0), reach=0.05)
    assert believable(wall, STATION, ROOM).all()


def test_a_station_in_the_doorway_keeps_the_room_behind_it() -> None:
    behind = np.random.default_rng(1).uniform((-3, 0, 0), (-0.3, 3, 2.5), (200, 3))
    assert believable(behind, (-0.07, 1.5, 1.3), ROOM).all()


def test_a_station_just_inside_the_doorway_keeps_what_is_right_before_it() -> None:
    behind = np.random.default_rng(1).uniform((-3, 1.2, 0), (-0.3, 1.8, 2.5), (200, 3))
    assert believable(behind, (0.05, 1.5, 1.3), ROOM).all()


def test_a_known_door_is_a_passage_even_where_nobody_sees_its_threshold() -> None:
    above_the_blind_cone = beams_through(4.0, (1.0, 1.9), (0.6, 2.0))
    door = Door(4.0, 1.45, (1.0, 0.0), 0.9, 0.9, 2.05, 1.0)
    assert not believable(above_the_blind_cone, STATION, ROOM).any()
    assert believable(above_the_blind_cone, STATION, ROOM, [door]).all()


def exits_of(point: np.ndarray, contour: np.ndarray) -> tuple[int, float]:
    """Slot and share of the way of the last side that a line of sight crosses outwards, side by side."""
    slot, share, first = -1, -1.0, 0
    for start, end in zip(contour, np.roll(contour, -1, axis=0), strict=True):
        side, sight = end - start, point[:2] - STATION[:2]
        across = sight[0] * side[1] - sight[1] * side[0]
        if across > 0:
            way, along = np.linalg.solve(np.column_stack([sight, -side]), start - STATION[:2])
            if max(share, 0.0) < way < 1 and 0 <= along <= 1:
                slot, share = first + int(along * np.hypot(*side) / 0.10), way
        first += int(np.hypot(*side) / 0.10) + 1
    return slot, share


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 9999))
def test_what_is_believed_is_what_the_definition_says_point_by_point(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angles = np.sort(rng.uniform(0, 2 * np.pi, 9))
    if np.diff(angles, append=angles[0] + 2 * np.pi).max() > 2.8:
        return
    contour = STATION[:2] + rng.uniform(1.0, 4.0, 9)[:, None] * np.column_stack([np.cos(angles), np.sin(angles)])
    points = rng.uniform((-5, -5, -0.3), (7, 7, 2.0), (150, 3))
    found = [exits_of(point, contour) for point in points]
    slot, share = np.array([s for s, _ in found]), np.array([w for _, w in found])
    reach = np.hypot(*(points[:, :2] - STATION[:2]).T)
    outside = (slot >= 0) & ((1 - share) * reach > 0.12)
    exit_z = STATION[2] + share * (points[:, 2] - STATION[2])
    total = sum(int(np.hypot(*side) / 0.10) + 1 for side in np.roll(contour, -1, axis=0) - contour)
    passages = np.bincount(slot[outside & (exit_z < 0.15)], minlength=total) >= 3
    passages |= np.roll(passages, 1) | np.roll(passages, -1)
    expected = ~outside | passages[slot] | (share * reach < 0.6)
    assert np.array_equal(believable(points, STATION, contour), expected)
