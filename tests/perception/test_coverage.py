"""Coverage against areas known in closed form."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perception import transforms
from perception.coverage import PatchCounter, ViewLimits, coverable, sensed
from perception.failure import FailureError
from perception.patches import Patches, sample_surfaces
from perception.scan import BeamPattern
from tests.synthetic import Scene, box

HEIGHT = 1.3
UP, DOWN = np.deg2rad(60), np.deg2rad(-40)
VIEW = ViewLimits((DOWN, UP), (0.5, 120.0), np.deg2rad(89.5))


def rectangle(origin: tuple, along: tuple, up: tuple) -> np.ndarray:
    a, u, v = np.array(origin, float), np.array(along, float), np.array(up, float)
    return np.array([[a, a + u, a + u + v], [a, a + u + v, a + v]])


def floor(width: float = 8.0, depth: float = 6.0, z: float = 0.0) -> np.ndarray:
    return rectangle((0, 0, z), (width, 0, 0), (0, depth, 0))


def count_points(patches: Patches, cloud: np.ndarray) -> np.ndarray:
    counter = PatchCounter(patches)
    for point in cloud:
        counter.add(point[None])
    return counter.counts


def box_triangles(lower: tuple, upper: tuple) -> np.ndarray:
    mesh = box(lower, upper).to_legacy()
    return np.asarray(mesh.vertices)[np.asarray(mesh.triangles)]


@settings(max_examples=25, deadline=None)
@given(
    st.lists(st.floats(-3, 3), min_size=9, max_size=9),
    st.sampled_from([0.1, 0.25]),
)
def test_a_triangle_keeps_its_area_whatever_its_place(corners: list[float], cell: float) -> None:
    triangle = np.array(corners).reshape(1, 3, 3)
    area = 0.5 * np.linalg.norm(np.cross(triangle[0, 1] - triangle[0, 0], triangle[0, 2] - triangle[0, 0]))
    if area < 0.01:
        return
    patches = sample_surfaces(triangle, cell)
    assert patches.areas.sum() == pytest.approx(area, rel=1e-9)
    assert patches.areas.max() <= cell**2 * 1.3
    assert set(patches.owner) == set(range(patches.count))


def test_cells_do_not_depend_on_the_triangulation() -> None:
    fan_centre = np.array([3.3, 1.7, 0.0])
    rim = np.array([[0, 0, 0], [8, 0, 0], [8, 6, 0], [0, 6, 0]], float)
    fan = np.array([[fan_centre, rim[i], rim[(i + 1) % 4]] for i in range(4)])
    one, other = sample_surfaces(floor()), sample_surfaces(fan)
    assert one.count == other.count == 80 * 60
    assert np.allclose(one.areas, 0.01, rtol=0.01)
    assert np.allclose(other.areas, 0.01, rtol=0.35)
    assert other.areas.sum() == pytest.approx(48.0)


def test_a_surface_without_area_is_refused() -> None:
    with pytest.raises(FailureError, match="COVERAGE_NO_SURFACE"):
        sample_surfaces(np.zeros((2, 3, 3)))


def test_points_count_only_inside_their_cell_and_near_their_plane() -> None:
    patches = sample_surfaces(floor())
    cloud = np.array([[1.05, 1.05, 0.02], [1.05, 1.06, -0.04], [1.05, 1.05, 0.06], [2.01, 3.01, 0.0], [-0.05, 1, 0]])
    counts = count_points(patches, cloud)
    assert sorted(counts[counts > 0]) == [1, 2]
    assert patches.areas[sensed(patches, cloud, 2)].sum() == pytest.approx(0.01)


def test_a_floor_point_beside_a_wall_counts_for_the_floor_only() -> None:
    wall = rectangle((0, 0, 0), (8, 0, 0), (0, 0, 3))
    parts = [sample_surfaces(floor()), sample_surfaces(wall)]
    counts = count_points(Patches.merged(parts), np.array([[4.05, 0.03, 0.004]]))
    assert counts[: parts[0].count].sum() == 1
    assert counts.sum() == 1


def test_one_station_misses_the_discs_of_its_blind_cones() -> None:
    patches = [sample_surfaces(floor(z=z)) for z in (0.0, 3.0)]
    both = Patches.merged(patches)
    seen = coverable(both, [[4.0, 3.0, HEIGHT]], box_triangles((0, 0, 0), (8, 6, 3)), VIEW)
    on_floor, on_ceiling = np.split(both.areas * ~seen, [patches[0].count])
    radius_down, radius_up = HEIGHT / np.tan(-DOWN), (3.0 - HEIGHT) / np.tan(UP)
    # A cell counts when one of its places is seen, so a disc loses up to half a cell of its rim.
    assert on_floor.sum() == pytest.approx(np.pi * (radius_down - 0.04) ** 2, rel=0.03)
    assert on_ceiling.sum() == pytest.approx(np.pi * (radius_up - 0.04) ** 2, rel=0.05)


def test_the_shadow_of_a_cabinet_cannot_be_covered_and_a_second_station_lights_it() -> None:
    room, cabinet = box_triangles((0, 0, 0), (8, 6, 3)), box_triangles((5, 0, 0), (5.5, 4, 3))
    wall = sample_surfaces(rectangle((8, 0, 0), (0, 6, 0), (0, 0, 3)))
    blockers = np.concatenate([room, cabinet])
    seen = coverable(wall, [[2.0, 1.0, HEIGHT]], blockers, VIEW)
    # The line over the cabinet's edge (5.5, 4) meets the wall at y = 1 + 6 * 3 / 3.5 = 6.14: all in the shadow.
    assert not seen.any()
    seen = coverable(wall, [[2.0, 1.0, HEIGHT], [3.0, 5.0, HEIGHT]], blockers, VIEW)
    lit = wall.areas[seen].sum()
    # From (3, 5) the edge line meets the wall at y = 5 - 5 / 2.5 = 3.0: the upper half is lit.
    assert lit == pytest.approx(9.0, rel=0.05)


def test_grazing_beams_and_short_ranges_see_nothing() -> None:
    wall = sample_surfaces(rectangle((0, 0, 0), (10, 0, 0), (0, 0, 3)))
    station, none = [[5.0, 1.0, HEIGHT]], np.zeros((0, 3, 3))
    limits = ViewLimits((-1.5, 1.5), (1.5, 120.0), np.deg2rad(70))
    seen = coverable(wall, station, none, limits)
    middle = wall.corners + wall.axes.sum(axis=1) * wall.cell / 2
    far = np.linalg.norm(middle - station, axis=1)
    assert not seen[far < 1.4].any()
    assert not seen[np.arccos(1.0 / far) > np.deg2rad(72)].any()
    assert seen[(far > 1.6) & (np.arccos(1.0 / far) < np.deg2rad(68))].all()


def test_what_a_real_scan_senses_is_coverable_from_its_station() -> None:
    # The cabinet's faces lie inside cells: where they lie on a cell's rim, noise alone decides on which side.
    room, cabinet = ((0, 0, 0), (8, 6, 3)), ((4.95, 0.05, 0.05), (5.45, 4.05, 2.05))
    pattern = BeamPattern.with_step(np.deg2rad(0.4), (DOWN, UP), (0.5, 120.0))
    map_from_scanner = transforms.from_euler(0, 0, 0.3, (3.0, 2.5, HEIGHT))
    scan = Scene(box(*room), box(*cabinet)).take(map_from_scanner, pattern)
    triangles = box_triangles(*room)
    patches = sample_surfaces(triangles)
    found = sensed(patches, transforms.apply(map_from_scanner, scan.points))
    possible = coverable(
        patches, map_from_scanner[:3, 3], np.concatenate([triangles, box_triangles(*cabinet)]), VIEW, 16
    )
    assert patches.areas[found & ~possible].sum() / patches.areas.sum() < 0.003
    assert patches.areas[found].sum() / patches.areas[possible].sum() > 0.97


def test_the_order_of_the_stations_does_not_matter() -> None:
    patches = sample_surfaces(floor(z=0.0))
    blockers = np.concatenate([box_triangles((0, 0, 0), (8, 6, 3)), box_triangles((5, 0, 0), (5.5, 4, 2))])
    stations = np.array([[x, y, HEIGHT] for x in (1, 3, 7) for y in (1, 5)], float)
    assert np.array_equal(
        coverable(patches, stations, blockers, VIEW), coverable(patches, stations[::-1], blockers, VIEW)
    )
