"""Worlds to simulate a mission in: the school, a user's plan, procedural buildings, meshes and IFC models."""

import inspect
from collections.abc import Callable
from pathlib import Path

from drivers.simulated.world import World, read_world
from drivers.simulated.worlds.assembly import build_plan
from drivers.simulated.worlds.ifc import load_ifc
from drivers.simulated.worlds.mesh import SUFFIXES, load_mesh
from drivers.simulated.worlds.plan import read_plan
from drivers.simulated.worlds.procedural import draw_plan
from perception.failure import FailureError

SCHOOL = Path(__file__).with_name("school.yaml")


def load_world(spec: str, seed: int = 0, **options: object) -> World:
    """The world of a name or a file; the same for the same arguments.

    Args:
        spec: ``school``, ``procedural``, or the path of a plan (.yaml), a mesh (.obj, .ply, .glb, .stl), a model
            (.ifc) or a saved world (.npz).
        seed: of the furniture, of a procedural building, of the doors' states in a model.
        options: ``rooms`` (procedural); ``up``, ``ceiling``, ``floor``, ``start`` (mesh, :func:`mesh.load_mesh`);
            ``storey``, ``start`` (model, :func:`ifc.load_ifc`).

    Raises:
        FailureError: ``WORLD_UNKNOWN``, ``WORLD_BAD_OPTION``, ``WORLD_UNREADABLE``, ``WORLD_PLAN_INVALID``,
            ``WORLD_UNREACHABLE``, ``WORLD_NO_FLOOR``, ``WORLD_NO_STOREY``, ``WORLD_NEEDS_EXTRA``.
    """
    if spec == "school":
        return _with_options(lambda: build_plan(read_plan(SCHOOL), seed), spec, options)
    if spec == "procedural":
        return _with_options(lambda rooms=None: build_plan(draw_plan(seed, rooms), seed), spec, options)
    path = Path(spec)
    suffix = path.suffix.lower()
    known = (".yaml", ".yml", ".npz", ".ifc", *SUFFIXES)
    if suffix not in known:
        raise FailureError("WORLD_UNKNOWN", f"'{spec}' is neither school, procedural nor a file of {', '.join(known)}")
    if not path.is_file():
        raise FailureError("WORLD_UNREADABLE", f"there is no file {path}", path=spec)
    if suffix in SUFFIXES:
        return _with_options(lambda **given: load_mesh(path, **given), spec, options, load_mesh)
    if suffix == ".ifc":
        return _with_options(lambda **given: load_ifc(path, seed, **given), spec, options, load_ifc)
    if suffix == ".npz":
        return _with_options(lambda: read_world(path), spec, options)
    return _with_options(lambda: build_plan(read_plan(path), seed), spec, options)


def _with_options(
    load: Callable[..., World], spec: str, options: dict[str, object], described: Callable[..., World] | None = None
) -> World:
    """Load with those options that are given; refuse what this kind of world does not know."""
    parameters = inspect.signature(described or load).parameters
    taken = [name for name in parameters if name not in ("path", "seed")]
    given = {name: value for name, value in options.items() if value is not None}
    strange = sorted(set(given) - set(taken))
    if strange:
        raise FailureError(
            "WORLD_BAD_OPTION",
            f"'{spec}' knows no option {', '.join(strange)}; it takes {', '.join(taken) or 'none'}",
            options=strange,
        )
    return load(**given)
