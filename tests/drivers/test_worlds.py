from pathlib import Path

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.simulated.world import DoorState, Surface, World, read_world, save_world
from drivers.simulated.worlds import load_world
from drivers.simulated.worlds.assembly import build_plan
from drivers.simulated.worlds.builder import MeshBuilder
from drivers.simulated.worlds.doors import Leaf
from drivers.simulated.worlds.free_space import clearance, mask_of, occupancy, occupancy_of, reachable
from drivers.simulated.worlds.plan import Plan, read_plan
from drivers.simulated.worlds.procedural import draw_plan
from drivers.simulated.worlds.surfaces import areas, structural_surfaces
from perception.failure import FailureError
from perception.grids import Grid
from tests.shared_data import BUILDINGS

TABLE_2 = {
    "room-1": (68.80, 96.60),
    "room-2": (48.16, 153.20),
    "room-3": (4.80, 21.92),
    "room-4": (3.84, 23.44),
    "room-5": (72.16, 87.60),
    "room-6": (45.76, 94.20),
}
SMALL = {
    "name": "small",
    "rooms": {
        "a": {"box": [0, 0, 5, 4], "seeded": {"desk": 3, "shelf": 2, "lamp": 2}},
        "b": {"box": [5.2, 0, 9, 4]},
    },
    "doors": [{"room": "a", "at": [5, 2], "width": 0.9}],
    "windows": [{"room": "b", "at": [7, 4], "width": 1.5, "height": 1.2}],
}


@pytest.fixture(scope="module")
def school() -> World:
    return load_world("school", 0)


def building(name: str) -> Path:
    path = BUILDINGS / name
    if not path.exists():
        pytest.skip(f"the shared building {name} is not on this machine")
    return path


def code_of(call, *args, **kwargs) -> str:
    with pytest.raises(FailureError) as caught:
        call(*args, **kwargs)
    return caught.value.failure.code


def rooms_joined_by_passable_doors(world: World) -> set[str]:
    """What the start's room is connected to, by the truth alone."""
    start = shapely.Point(world.start[:2])
    joined = {room.room_id for room in world.truth.rooms if shapely.Polygon(room.polygon).contains(start)}
    for _ in world.truth.doors:
        for door in world.truth.doors:
            if door.passable and joined & set(door.rooms):
                joined |= {room for room in door.rooms if room is not None}
    return joined


def test_the_school_has_the_areas_of_table_2(school: World) -> None:
    for room in school.truth.rooms:
        floor, walls = TABLE_2[room.room_id]
        measured = areas(*structural_surfaces(school, room.room_id))
        assert measured[Surface.FLOOR] == pytest.approx(floor, abs=0.01)
        assert measured[Surface.CEILING] == pytest.approx(floor, abs=0.01)
        assert measured[Surface.WALL] == pytest.approx(walls, rel=0.045)


def test_every_room_of_the_school_can_be_reached_from_a_start_that_sees_its_surroundings(school: World) -> None:
    assert set(reachable(school, 0.40)) == set(TABLE_2)
    distance = clearance(occupancy(school, (0.005, 2.0)))
    assert distance.data[tuple(distance.cells_of(school.start[:2]))] >= 1.5


def test_the_doors_of_the_school_are_wide_and_one_is_half_open(school: World) -> None:
    half = [door for door in school.truth.doors if door.state is DoorState.HALF]
    assert [door.width for door in half] == [1.2]
    rest = [door for door in school.truth.doors if door not in half]
    assert len(rest) == 4
    assert all(door.width >= 0.9 and door.net_width >= 0.8 and "room-2" in door.rooms for door in rest)


def test_structural_triangles_face_into_their_room(school: World) -> None:
    room = school.truth.room("room-1")
    corners, surface = structural_surfaces(school, "room-1")
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    ahead = corners.mean(axis=1) + 0.05 * normal
    assert shapely.contains_xy(shapely.Polygon(room.polygon), ahead[:, 0], ahead[:, 1]).all()
    assert (ahead[:, 2] > 0).all()
    assert (ahead[:, 2] < room.ceiling_z).all()
    assert set(surface) == {Surface.WALL, Surface.FLOOR, Surface.CEILING}


def test_a_world_survives_its_file(school: World, tmp_path: Path) -> None:
    save_world(school, tmp_path / "world.npz")
    loaded = load_world(str(tmp_path / "world.npz"))
    for name in ("vertices", "triangles", "surface"):
        assert np.array_equal(getattr(loaded, name), getattr(school, name))
    assert loaded.start == school.start
    assert loaded.truth.doors == school.truth.doors
    assert np.array_equal(loaded.truth.rooms[0].polygon, school.truth.rooms[0].polygon)


def test_a_file_that_is_no_world_is_refused(tmp_path: Path) -> None:
    (tmp_path / "world.npz").write_bytes(b"nothing of the kind")
    assert code_of(read_world, tmp_path / "world.npz") == "WORLD_UNREADABLE"
    listed = np.frombuffer(b"[1, 2]", np.uint8)
    np.savez(tmp_path / "world.npz", described=listed, vertices=[0.0], triangles=[0], surface=[0])
    assert code_of(read_world, tmp_path / "world.npz") == "WORLD_UNREADABLE"


@pytest.mark.parametrize("kept", [0.0, 0.1, 0.5, 0.99])
def test_a_world_that_was_cut_short_is_refused(school: World, tmp_path: Path, kept: float) -> None:
    save_world(school, tmp_path / "world.npz")
    content = (tmp_path / "world.npz").read_bytes()
    (tmp_path / "world.npz").write_bytes(content[: int(kept * len(content))])
    with pytest.raises(FailureError, match="expected a saved world, as a simulated mission leaves it"):
        read_world(tmp_path / "world.npz")


def test_a_world_with_bytes_that_changed_is_refused(school: World, tmp_path: Path) -> None:
    save_world(school, tmp_path / "world.npz")
    content = bytearray((tmp_path / "world.npz").read_bytes())
    for place in range(100, len(content), len(content) // 20):
        damaged = bytearray(content)
        damaged[place : place + 40] = bytes(byte ^ 0xFF for byte in content[place : place + 40])
        (tmp_path / "world.npz").write_bytes(damaged)
        assert code_of(read_world, tmp_path / "world.npz") == "WORLD_UNREADABLE", place


def test_the_seed_moves_the_furniture_and_nothing_else() -> None:
    plan = Plan.model_validate(SMALL)
    first, again, other = build_plan(plan, 1), build_plan(plan, 1), build_plan(plan, 2)
    assert np.array_equal(first.vertices, again.vertices)
    assert not np.array_equal(first.corners([Surface.FURNITURE]), other.corners([Surface.FURNITURE]))
    structure = [Surface.WALL, Surface.FLOOR, Surface.CEILING, Surface.GLASS, Surface.DOOR_LEAF]
    assert np.array_equal(np.sort(first.corners(structure), axis=0), np.sort(other.corners(structure), axis=0))


@pytest.mark.parametrize(
    "change",
    [
        {"doors": [{"room": "nowhere", "at": [5, 2]}]},
        {"doors": [{"room": "a", "at": [5, 3.9]}]},
        {"windows": [{"room": "a", "at": [5, 3.9], "width": 0.3}]},
        {"rooms": {**SMALL["rooms"], "b": {"box": [4, 0, 9, 4]}}},
        {"rooms": {**SMALL["rooms"], "b": {"box": [15, 0, 19, 4]}}},
        {"furniture": [{"kind": "desk", "at": [50, 50]}]},
        {"colour": "blue"},
    ],
    ids=["unknown room", "off the wall", "uneven wall", "overlap", "two buildings", "in no room", "unknown key"],
)
def test_a_plan_that_cannot_be_built_is_refused(change: dict, tmp_path: Path) -> None:
    import yaml

    path = tmp_path / "plan.yaml"
    path.write_text(yaml.safe_dump(SMALL | change))
    assert code_of(load_world, str(path)) == "WORLD_PLAN_INVALID"


def test_furniture_that_bars_the_robots_way_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.simulated.worlds.assembly.DRAWS", 1)
    barred = SMALL | {"furniture": [{"kind": "cupboard", "at": [4.5, 2.0], "yaw": 90, "size": [2.0, 0.5, 1.0]}]}
    assert code_of(build_plan, Plan.model_validate(barred), 0) == "WORLD_UNREACHABLE"


def test_a_room_that_the_world_does_not_have_is_refused(school: World) -> None:
    assert code_of(school.truth.room, "room-99") == "WORLD_NO_ROOM"


def test_the_errors_of_a_plan_name_their_keys_all_at_once(tmp_path: Path) -> None:
    path = tmp_path / "plan.yaml"
    path.write_text("name: x\nrooms: {a: {box: [0, 0, 1]}}\ndoors: [{room: a, at: [0, 0], width: -1}]\n")
    with pytest.raises(FailureError) as caught:
        read_plan(path)
    message = caught.value.failure.message
    assert "rooms.a.box" in message
    assert "doors.0.width" in message


@pytest.mark.parametrize("seed", [3, 9])
def test_a_procedural_building_can_be_driven_exactly_through_its_passable_doors(seed: int) -> None:
    world = load_world("procedural", seed)
    found = set(reachable(world))
    assert found == rooms_joined_by_passable_doors(world)
    assert 2 <= len(found) <= len(world.truth.rooms) <= 12


def test_procedural_plans_are_varied_and_repeatable() -> None:
    plans = [draw_plan(seed) for seed in range(20)]
    assert plans[7] == draw_plan(7)
    doors = [door for plan in plans for door in plan.doors]
    assert any(door.width < 0.7 for door in doors)
    assert any(door.angle == 0 for door in doors)
    assert any(50 < door.angle < 70 for door in doors)
    assert any(len(room.outline) > 4 for plan in plans for room in plan.rooms.values())
    assert all(any(getattr(plan, group) for plan in plans) for group in ("windows", "niches", "mirrors"))
    assert {len(plan.rooms) for plan in plans} >= {2, 4, 9, 11}
    assert len(draw_plan(0, rooms=6).rooms) == 6


@given(
    angle=st.floats(0.3, 2.9), opening=st.floats(0.6, 1.4), share=st.floats(0.3, 1.0), thickness=st.floats(0.05, 0.4)
)
@settings(max_examples=40, deadline=None)
def test_what_a_leaf_leaves_of_a_door_agrees_with_points_on_the_leaf(
    angle: float, opening: float, share: float, thickness: float
) -> None:
    leaf = Leaf(np.zeros(2), np.array([1.0, 0.0]), np.array([0.0, 1.0]), opening, thickness, share * opening, angle)
    x, y = (side.ravel() for side in np.meshgrid(np.linspace(0, leaf.width, 60), np.linspace(0, 0.04, 9)))
    # Shut, the leaf runs along +x within the wall (y < 0); opening turns it about the origin towards +y.
    turned = np.stack([x * np.cos(angle) + y * np.sin(angle), x * np.sin(angle) - y * np.cos(angle)], axis=1)
    assert leaf.net_width == pytest.approx(min(opening, opening - turned[:, 0].max()), abs=1e-6)
    reveal = np.stack([np.full(200, opening), -np.linspace(0, thickness, 200)], axis=1)
    nearest = np.linalg.norm(turned[:, None] - reveal[None], axis=2).min()
    assert leaf.clearance == pytest.approx(min(opening, nearest), abs=0.02)


@given(
    length=st.floats(2.0, 9.0),
    cuts=st.lists(
        st.tuples(st.floats(0.0, 0.9), st.floats(0.01, 0.2), st.floats(0.0, 1.5), st.floats(0.1, 1.4)), max_size=5
    ),
)
@settings(max_examples=20, deadline=None)
def test_a_wall_has_its_area_less_that_of_its_holes(length: float, cuts: list[tuple[float, ...]]) -> None:
    holes = [(u * length, z, min(length, (u + w) * length), z + h) for u, w, z, h in cuts]
    mesh = MeshBuilder()
    mesh.add_wall((1.0, 2.0), (1.0, 2.0 + length), (0.0, 3.0), holes, Surface.WALL)
    mesh.add_polygon(shapely.box(0, 0, 1, 1), 0.0, True, Surface.FLOOR)
    vertices, triangles, surface = mesh.build()
    whole = length * 3.0 - shapely.union_all([shapely.box(*hole) for hole in holes]).area
    assert areas(vertices[triangles], surface)[Surface.WALL] == pytest.approx(whole, rel=1e-3, abs=1e-2)


@given(st.integers(0, 10_000))
@settings(max_examples=20, deadline=None)
def test_occupancy_marks_the_cells_below_a_triangle_and_no_others(seed: int) -> None:
    rng = np.random.default_rng(seed)
    corners = rng.uniform(0, 2, (1, 3, 3))
    grid = occupancy_of(corners, (0.5, 1.5), 0.1, 0.5)
    weights = rng.dirichlet((1, 1, 1), 40_000)
    points = weights @ corners[0]
    points = points[(points[:, 2] > 0.5) & (points[:, 2] < 1.5)]
    marked = shapely.MultiPoint(grid.centres_of(np.argwhere(grid.data)))
    cells = grid.cells_of(points)
    # A cell that is only clipped at its corner may be missed, but never its neighbour as well.
    assert shapely.distance(marked, shapely.points(points[:5000, :2])).max(initial=0.0) < 0.125
    assert grid.data[cells[:, 0], cells[:, 1]].sum() >= 0.9 * len(points) - 50
    if len(points) > 5000:
        sample = shapely.MultiPoint(points[:5000, :2])
        assert shapely.distance(sample, shapely.points(grid.centres_of(np.argwhere(grid.data)))).max() < 0.25


def test_cells_of_a_polygon_lie_within_it_up_to_its_edge() -> None:
    frame = Grid(np.zeros((60, 60)), (-0.5, -0.5), 0.05)
    polygon = np.array([(0.0, 0.0), (2.0, 0.1), (1.5, 1.8), (0.2, 1.2)])
    centres = frame.centres_of(np.argwhere(mask_of(polygon, frame)))
    outline = shapely.Polygon(polygon)
    assert shapely.contains_xy(outline, centres[:, 0], centres[:, 1]).all()
    assert len(centres) * 0.05**2 > outline.buffer(-0.08).area


@pytest.fixture
def shoebox(tmp_path: Path) -> Path:
    """A room without a ceiling, 6 x 4 m, walls 2.5 m, floor at 0.3 m, y upwards, with a nameless crate."""
    import trimesh

    scene = trimesh.Scene()
    floor = trimesh.creation.box((6.4, 0.2, 4.4)).apply_translation((0, 0.2, 0))
    scene.add_geometry(floor, node_name="slab")
    for x, z, size in [
        (3.1, 0, (0.2, 2.5, 4.4)),
        (-3.1, 0, (0.2, 2.5, 4.4)),
        (0, 2.1, (6, 2.5, 0.2)),
        (0, -2.1, (6, 2.5, 0.2)),
    ]:
        scene.add_geometry(trimesh.creation.box(size).apply_translation((x, 1.55, z)), node_name=f"wall {x} {z}")
    scene.add_geometry(trimesh.creation.box((0.6, 0.6, 0.6)).apply_translation((2, 0.6, 1)), node_name="crate")
    path = tmp_path / "shoebox.glb"
    scene.export(path)
    return path


def test_a_mesh_is_stood_upright_with_its_floor_at_zero_and_a_ceiling_where_wanted(shoebox: Path) -> None:
    world = load_world(str(shoebox), up="y", ceiling=2.8)
    room = world.truth.room("building")
    assert room.ceiling_z == pytest.approx(2.5, abs=0.01)
    assert room.area == pytest.approx(24.0, rel=0.06)
    assert reachable(world) == ["building"]
    assert abs(world.start[0]) < 1
    assert abs(world.start[1]) < 0.7
    measured = areas(*structural_surfaces(world, "building"))
    assert measured[Surface.FLOOR] == pytest.approx(24.0, rel=0.06)
    assert measured[Surface.WALL] == pytest.approx(50.0, rel=0.06)
    assert measured[Surface.CEILING] == pytest.approx(24.0, rel=0.06)


def test_the_start_in_a_mesh_can_be_chosen(shoebox: Path) -> None:
    assert load_world(str(shoebox), up="y", start=(1.0, -1.0, 0.5)).start == (1.0, -1.0, 0.5)


@pytest.mark.parametrize("covered", [False, True], ids=["walls alone", "a floor under a block"])
def test_a_mesh_on_which_no_robot_can_stand_is_refused(covered: bool, tmp_path: Path) -> None:
    import trimesh

    block = trimesh.creation.box((1.9, 1.9, 0.8)).apply_translation((0.0, 0.0, 0.45))
    walls = trimesh.Trimesh(block.vertices, block.faces[np.abs(block.face_normals[:, 2]) < 0.5])
    floor = trimesh.creation.box((2.0, 2.0, 0.1))
    shape = trimesh.util.concatenate([floor, block]) if covered else walls
    shape.export(tmp_path / "shape.stl")
    assert code_of(load_world, str(tmp_path / "shape.stl")) == "WORLD_NO_FLOOR"


@pytest.mark.parametrize(
    ("spec", "options", "code"),
    [
        ("castle", {}, "WORLD_UNKNOWN"),
        ("missing.glb", {}, "WORLD_UNREADABLE"),
        ("school", {"ceiling": 3.0}, "WORLD_BAD_OPTION"),
        ("procedural", {"storey": "1"}, "WORLD_BAD_OPTION"),
    ],
)
def test_what_is_no_world_is_refused_with_its_reason(spec: str, options: dict, code: str) -> None:
    assert code_of(load_world, spec, **options) == code


def test_a_scanned_office_without_names_for_its_rooms_has_one_large_floor() -> None:
    world = load_world(str(building("avz_rmcl.glb")), ceiling=2.8)
    assert reachable(world) == ["building"]
    assert world.truth.rooms[0].area > 300
    assert world.vertices[:, 2].min() < 0 < world.vertices[:, 2].max()


def test_an_ifc_storey_has_its_spaces_and_doors() -> None:
    pytest.importorskip("ifcopenshell", reason="the extra [ifc] is not installed")
    world = load_world(str(building("AC20-FZK-Haus.ifc")), seed=0)
    assert {room.room_id for room in world.truth.rooms} == {"Flur", "Bad", "Buero", "Schlafzimmer", "Wohnen", "Küche"}
    doors = {door.door_id: door for door in world.truth.doors}
    assert len(doors) == 5
    assert doors["Haustuer"].state is doors["Terrassentuer"].state is DoorState.SHUT
    assert set(doors["Innentuer-2"].rooms) == {"Flur", "Bad"}
    assert doors["Innentuer-2"].thickness == pytest.approx(0.24, abs=0.01)
    ceiling = areas(*structural_surfaces(world, "Wohnen"))[Surface.CEILING]
    assert ceiling == pytest.approx(world.truth.room("Wohnen").area, rel=0.03)


def test_an_ifc_without_the_wanted_storey_is_refused_with_those_there_are(tmp_path: Path) -> None:
    ifcopenshell = pytest.importorskip("ifcopenshell", reason="the extra [ifc] is not installed")
    model = ifcopenshell.file(schema="IFC4")
    model.create_entity("IfcBuildingStorey", GlobalId=ifcopenshell.guid.new(), Name="Attic")
    model.write(str(tmp_path / "house.ifc"))
    with pytest.raises(FailureError, match=r"WORLD_NO_STOREY.*Attic"):
        load_world(str(tmp_path / "house.ifc"), storey="Cellar")


def test_without_ifcopenshell_the_error_names_the_extra(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(__import__("sys").modules, "ifcopenshell", None)
    (tmp_path / "house.ifc").write_text("")
    with pytest.raises(FailureError, match=r"\[ifc\]") as caught:
        load_world(str(tmp_path / "house.ifc"))
    assert caught.value.failure.code == "WORLD_NEEDS_EXTRA"
