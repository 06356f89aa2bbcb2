"""From a plan and a seed to a world: the shell, the furniture that leaves every room reachable, the outside."""

import numpy as np
import shapely

from drivers.simulated.world import Surface, Truth, World
from drivers.simulated.worlds.builder import MeshBuilder
from drivers.simulated.worlds.free_space import reachable
from drivers.simulated.worlds.furnishing import Gap, RoomFurnisher
from drivers.simulated.worlds.furniture import SIZES, Piece
from drivers.simulated.worlds.plan import OutsidePlan, PiecePlan, Plan
from drivers.simulated.worlds.shell import Shell
from perception.failure import FailureError

VERIFIED_RADIUS = 0.40
DRAWS = 8
GROUND_Z = -0.3
GROUND_MARGIN = 30.0


def build_plan(plan: Plan, seed: int) -> World:
    """The building of a plan with the furniture of a seed.

    Furniture that keeps a disc of 0.40 m radius out of a room behind passable doors is drawn again.

    Raises:
        FailureError: ``WORLD_PLAN_INVALID``; ``WORLD_UNREACHABLE`` when no draw leaves the robot its way.
    """
    shell = Shell(plan)
    structure = MeshBuilder()
    shell.build(structure)
    for item in plan.outside:
        _add_outside(structure, item)
    _add_ground(structure, shell.hull)
    bare = _world(plan, seed, shell, structure, [], _start(plan, shell))
    possible = reachable(bare, VERIFIED_RADIUS)
    for draw in range(DRAWS):
        pieces = _furnish(plan, shell, bare.start, np.random.default_rng([seed, draw]))
        world = _world(plan, seed, shell, structure, pieces, bare.start)
        if reachable(world, VERIFIED_RADIUS) == possible:
            return world
    raise FailureError("WORLD_UNREACHABLE", f"{plan.name}: no furniture of seed {seed} leaves the robot its way")


def _world(
    plan: Plan,
    seed: int,
    shell: Shell,
    structure: MeshBuilder,
    pieces: list[Piece],
    start: tuple[float, float, float],
) -> World:
    mesh = structure.copy()
    for piece in pieces:
        piece.build(mesh)
    truth = Truth(shell.truth_rooms(), tuple(shell.doors))
    return World(f"{plan.name} #{seed}", *mesh.build(), start=start, truth=truth)


def _start(plan: Plan, shell: Shell) -> tuple[float, float, float]:
    """The start of the plan, or the middle of its most spacious room."""
    if plan.start is not None:
        return (*plan.start.at, float(np.deg2rad(plan.start.yaw)))
    widest = max(shell.rooms.values(), key=lambda room: float(shapely.maximum_inscribed_circle(room).length))
    leaves = shapely.union_all([leaf.footprint for _, leaf in shell.leaves])
    x, y = shapely.maximum_inscribed_circle(widest.difference(leaves)).coords[0]
    return x, y, 0.0


def _furnish(plan: Plan, shell: Shell, start: tuple[float, float, float], rng: np.random.Generator) -> list[Piece]:
    for item in plan.furniture:
        if not any(outline.covers(shapely.Point(item.at)) for outline in shell.rooms.values()):
            raise FailureError("WORLD_PLAN_INVALID", f"the {item.kind} at {item.at} is in no room", at=item.at)
    pieces: list[Piece] = []
    for name, outline in shell.rooms.items():
        placed = [
            _placed(item, shell.heights[name]) for item in plan.furniture if outline.covers(shapely.Point(item.at))
        ]
        here = start[:2] if outline.covers(shapely.Point(start[:2])) else None
        leaves = [leaf.footprint for room, leaf in shell.leaves if room == name]
        furnisher = RoomFurnisher(outline, shell.heights[name], _gaps(shell, name), leaves, placed, here)
        furnisher.furnish({str(kind): count for kind, count in plan.rooms[name].seeded.items()}, rng)
        pieces += furnisher.pieces
    return pieces


def _gaps(shell: Shell, room: str) -> list[Gap]:
    """The holes in the faces of a room, as the furnisher needs them."""
    gaps = []
    for face in shell.faces:
        if face.room == room:
            for u0, z0, u1, _ in face.holes:
                x, y = face.at((u0 + u1) / 2)
                normal = (float(face.normal[0]), float(face.normal[1]))
                gaps.append(Gap(float(x), float(y), normal, u1 - u0, z0, z0 == 0.0))
    return gaps


def _placed(item: PiecePlan, ceiling: float) -> Piece:
    size = item.size or SIZES[item.kind]
    hangs = {"lamp": ceiling - size[2], "beam": ceiling - size[2], "board": 0.9, "radiator": 0.12, "curtain": 0.08}
    return Piece(item.kind, *item.at, float(np.deg2rad(item.yaw)), hangs.get(item.kind, 0.0), size)


def _add_outside(mesh: MeshBuilder, item: OutsidePlan) -> None:
    length, depth, height = item.size
    pose = (*item.at, float(np.deg2rad(item.yaw)))
    if item.kind == "facade":
        mesh.add_box((-length / 2, -depth / 2, GROUND_Z), (length / 2, depth / 2, height), Surface.OTHER, pose)
        return
    mesh.add_box((-0.15, -0.15, GROUND_Z), (0.15, 0.15, height / 2), Surface.OTHER, pose)
    mesh.add_box((-length / 2, -depth / 2, height / 2), (length / 2, depth / 2, height), Surface.OTHER, pose)
    turned = (*item.at, pose[2] + np.pi / 4)
    mesh.add_box((-length / 2, -depth / 2, height * 0.6), (length / 2, depth / 2, height * 0.9), Surface.OTHER, turned)


def _add_ground(mesh: MeshBuilder, hull: shapely.Polygon) -> None:
    ground = shapely.box(*hull.buffer(GROUND_MARGIN).bounds)
    mesh.add_polygon(ground, GROUND_Z, True, Surface.OTHER)
