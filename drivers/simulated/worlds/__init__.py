"""Worlds to simulate a mission in: the school, a user's plan, procedural buildings, meshes and IFC models."""

from pathlib import Path

from drivers.simulated.world import World
from drivers.simulated.worlds.assembly import build_plan
from drivers.simulated.worlds.plan import read_plan

SCHOOL = Path(__file__).with_name("school.yaml")


def load_world(spec: str, seed: int = 0, **options: object) -> World:
    """."""
    return build_plan(read_plan(SCHOOL), seed)
