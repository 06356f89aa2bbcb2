import numpy as np
import open3d as o3d
import pytest

from perception import transforms
from perception.doors import before, beyond, door_pose, find_doors
from perception.findings import RoomShape
from perception.scan import BeamPattern
from tests.synthetic import Scene, box

PATTERN = BeamPattern.with_step(np.deg2rad(0.5), (np.deg2rad(-40), np.deg2rad(60)), (1.5, 120.0))
LENGTH, DEPTH, HEIGHT, WALL = 6.0, 4.5, 2.8, 0.2
LEFT, RIGHT, TOP = 2.5, 3.4, 2.05


def leaf(hinge, angle, width=0.88):
    mesh = o3d.geometry.TriangleMesh.create_box(width, 0.04, TOP - 0.02).translate((0, -0.02, 0.005))
    mesh.transform(transforms.planar(*hinge, angle))
    return o3d.t.geometry.TriangleMesh.from_legacy(mesh)


def holed_wall(left=LEFT, right=RIGHT, bottom=0.0, top=TOP):
    parts = [box((0, DEPTH, 0), (left, DEPTH + WALL, HEIGHT)), box((right, DEPTH, 0), (LENGTH, DEPTH + WALL, HEIGHT))]
    if bottom > 0:
        parts.append(box((left, DEPTH, 0), (right, DEPTH + WALL, bottom)))
    if top < HEIGHT:
        parts.append(box((left, DEPTH, top), (right, DEPTH + WALL, HEIGHT)))
    return parts


def find(wall, *things, drop_beyond=0.0, wobble=0.0, stations=((1.5, 1.5), (4.3, 2.0)), robot_width=0.6, far=4.0):
    """Doors of a room whose far wall is given; another room lies behind it, its floor ``drop_beyond`` lower."""
    ground = [
        box((-1, -1, -0.1), (LENGTH + 1, DEPTH + WALL, 0)),
        box((-1, DEPTH + WALL, -drop_beyond - 0.1), (LENGTH + 1, DEPTH + far + 1, -drop_beyond)),
        box((-1, -1, HEIGHT), (LENGTH + 1, DEPTH + far + 1, HEIGHT + 0.1)),
    ]
    around = [
        box((-WALL, -WALL, -1), (0, DEPTH + far, HEIGHT)),
        box((LENGTH, -WALL, -1), (LENGTH + WALL, DEPTH + far, HEIGHT)),
        box((0, -WALL, 0), (LENGTH, 0, HEIGHT)),
        box((0, DEPTH + far, -1), (LENGTH, DEPTH + far + WALL, HEIGHT)),
    ]
    scene = Scene(*ground, *around, *wall, *things)
    poses = [transforms.from_euler(0.01, -0.008, 0.7 * n, (*xy, 1.3)) for n, xy in enumerate(stations)]
    scans = [(scene.take(at, PATTERN, seed=n), at) for n, at in enumerate(poses)]
    contour = np.array([(0, 0), (LENGTH, 0), (LENGTH, DEPTH), (0, DEPTH)], float)
    contour += wobble * np.array([(1, -1), (-1, 1), (1, 1), (-1, -1)])
    shape = RoomShape(contour, 0.0, HEIGHT, np.hstack([contour, np.roll(contour, -1, axis=0)]))
    return find_doors(shape, scans, robot_width)


def gates(findings):
    return {gate for door, gate in findings.refused if abs(door.y - DEPTH) < 0.3 and LEFT - 0.3 < door.x < RIGHT + 0.3}


@pytest.mark.parametrize("wobble", [0.0, 0.08, -0.08])
def test_open_door_is_found_where_it_is_though_the_contour_is_off(wobble):
    (door,) = find(holed_wall(), wobble=wobble).doors
    assert door.x == pytest.approx((LEFT + RIGHT) / 2, abs=0.02)
    assert door.y == pytest.approx(DEPTH, abs=0.01)
    assert door.width == pytest.approx(RIGHT - LEFT, abs=0.03)
    assert door.height == pytest.approx(TOP, abs=0.06)
    assert door.thickness == pytest.approx(WALL, abs=0.04)
    assert door.normal == pytest.approx((0, 1), abs=0.01)
    assert door_pose(door) == pytest.approx((2.95, DEPTH + WALL / 2, np.pi / 2), abs=0.03)
    assert beyond(door, 1.0)[1] == pytest.approx(DEPTH + 1, abs=0.02)
    assert before(door, 1.0)[1] == pytest.approx(DEPTH - 1, abs=0.02)


@pytest.mark.parametrize("angle", [95, -95])
def test_leaf_standing_open_on_either_side_leaves_the_door_passable(angle):
    hinge = (LEFT + 0.02, DEPTH + (WALL if angle > 0 else 0.0))
    (door,) = find(holed_wall(), leaf(hinge, np.deg2rad(angle))).doors
    assert 0.75 < door.net_width <= door.width + 1e-6


def test_half_open_leaf_leaves_an_oblique_way_and_a_wide_robot_is_refused():
    wall, half = holed_wall(2.3, 3.5), leaf((2.32, DEPTH + WALL), np.deg2rad(60), 1.16)
    (door,) = find(wall, half).doors
    # Between the far jamb and the leaf's face.
    assert door.net_width == pytest.approx((3.5 - 2.32) * np.sin(np.deg2rad(60)), abs=0.08)
    assert "narrow" in gates(find(wall, half, robot_width=door.net_width + 0.02))


def test_passage_up_to_the_ceiling_is_a_door():
    (door,) = find(holed_wall(top=HEIGHT)).doors
    assert door.height > 2.6


def test_shut_door_is_not_even_a_hole():
    findings = find(holed_wall(), leaf((LEFT + 0.01, DEPTH + WALL - 0.03), 0.0))
    assert not findings.doors


@pytest.mark.parametrize(
    ("wall", "things", "drop", "gate"),
    [
        (holed_wall(bottom=0.9), [], 0.0, None),
        (holed_wall(2.7, 3.2), [], 0.0, None),
        (holed_wall(top=1.5), [], 0.0, None),
        (holed_wall(), [], 0.4, "floor"),
        (holed_wall(), [box((2.4, DEPTH + 0.6, 0), (3.5, DEPTH + 0.7, HEIGHT))], 0.0, None),
    ],
    ids=["window", "slit", "hatch", "step down", "niche"],
)
def test_what_only_looks_like_a_door_is_not_one(wall, things, drop, gate):
    findings = find(wall, *things, drop_beyond=drop)
    assert not findings.doors
    assert gate is None or gate in gates(findings)


FURNITURE = [((1.0, 3.2, 0), (1.6, 3.8, 1.1)), ((3.8, 2.9, 0), (4.5, 3.4, 0.8)), ((2.2, 0.2, 0), (3.4, 0.7, 1.7))]
GHOSTS = [((a[0], 2 * DEPTH - b[1], 0), (b[0], 2 * DEPTH - a[1], b[2])) for a, b in FURNITURE]
WINDOW = 4.6, 5.6


def thin_wall(window=()):
    """With a hole of a door's size, and perhaps a window beside it."""
    upright = [0, LEFT, RIGHT, *window, LENGTH]
    parts = [box((a, DEPTH, 0), (b, DEPTH + 0.01, HEIGHT)) for a, b in zip(upright[::2], upright[1::2], strict=True)]
    parts.append(box((LEFT, DEPTH, TOP), (RIGHT, DEPTH + 0.01, HEIGHT)))
    if window:
        parts += [box((window[0], DEPTH, z), (window[1], DEPTH + 0.01, z + 0.9)) for z in (0, HEIGHT - 0.9)]
    return parts


def test_mirror_is_not_a_door():
    """A door-sized mirror shows the room again behind the wall: the same furniture, reflected."""
    solid = [box(*corners) for corners in FURNITURE]
    mirrored = find(thin_wall(), *solid, *(box(*corners) for corners in GHOSTS), far=DEPTH)
    assert not mirrored.doors and "mirror" in gates(mirrored)
    assert find(thin_wall(), *solid, box((4.0, 6.0, 0), (5.0, 6.5, 1.2)), far=DEPTH - 0.7).doors


def test_mirror_beside_a_window_is_not_a_door():
    """What the window shows behind the wall is no reflection, and says nothing of the mirror."""
    things = [box(*corners) for corners in (*FURNITURE, *GHOSTS)]
    outside = box((4.5, DEPTH + 1.0, 0), (LENGTH, DEPTH + 1.1, HEIGHT))
    mirrored = find(thin_wall(WINDOW), *things, outside, far=DEPTH)
    assert not mirrored.doors and "mirror" in gates(mirrored)


def test_pane_in_the_doorway_is_suspected():
    """Glass lets beams pass but throws some back: points on the plane all over the opening."""
    grid = [
        box((u, DEPTH + 0.0, z), (u + 0.02, DEPTH + 0.01, z + 0.02))
        for u in np.arange(LEFT + 0.1, RIGHT - 0.05, 0.15)
        for z in np.arange(0.2, 1.9, 0.2)
    ]
    findings = find(holed_wall(), *grid)
    assert not findings.doors and "glass" in gates(findings)


def test_a_leaf_that_hides_all_but_a_strip_of_its_door_makes_it_a_suspect():
    opened = leaf((LEFT + 0.02, DEPTH), -np.pi / 2)
    beside = find(holed_wall(), opened, stations=((1.0, 1.2),))
    assert beside.doors == ()
    assert "hidden" in gates(beside)
    (suspect,) = beside.suspects
    assert (suspect.x, suspect.y) == pytest.approx(((LEFT + RIGHT) / 2, DEPTH), abs=0.15)
    assert len(find(holed_wall(), opened, stations=((1.0, 1.2), (3.0, 2.6))).doors) == 1


def test_a_slit_between_two_cupboards_is_no_suspect():
    cupboards = [box((1.0, DEPTH - 0.5, 0), (2.8, DEPTH, 2.0)), box((3.0, DEPTH - 0.5, 0), (5.0, DEPTH, 2.0))]
    assert find([box((0, DEPTH, 0), (LENGTH, DEPTH + WALL, HEIGHT))], *cupboards).suspects == ()
