"""Commands that begin a mission."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mission.commands.common import Json, Out, conclude, display, refuse

if TYPE_CHECKING:
    from mission.run import Summary

Overrides = Annotated[list[str] | None, typer.Option("--set", help="Override a setting: settings.room.max_scans=8")]


def simulate(
    world: Annotated[str, typer.Argument(help="school, procedural, a plan .yaml, or a mesh .glb .obj .ply .stl .ifc")],
    seed: Annotated[int, typer.Option(help="Seed of furniture, noise, drift and slips.")] = 0,
    step: Annotated[float, typer.Option(help="Angle between beams, degrees.", min=0.01, max=5.0)] = 0.2,
    profile: Annotated[str, typer.Option(help="Scanner: vz-400 or vz-400i.")] = "vz-400",
    speed: Annotated[float, typer.Option(help="Simulated seconds for one second of the wall.", min=0.1)] = 10.0,
    scenario: Annotated[Path | None, typer.Option(help="YAML of people in the way and faults.")] = None,
    up: Annotated[str | None, typer.Option(help="Mesh only: its up axis, z or y.")] = None,
    floor: Annotated[float | None, typer.Option(help="Mesh only: height of the floor in the file, metres.")] = None,
    ceiling: Annotated[float | None, typer.Option(help="Mesh only: height of a ceiling to add, metres.")] = None,
    storey: Annotated[str | None, typer.Option(help="IFC only: the storey, by name.")] = None,
    start: Annotated[str | None, typer.Option(help="Mesh and IFC: where the robot begins, x,y,yaw in degrees.")] = None,
    attended: Annotated[bool, typer.Option("--attended", help="Wait for an operator's answers.")] = False,
    out: Out = Path("runs"),
    overrides: Overrides = None,
    as_json: Json = False,
) -> None:
    """Rehearse a mission in a simulated building, through real sockets and processes, to its report."""
    from mission.rehearsal import Rehearsal, rehearse

    options = {"up": up, "floor": floor, "ceiling": ceiling, "storey": storey, "start": _start(start)}
    plan = Rehearsal(
        world=world,
        seed=seed,
        step_deg=step,
        profile=profile,
        speed=speed,
        scenario=scenario,
        attended=attended,
        overrides=tuple(overrides or ()),
        options={key: value for key, value in options.items() if value is not None},
    )
    conclude(lambda: rehearse(plan, out, display(as_json)), as_json)


def run(
    site: Annotated[Path, typer.Argument(help="The site's configuration, YAML.")],
    unattended: Annotated[bool, typer.Option("--unattended", help="Ask nobody: take every default at once.")] = False,
    out: Out = Path("runs"),
    overrides: Overrides = None,
    as_json: Json = False,
) -> None:
    """Run a mission with agents that are already up."""
    from mission.config import load_config
    from mission.run import run_mission
    from mission.store import RunFolder

    def mission() -> "Summary":
        alone = ["settings.operator.ask=false"] if unattended else []
        config = load_config(site, [*(overrides or ()), *alone])
        folder = RunFolder.create(out, config.site)
        return run_mission(config, folder, display(as_json))

    conclude(mission, as_json)


def _start(text: str | None) -> tuple[float, float, float] | None:
    """``x,y,yaw`` with the yaw in degrees."""
    if text is None:
        return None
    try:
        x, y, yaw = (float(part) for part in text.split(","))
    except ValueError:
        refuse(f"--start: expected x,y,yaw, found '{text}'")
    return x, y, math.radians(yaw)
