import numpy as np
import pytest

from perception.matching.constraint import hold

RNG = np.random.default_rng(0)


def sheet(normal, offset, count=400, extent=3.0):
    """Points of a square of a plane."""
    normal = np.asarray(normal, float)
    along = np.linalg.svd(normal[None])[2][1:]
    points = RNG.uniform(-extent, extent, (count, 2)) @ along + offset * normal
    return points, np.repeat(normal[None], count, axis=0)


def joined(*sheets):
    return np.concatenate([points for points, _ in sheets]), np.concatenate([normals for _, normals in sheets])


def box_room():
    return joined(*(sheet(sign * axis, 3.0) for axis in np.eye(3) for sign in (-1, 1)))


def cylinder(at):
    angle, height = RNG.uniform(0, 2 * np.pi, 2000), RNG.uniform(-1.4, 1.4, 2000)
    normals = np.c_[np.cos(angle), np.sin(angle), np.zeros(2000)]
    wall = 2.0 * normals + np.c_[np.zeros((2000, 2)), height], normals
    points, normals = joined(wall, sheet((0, 0, 1.0), 1.4, extent=1.5), sheet((0, 0, -1.0), 1.4, extent=1.5))
    return points + at, normals


def test_box_room_holds_everything():
    held = hold(*box_room())
    assert held.shift == pytest.approx(1 / 3, abs=0.01)
    assert held.turn > 0.1


def test_corridor_lets_a_scan_slide_along_it():
    walls = joined(*(sheet(sign * np.eye(3)[axis], 1.5, extent=9.0) for axis in (1, 2) for sign in (-1, 1)))
    held = hold(*walls)
    assert held.shift < 1e-9
    assert abs(held.shift_axis[0]) > 0.999
    assert held.turn > 0.1


@pytest.mark.parametrize("at", [(0.0, 0.0, 0.0), (5.0, -3.0, 1.0)])
def test_stairwell_lets_a_scan_turn_wherever_it_was_taken(at):
    held = hold(*cylinder(np.array(at)))
    assert held.shift > 0.1
    assert held.turn < 1e-3
    assert abs(held.turn_axis[2]) > 0.99


def test_hold_does_not_depend_on_the_frame_or_the_scale():
    points, normals = box_room()
    turn = np.linalg.qr(RNG.normal(size=(3, 3)))[0]
    moved = hold(7.0 * points @ turn.T + 4.0, normals @ turn.T)
    held = hold(points, normals)
    assert moved.shift == pytest.approx(held.shift, rel=1e-6)
    assert moved.turn == pytest.approx(held.turn, rel=1e-3)


def test_hardly_any_pairs_hold_nothing():
    assert hold(np.zeros((3, 3)), np.eye(3)).shift == 0.0
