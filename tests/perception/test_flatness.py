"""Normals of a floor with bars on it, against the plan and against a plain eigenvector per cell."""

import numpy as np
import pytest

from perception.flatness import CELL, flatness_map
from perception.grids import Cell

STATION = (0.0, 0.0, 1.3)


def _scanned_floor(step_deg=0.2, noise=0.003, bias=0.0, half_side=6.0, bars=(), seed=0):
    """Floor points as a scanner at STATION sees them, with bars (x0, y0, x1, y1, height) that raise what they cover."""
    rng = np.random.default_rng(seed)
    elevation, azimuth = np.meshgrid(
        np.deg2rad(np.arange(-40, -8, step_deg)), np.deg2rad(np.arange(0, 360, step_deg)), indexing="ij"
    )
    direction = np.stack(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)], axis=-1
    ).reshape(-1, 3)
    distance = -STATION[2] / direction[:, 2]
    for x0, y0, x1, y1, height in bars:
        top = (height - STATION[2]) / direction[:, 2]
        at = direction[:, :2] * top[:, None]
        over = (at[:, 0] > x0) & (at[:, 0] < x1) & (at[:, 1] > y0) & (at[:, 1] < y1)
        distance = np.where(over, np.minimum(distance, top), distance)
    measured = distance + bias + rng.normal(0, noise, len(distance))
    points = direction * measured[:, None] + STATION
    return points[np.abs(points[:, :2]).max(axis=1) < half_side]


def _states(flatness, x, y):
    cells = flatness.cells.cells_of(np.stack(np.broadcast_arrays(x, y), axis=-1))
    return flatness.cells.data[cells[..., 0], cells[..., 1]]


@pytest.mark.parametrize("bias", [0.0, 0.005])
@pytest.mark.parametrize("step_deg", [0.2, 0.5])
def test_range_noise_makes_no_obstacle_on_a_flat_floor(step_deg, bias):
    found = flatness_map(_scanned_floor(step_deg, bias=bias), station=STATION)
    assert np.count_nonzero(found.cells.data == Cell.OBSTACLE) == 0
    rows, columns = np.indices(found.cells.shape)
    distance = np.hypot(*np.moveaxis(found.cells.centres_of(np.stack([rows, columns], axis=-1)), -1, 0))
    told = found.cells.data[(distance > 1.7) & (distance < (3.5 if step_deg == 0.2 else 2.0))] == Cell.FREE
    assert np.mean(told) > 0.9


@pytest.mark.parametrize("height", [0.02, 0.03])
@pytest.mark.parametrize("offset", [0.0, 0.03, 0.06])
def test_small_bars_become_obstacles_wherever_the_cells_lie(height, offset):
    bar = (2.0 + offset, -0.6, 2.05 + offset, 0.6, height)
    found = flatness_map(_scanned_floor(bars=[bar]), station=STATION)
    along = np.arange(-0.55, 0.56, 0.1)
    across = np.array([bar[0] - 0.1, bar[0] + 0.025, bar[2] + 0.1])[:, None]
    assert np.mean((_states(found, across, along) == Cell.OBSTACLE).any(axis=0)) > 0.9
    obstacles = found.cells.centres_of(np.argwhere(found.cells.data == Cell.OBSTACLE))
    assert np.all(np.abs(obstacles[:, 0] - bar[0] - 0.025) < 0.2)


def test_a_gentle_slope_is_flat():
    points = _scanned_floor()
    points[:, 2] += 0.03 * points[:, 0]
    found = flatness_map(points, station=STATION)
    assert np.count_nonzero(found.cells.data == Cell.OBSTACLE) == 0
    assert np.nanmedian(np.rad2deg(found.angle.data)) == pytest.approx(1.72, abs=0.4)


def test_normals_agree_with_the_paper_cell_by_cell():
    rng = np.random.default_rng(3)
    points = np.column_stack([rng.uniform(0, 1, (600, 2)), rng.normal(0, 0.004, 600)])
    found = flatness_map(points)
    for row, column in np.argwhere(~np.isnan(found.angle.data)):
        centre = found.angle.centres_of([row, column])
        cell = points[np.all(np.floor(points[:, :2] / CELL) == [column, row], axis=1)]
        offset = cell - cell[np.argmin(np.hypot(*(cell[:, :2] - centre).T))]
        distance = np.linalg.norm(offset, axis=1)
        weighted = offset * ((distance.max() - distance) / distance.max())[:, None]
        normal = np.linalg.svd(weighted)[2][2]
        assert found.angle.data[row, column] == pytest.approx(np.arccos(abs(normal[2])), abs=1e-6)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_cells_of_fewer_than_three_points_are_unknown(count):
    found = flatness_map(np.full((count, 3), 0.05) * [[1, 1, 0]])
    assert np.all(found.cells.data == Cell.UNKNOWN)
    assert np.isnan(found.angle.data).all()


def test_points_on_one_line_tell_no_normal():
    points = np.column_stack([np.linspace(0.01, 0.09, 9), np.full(9, 0.05), np.zeros(9)])
    assert np.all(flatness_map(points).cells.data == Cell.UNKNOWN)
