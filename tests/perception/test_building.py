import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from perception.building import Building, beyond, contains, door_pose, same_door
from perception.failure import FailureError
from perception.findings import Door, RoomShape

THICKNESS = 0.2


def door(x, y, normal=(0.0, 1.0), **changes):
    return replace(Door(x, y, normal, 0.9, 0.85, 2.05, 0.9), **changes)


def other_side(seen, thickness=THICKNESS, noise=(0.0, 0.0)):
    x, y = beyond(seen, thickness)
    return replace(seen, x=x + noise[0], y=y + noise[1], normal=(-seen.normal[0], -seen.normal[1]))


def square(x0, y0, x1, y1):
    contour = np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)], float)
    return RoomShape(contour, 0.0, 3.0, np.hstack([contour, np.roll(contour, -1, axis=0)]))


def start(*doors):
    building, room = Building().add_room((0.0, 0.0))
    return building.observe_doors(room, doors), room


relaxed = settings(deadline=None)
noise = st.floats(-0.1, 0.1)
angles = st.floats(-np.pi, np.pi)


@relaxed
@given(angles, noise, noise)
def test_door_seen_from_both_sides_is_one_door(angle, sideways, depth):
    here = door(3.0, 1.0, (float(np.cos(angle)), float(np.sin(angle))))
    shift = (-sideways * here.normal[1] + depth * here.normal[0], sideways * here.normal[0] + depth * here.normal[1])
    building, _ = start(here)
    building, second = building.add_room(beyond(here, 0.8), "D1")
    building = building.observe_doors(second, [other_side(here, noise=shift)])
    assert len(building.doors) == 1
    assert building.edge("D1").rooms == ("R1", "R2")
    assert building.edge("D1").state == "passed"


@relaxed
@given(st.lists(st.tuples(noise, noise), min_size=1, max_size=5))
def test_seeing_the_same_doors_again_changes_nothing(jitter):
    doors = [door(2.0 * n + dx, dy) for n, (dx, dy) in enumerate(jitter)]
    once, room = start(*doors)
    assert once.observe_doors(room, doors) == once
    assert len(once.doors) == len(doors)


@relaxed
@given(st.permutations(range(4)))
def test_doors_are_the_same_in_whatever_order_they_are_found(order):
    doors = [door(0, 3), door(2, 3), door(-4, 1, (-1.0, 0.0)), door(2.0, -3, (0.0, -1.0))]
    building, _ = start(*[doors[n] for n in order])
    assert {edge.door for edge in building.doors} == set(doors)


def test_thickness_comes_from_both_faces_and_net_width_from_the_tighter_one():
    here = door(0, 3, thickness=0.15)
    building, _ = start(here)
    building, second = building.add_room((0, 4), "D1")
    building = building.observe_doors(second, [replace(other_side(here, 0.32), net_width=0.7)])
    both = building.door_from_known_side("D1")
    assert both.thickness == pytest.approx(0.32)
    assert both.net_width == 0.7
    assert door_pose(both) == pytest.approx((0.0, 3.16, np.pi / 2))


def test_two_doors_side_by_side_stay_two():
    building, _ = start(door(0.0, 3.0), door(1.1, 3.0))
    assert len(building.doors) == 2
    assert not same_door(door(0, 3), door(0, 3, (1.0, 0.0)))


def test_doors_of_opposite_walls_of_a_narrow_room_stay_two():
    building, _ = start(door(0.0, 0.5), door(0.0, -0.5, (0.0, -1.0)))
    assert len(building.doors) == 2


def test_door_found_from_a_second_known_room_is_linked_and_not_entered():
    passage, shared = door(0, 3), door(2, 3)
    building, _ = start(passage, shared)
    building, second = building.add_room((0, 4), "D1")
    building = building.observe_doors(second, [other_side(shared)])
    assert building.edge("D2").state == "linked"
    assert building.neighbours("R1") == ("R2",)
    assert building.next_door((0, 4), second) is None


def test_door_into_a_scanned_contour_is_linked():
    building, _ = start(door(0, 3))
    building, second = building.add_room((0, 4), "D1")
    shapes = {"R1": square(-5, -5, 5, 3), second: square(-5, 3.2, 5, 8)}
    building = building.observe_doors("R1", [door(4, 3)], shapes)
    assert building.edge("D2").rooms == ("R1", "R2")
    assert building.next_door((0, 0), "R1") is None


def test_next_door_is_near_along_the_graph_and_not_through_the_wall():
    # From (0, 3.5) in R2 the door of R1 just behind the wall is 1.5 m away, but the way round is longer.
    way_in = door(4.0, 3.0)
    building, _ = start(way_in, door(-1.0, 2.0, (-1.0, 0.0)))
    building, second = building.add_room((4.0, 4.0), "D1")
    building = building.observe_doors(second, [other_side(way_in), door(-3.0, 5.0, (-1.0, 0.0))])
    nearest = building.next_door((0.0, 3.5), second)
    assert nearest is not None and nearest.id == "D3"


def test_deferred_door_is_tried_once_more_after_all_others_then_refused():
    building, room = start(door(1, 3), door(6, 3))
    building = building.defer("D1", "NAV_NO_PATH")
    assert building.next_door((0, 0), room).id == "D2"
    building, _ = building.add_room((6, 4), "D2")
    assert building.next_door((6, 4), "R2").id == "D1"
    building = building.defer("D1", "NAV_BLOCKED")
    assert building.next_door((6, 4), "R2") is None
    assert building.edge("D1").state == "refused"
    assert [edge.reason for edge in building.unfinished_doors()] == ["NAV_BLOCKED"]


@settings(relaxed, max_examples=20)
@given(st.integers(2, 4), st.integers(0, 2**32 - 1))
def test_walk_over_a_grid_of_rooms_enters_each_once_and_ends(side, seed):
    """A robot that sees every door of each room it enters, with noise, in a grid of square rooms."""
    rng = np.random.default_rng(seed)
    size, pitch = 4.0, 4.0 + THICKNESS

    def doors_of(i, j):
        for di, dj in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            if 0 <= i + di < side and 0 <= j + dj < side:
                x, y = i * pitch + di * size / 2, j * pitch + dj * size / 2
                dx, dy = rng.uniform(-0.05, 0.05, 2)
                yield door(x + dx, y + dy, (float(di), float(dj)), confidence=float(rng.uniform(0.5, 1)))

    building, room = Building().add_room((0.0, 0.0))
    shapes, entered, cell = {}, [(0, 0)], (0, 0)
    for _ in range(side * side + 1):
        x, y = cell[0] * pitch, cell[1] * pitch
        shapes[room] = square(x - 2, y - 2, x + 2, y + 2)
        building = building.observe_doors(room, list(doors_of(*cell)), shapes).end_room(room, "complete", "enough seen")
        edge = building.next_door((x, y), room)
        if edge is None:
            break
        inside = beyond(building.door_from_known_side(edge.id), THICKNESS + 1.0)
        cell = (round(inside[0] / pitch), round(inside[1] / pitch))
        building, room = building.add_room(inside, edge.id)
        entered.append(cell)
    assert sorted(entered) == [(i, j) for i in range(side) for j in range(side)]
    assert not building.unfinished_doors()
    assert len(building.doors) == 2 * side * (side - 1)


@relaxed
@given(st.booleans(), st.booleans())
def test_building_survives_json(passed, deferred):
    building, _ = start(door(1, 3), door(6, 3))
    if passed:
        building, second = building.add_room((1, 4), "D1")
        building = building.observe_doors(second, [other_side(door(1, 3))]).end_room(second, "partial", "views_blocked")
    if deferred:
        building = building.defer("D2", "NAV_BLOCKED")
    assert Building.from_dict(json.loads(json.dumps(building.to_dict()))) == building


def test_contour_with_a_corner_cut_out_holds_the_right_points():
    contour = np.array([(0, 0), (4, 0), (4, 2), (2, 2), (2, 4), (0, 4)], float)
    assert contains(contour, (1, 3)) and contains(contour, (3, 1))
    assert not contains(contour, (3, 3)) and not contains(contour, (-1, 1))


def test_unknown_names_are_refused():
    with pytest.raises(FailureError, match="BUILDING_UNKNOWN_DOOR"):
        Building().edge("D1")
    with pytest.raises(FailureError, match="BUILDING_UNKNOWN_ROOM"):
        Building().room("R1")


def test_a_forbidden_door_is_no_shortfall_and_is_not_tried_again():
    seen = door(1.0, 2.0)
    building, room = start(seen)
    (edge,) = building.doors
    shut = building.forbid(edge.id, "GEOFENCE")
    assert shut.next_door((0.0, 0.0)) is None and shut.unfinished_doors() == ()
    assert shut.reconsider_doors() == shut == Building.from_dict(shut.to_dict())
    again = shut.observe_doors(room, [seen])
    assert (again.doors[0].state, again.doors[0].reason) == ("forbidden", "GEOFENCE")
