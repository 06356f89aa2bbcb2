"""Where a cloud was taken from when it does not say: scans, merged clouds, and clouds that no scanner took."""

from functools import cache

import numpy as np
import pytest

from perception import transforms
from perception.failure import FailureError
from perception.intake.stations import find_stations, seen_from, taken_from_origin
from perception.scan import BeamPattern
from tests.synthetic import Scene, box

TRIPOD = BeamPattern.with_step(np.deg2rad(0.45), (np.deg2rad(-60), np.deg2rad(85)), (0.3, 60.0))
TABLE, PILLAR = box((3.0, 1.0, 0.0), (4.0, 2.0, 0.8)), box((1.6, 3.2, 0.0), (2.0, 3.6, 3.0))
PLACES = np.array([[2.0, 1.5, 1.6], [6.0, 3.5, 1.6]])


@cache
def hall() -> Scene:
    walls = (
        ((-0.2, -0.2, 0), (0, 5.2, 3)), ((8, -0.2, 0), (8.2, 5.2, 3)), ((0, -0.2, 0), (8, 0, 3)),
        ((0, 5, 0), (8, 5.2, 3)), ((-0.2, -0.2, -0.2), (8.2, 5.2, 0)), ((-0.2, -0.2, 3), (8.2, 5.2, 3.2)),
    )  # fmt: skip
    return Scene(*(box(*corners) for corners in walls), TABLE, PILLAR)


@cache
def two_stations() -> np.ndarray:
    return merged(PLACES)


def merged(places: np.ndarray) -> np.ndarray:
    poses = [transforms.from_euler(0, 0, 0.4 * n, place) for n, place in enumerate(places)]
    return np.concatenate(
        [transforms.apply(pose, hall().take(pose, TRIPOD, seed=n).points) for n, pose in enumerate(poses)]
    )


@pytest.mark.parametrize("place", PLACES)
def test_a_scan_was_taken_from_its_origin(place: np.ndarray) -> None:
    assert taken_from_origin(hall().take(transforms.from_euler(0.03, 0.02, 1.0, place), TRIPOD).points)


def test_a_merged_cloud_was_not_nor_was_one_far_from_its_origin() -> None:
    cloud = two_stations()
    assert not taken_from_origin(cloud)
    assert not taken_from_origin(cloud + np.array([3e6, 5e6, 100.0]))
    assert not taken_from_origin(
        hall().take(transforms.from_euler(0, 0, 0, PLACES[0]), TRIPOD).points + np.array([30.0, 0, 0])
    )


def test_the_stations_of_a_merged_cloud_show_in_its_floor() -> None:
    found = find_stations(two_stations())
    assert len(found) == 2
    for place in PLACES:
        nearest = found[np.argmin(np.linalg.norm(found - place, axis=1))]
        assert np.hypot(*(nearest - place)[:2]) < 0.04
        assert abs(nearest[2] - place[2]) < 0.10


def test_a_pillar_and_a_table_are_no_stations() -> None:
    # The floor is seen all around both of them.
    places = np.array([[1.8, 1.8, 1.6], [4.8, 3.6, 1.6], [5.5, 1.5, 1.6]])
    found = find_stations(merged(places))
    assert np.linalg.norm(found[:, None, :2] - places[None, :, :2], axis=2).min(axis=1).max() < 0.05


def test_from_a_station_nothing_is_seen_that_something_else_hides() -> None:
    cloud = two_stations()
    seen = seen_from(cloud, PLACES[0]) + PLACES[0]

    def on_the_far_side_of_the_table(points: np.ndarray) -> int:
        x, y, z = points.T
        return int(np.count_nonzero((np.abs(x - 4.0) < 0.03) & (np.abs(y - 1.5) < 0.4) & (z > 0.05) & (z < 0.4)))

    # The other scanner saw it.
    assert on_the_far_side_of_the_table(cloud) > 100
    assert on_the_far_side_of_the_table(seen) < 0.05 * on_the_far_side_of_the_table(cloud)
    own = hall().take(transforms.from_euler(0, 0, 0, PLACES[0]), TRIPOD)
    assert len(seen) > 0.95 * len(own.points)


def test_a_cloud_without_any_blind_disc_is_refused() -> None:
    rng = np.random.default_rng(0)
    floor = np.column_stack([rng.uniform(0, 8, (40_000, 2)), rng.normal(0, 0.003, 40_000)])
    with pytest.raises(FailureError, match="ORIGIN_UNKNOWN"):
        find_stations(floor)
