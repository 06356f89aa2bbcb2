from itertools import product

import numpy as np
import open3d as o3d
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from perception import transforms, voxels
from perception.failure import FailureError
from perception.findings import RoomShape
from perception.grids import Label
from perception.scan import BeamPattern, Scan
from tests.synthetic import COARSE, FINE, Scene, box

WIDTH, DEPTH, HEIGHT = 3.63, 2.87, 2.5
CABINET = (1.9, 0.9, 0.0), (2.4, 1.7, 1.6)
EVERY = 5
"""The all-pairs oracle looks at one voxel in so many."""
POSE = transforms.from_euler(0.01, -0.02, 0.8, (0.93, 1.41, 1.3))


def rectangle(x0=0.0, y0=0.0, x1=WIDTH, y1=DEPTH, floor=0.0, ceiling=HEIGHT):
    corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], float)
    return RoomShape(corners, floor, ceiling, np.hstack([corners, np.roll(corners, -1, axis=0)]))


@pytest.fixture(scope="module")
def scene():
    return Scene(box((0, 0, 0), (WIDTH, DEPTH, HEIGHT)), box(*CABINET))


@pytest.fixture(scope="module")
def space():
    return voxels.room_space(rectangle())


def lattice_index(space):
    return np.rint(np.asarray(space.origin) / space.size + [0, 0, 0.5]).astype(int)


def scan_of(points, pattern=COARSE):
    points = np.asarray(points, np.float32).reshape(-1, 3)
    beam = pattern.beams_towards(points)
    return Scan("S", points, np.ones(len(points), np.float32), beam, pattern, np.eye(4), np.eye(4))


def test_every_surface_of_the_room_lies_in_its_space(scene, space):
    points = transforms.apply(POSE, scene.take(POSE).points)
    index = space.voxels_of(points)
    assert np.all((index >= 0) & (index < space.labels.shape))
    assert np.all(space.labels[tuple(index.T)] == Label.OCCLUDED)


def test_noise_of_the_floor_fills_a_single_layer(scene, space):
    labelled = voxels.label(space, scene.take(POSE, FINE), POSE)
    inside = labelled.labels[12:16, 18:22]
    assert np.all(inside[..., 0] != Label.EMPTY)
    assert not np.any(inside[..., 1] == Label.OCCUPIED)


def test_voxels_away_from_a_slanted_contour_are_outside():
    corners = np.array([[0, 0], [4, 0], [4, 1], [1, 4], [0, 4]], float)
    shape = RoomShape(corners, 0.0, 2.5, np.hstack([corners, np.roll(corners, -1, axis=0)]))
    space = voxels.room_space(shape)
    centres = space.centres(np.argwhere(np.ones(space.labels.shape, bool)))
    away = shapely.distance(shapely.Polygon(corners), shapely.points(centres[:, :2]))
    labels = space.labels.ravel()
    assert np.all(labels[away == 0] == Label.OCCLUDED)
    assert np.all(labels[away > 0.05 + 0.0708] == Label.OUTSIDE)


@settings(max_examples=25, deadline=None)
@given(st.tuples(*[st.floats(-3, 3)] * 2), st.tuples(*[st.floats(0.5, 3)] * 2), st.floats(-1, 1), st.integers(0, 99))
def test_a_space_grows_keeps_its_labels_and_stays_on_the_lattice(corner, size, floor, seed):
    first = voxels.room_space(rectangle(floor=0.0))
    painted = first.labels * np.random.default_rng(seed).integers(1, 4, first.labels.shape, np.uint8) // 2
    first = type(first)(painted.astype(np.uint8), first.origin, first.size)
    shape = rectangle(*corner, corner[0] + size[0], corner[1] + size[1], floor, floor + 2)
    both, alone = voxels.room_space(shape, previous=first), voxels.room_space(shape)
    for part in (first, alone):
        low = lattice_index(part) - lattice_index(both)
        window = both.labels[tuple(slice(a, a + n) for a, n in zip(low, part.labels.shape, strict=True))]
        if part is first:
            kept = part.labels != Label.OUTSIDE
            assert np.array_equal(window[kept], part.labels[kept])
        else:
            assert np.all(window[part.labels != Label.OUTSIDE] != Label.OUTSIDE)
    assert both.total >= max(first.total, alone.total)
    assert np.allclose(both.origin, (lattice_index(both) - [0, 0, 0.5]) * both.size)


def test_a_shape_without_volume_is_refused():
    with pytest.raises(FailureError, match="VOXELS_BAD_SHAPE"):
        voxels.room_space(rectangle(ceiling=0.0))
    with pytest.raises(FailureError, match="VOXELS_BAD_SHAPE"):
        voxels.room_space(rectangle(), size=0.05, previous=voxels.room_space(rectangle()))


def range_oracle(space, scan, pose):
    """The range rule voxel by voxel in plain Python; the set of empty voxels."""
    ranges, pattern, side = scan.range_image(), scan.pattern, space.size
    empty = set()
    for voxel in map(tuple, np.argwhere(space.labels == Label.OCCLUDED)):
        x, y, z = transforms.inverse(pose) @ [*space.centres(np.array(voxel)), 1.0] @ np.eye(4)[:, :3]
        across, distance = np.hypot(x, y), np.sqrt(x * x + y * y + z * z)
        elevation, azimuth = np.arctan2(z, across), np.arctan2(y, x)
        measured = []
        for up in (-1, 0, 1):
            for aside in (-1, 0, 1):
                tilt = elevation + up * side / 3 / max(distance, side)
                turn = azimuth + aside * side / 3 / max(across, side)
                row = round((tilt - pattern.elevation_min) / pattern.elevation_step)
                if 0 <= row < pattern.rows:
                    measured.append(float(ranges[row, round(turn / pattern.azimuth_step) % pattern.columns]))
        returned = [r for r in measured if r > 0]
        passed = sum(r > distance + side / 2 for r in returned)
        if 2 * passed > len(returned) and sum(abs(r - distance) <= side / 2 for r in returned) < 2:
            empty.add(voxel)
    return empty


def sphere_oracle(space, scan, pose):
    """The paper's rule for every pair of voxels, by angles; the set of empty voxels, and of those at its very edge."""
    inverse = transforms.inverse(pose)
    origin = pose[:3, 3]
    obstacles = space.centres(np.argwhere(space.labels == Label.OCCUPIED)) - origin
    near = np.linalg.norm(obstacles, axis=1)
    radius = space.size / np.sqrt(2)
    obstacles, near = obstacles[near > radius], near[near > radius]
    alpha = np.arcsin(radius / near)
    image = scan.range_image().ravel()
    empty, edge = set(), set()
    for voxel in map(tuple, np.argwhere(space.labels == Label.OCCLUDED)[::EVERY]):
        centre = space.centres(np.array(voxel))
        beam = scan.pattern.beams_towards((centre @ inverse[:3, :3].T + inverse[:3, 3])[None])[0]
        if beam < 0 or image[beam] == 0:
            continue
        ray = centre - origin
        distance = np.linalg.norm(ray)
        nearer = near < distance
        beta = np.arccos(np.clip(obstacles[nearer] @ ray / near[nearer] / distance, -1, 1))
        if not np.any(alpha[nearer] > beta):
            empty.add(voxel)
        if np.any(np.abs(alpha[nearer] - beta) < 1e-7):
            edge.add(voxel)
    return empty, edge


def empty_voxels(space):
    return set(map(tuple, np.argwhere(space.labels == Label.EMPTY)))


def occupied_only(before, after):
    labels = np.where(after.labels == Label.OCCUPIED, after.labels, before.labels)
    return type(after)(labels, after.origin, after.size)


def test_range_labeller_agrees_with_its_oracle(scene):
    space = voxels.room_space(rectangle(1.2, 0.6, 2.6, 2.0, 0.0, 1.9))
    scan = scene.take(POSE)
    labelled = voxels.label(space, scan, POSE)
    expected = range_oracle(occupied_only(space, labelled), scan, POSE)
    assert len(expected) > 500
    assert empty_voxels(labelled) == expected


def test_paper_labeller_agrees_with_its_oracle(scene):
    space = voxels.room_space(rectangle(1.2, 0.6, 3.0, 2.4, 0.0, 1.9))
    scan = scene.take(POSE)
    labelled = voxels.label(space, scan, POSE, "paper")
    before = occupied_only(space, labelled)
    expected, edge = sphere_oracle(before, scan, POSE)
    looked_at = set(map(tuple, np.argwhere(before.labels == Label.OCCLUDED)[::EVERY]))
    assert len(expected) > 200
    assert len(looked_at - expected) > 200
    assert (empty_voxels(labelled) & looked_at) ^ expected <= edge


def centre_is_visible(scene, space, pose, pattern):
    """Truth by ray casting at the mesh: (nx, ny, nz)."""
    ray = space.centres(np.argwhere(np.ones(space.labels.shape, bool))) - pose[:3, 3]
    distance = np.linalg.norm(ray, axis=1)
    rays = np.hstack([np.broadcast_to(pose[:3, 3], ray.shape), ray / distance[:, None]]).astype(np.float32)
    hit = scene._scene.cast_rays(o3d.core.Tensor(rays))["t_hit"].numpy()
    elevation = np.arcsin(ray @ pose[:3, 2] / distance)
    in_view = (elevation >= pattern.elevation_min) & (elevation <= pattern.elevation_max) & (hit >= pattern.range_min)
    return (in_view & (hit > distance)).reshape(space.labels.shape)


@pytest.mark.parametrize(("labeller", "hidden"), [("range", 0.002), ("paper", 0.10)])
def test_labels_agree_with_what_the_scanner_could_truly_see(scene, space, labeller, hidden):
    labelled = voxels.label(space, scene.take(POSE, FINE), POSE, labeller)
    visible = centre_is_visible(scene, space, POSE, FINE) & (space.labels != Label.OUTSIDE)
    empty, occluded = labelled.labels == Label.EMPTY, labelled.labels == Label.OCCLUDED
    assert np.count_nonzero(visible & occluded) <= hidden * np.count_nonzero(visible)
    # A voxel on the edge of a shadow may be empty while its centre is hidden, but never one that is hidden wholly.
    partly = np.zeros_like(visible)
    for offset in product((-1, 0, 1), repeat=3):
        moved = np.asarray(space.origin) + 0.45 * space.size * np.array(offset)
        partly |= centre_is_visible(scene, type(space)(space.labels, tuple(moved), space.size), POSE, FINE)
    assert not np.any(empty & ~partly)


@pytest.mark.parametrize("labeller", ["range", "paper"])
def test_nothing_is_empty_where_no_beam_returned(scene, space, labeller):
    scan = scene.take(POSE)
    azimuth = np.rad2deg(np.arctan2(scan.points[:, 1], scan.points[:, 0]))
    returned = np.abs(azimuth) > 30  # as before a window of 60 degrees
    half = Scan(
        "S", scan.points[returned], scan.intensity[returned], scan.beam[returned], scan.pattern, *[np.eye(4)] * 2
    )
    labelled = voxels.label(space, half, POSE, labeller)
    empty = transforms.apply(transforms.inverse(POSE), space.centres(np.argwhere(labelled.labels == Label.EMPTY)))
    assert len(empty) > 5000
    across = np.linalg.norm(empty[:, :2], axis=1)
    half_width = np.rad2deg(np.arcsin(np.minimum(1, space.size / across)))
    assert np.all(np.abs(np.rad2deg(np.arctan2(empty[:, 1], empty[:, 0]))) + half_width >= 29.5)


@pytest.mark.parametrize("labeller", ["range", "paper"])
def test_the_cone_below_the_field_of_view_stays_occluded(scene, space, labeller):
    labelled = voxels.label(space, scene.take(POSE), POSE, labeller)
    i, j, _ = space.voxels_of(POSE[None, :3, 3])[0]
    assert np.all(labelled.labels[i, j, :8] == Label.OCCLUDED)


@pytest.mark.parametrize("labeller", ["range", "paper"])
def test_what_is_nearer_than_the_minimum_range_hides_what_is_behind(space, labeller):
    blind = BeamPattern.with_step(np.deg2rad(1.0), (np.deg2rad(-40), np.deg2rad(60)), (1.2, 120.0))
    scene = Scene(box((0, 0, 0), (WIDTH, DEPTH, HEIGHT)), box((1.5, 1.2, 0.0), (1.6, 1.6, 2.0)))
    labelled = voxels.label(space, scene.take(POSE, blind), POSE, labeller)
    behind = space.voxels_of(np.array([[1.8, 1.41, 1.3], [2.5, 1.41, 1.3], [3.3, 1.41, 1.3]]))
    assert np.all(labelled.labels[tuple(behind.T)] == Label.OCCLUDED)


def test_a_stray_point_in_the_air_is_no_obstacle_but_a_thin_pole_is(scene, space):
    scan = scene.take(POSE)
    air = np.array([[0.9, 0.3, 0.02], *([0.9, -0.3, z] for z in (-0.1, 0.0, 0.1))], np.float32)
    beams = scan.pattern.beams_towards(air)
    keep = ~np.isin(scan.beam, beams)
    points, beam = np.vstack([scan.points[keep], air]), np.concatenate([scan.beam[keep], beams])
    noisy = Scan("S", points, np.ones(len(points), np.float32), beam, scan.pattern, np.eye(4), np.eye(4))
    labelled = voxels.label(space, noisy, POSE)
    stray, *pole = labelled.labels[tuple(space.voxels_of(transforms.apply(POSE, air)).T)]
    assert stray == Label.EMPTY
    assert set(pole) == {Label.OCCUPIED}


def test_labels_of_more_scans_only_rise_in_certainty(scene, space):
    second = transforms.from_euler(0, 0.01, -2.0, (3.0, 2.2, 1.3))
    one = voxels.label(space, scene.take(POSE), POSE)
    two = voxels.label(one, scene.take(second, seed=1), second)
    assert np.all(two.labels[one.labels == Label.OCCUPIED] == Label.OCCUPIED)
    assert np.all(two.labels[one.labels == Label.EMPTY] != Label.OCCLUDED)
    assert voxels.counts(two).occluded < voxels.counts(one).occluded
    again = voxels.label(two, scene.take(second, seed=1), second)
    assert np.array_equal(again.labels, two.labels)


def test_counts_are_those_of_table_1(scene, space):
    labelled = voxels.label(space, scene.take(POSE), POSE)
    counts = voxels.counts(labelled)
    assert (counts.seen, counts.total) == (labelled.seen, labelled.total) == (labelled.seen, space.total)


@pytest.mark.parametrize(("labeller", "differing"), [("range", 0.02), ("paper", 0.02)])
def test_a_scan_of_every_third_beam_labels_nearly_as_the_whole(scene, space, labeller, differing):
    scan = scene.take(POSE, FINE)
    whole, coarse = (voxels.label(space, taken, POSE, labeller).labels for taken in (scan, scan.every(3)))
    assert np.mean(whole != coarse) < differing


def test_a_grown_space_keeps_its_labels_and_has_the_new_voxels_labelled(scene):
    small, large = rectangle(1.2, 0.6, 2.6, 2.0, 0.0, 1.9), rectangle(0.9, 0.6, 3.0, 2.4, 0.0, 1.9)
    scan = scene.take(POSE)
    before = voxels.label(voxels.room_space(small), scan, POSE)
    grown = voxels.room_space(large, previous=before)
    new = voxels.added(grown, before)
    within = voxels.label(grown, scan, POSE, within=new)
    everywhere = voxels.label(grown, scan, POSE)
    assert np.count_nonzero(new) == grown.total - before.total
    assert np.array_equal(within.labels[~new], grown.labels[~new])
    assert np.array_equal(within.labels[new], everywhere.labels[new])
