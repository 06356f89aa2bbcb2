"""The ``mission`` command. Every command loads what it needs when it is called, so that ``--help`` answers at once."""

import json
import math
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

if TYPE_CHECKING:
    from mission.run import Summary

EXIT_CODES = {"complete": 0, "incomplete": 3, "aborted": 4, "safety_stop": 5, "fault": 1}
USAGE, UNREACHABLE = 2, 6

app = typer.Typer(
    help="A robot with a laser scanner scans a building by itself.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
agent = typer.Typer(
    help="Start an agent: the process on the scanner's or on the base's computer.", no_args_is_help=True
)
app.add_typer(agent, name="agent")

Json = Annotated[bool, typer.Option("--json", help="One JSON object on stdout; words go to stderr.")]
Out = Annotated[Path, typer.Option("--out", help="Folder that run folders are made in.")]
Overrides = Annotated[list[str] | None, typer.Option("--set", help="Override a setting: settings.room.max_scans=8")]


@app.command()
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
        overrides=tuple(overrides or ()),
        options={key: value for key, value in options.items() if value is not None},
    )
    _finish(lambda: rehearse(plan, out, _display(as_json)), as_json)


@app.command()
def run(
    site: Annotated[Path, typer.Argument(help="The site's configuration, YAML.")],
    out: Out = Path("runs"),
    overrides: Overrides = None,
    as_json: Json = False,
) -> None:
    """Run a mission with agents that are already up."""
    from mission.config import load_config
    from mission.finish import finish
    from mission.run import run_mission
    from mission.store import RunFolder

    def mission() -> "Summary":
        config = load_config(site, overrides or ())
        folder = RunFolder.create(out, config.site)
        summary = run_mission(config, folder, _display(as_json))
        finish(folder)
        return summary

    _finish(mission, as_json)


@app.command()
def tree(
    form: Annotated[str, typer.Option("--format", help="unicode, dot, svg or png.")] = "unicode",
    out: Annotated[Path | None, typer.Option(help="File for svg and png.")] = None,
) -> None:
    """Draw the behaviour tree; no robot is needed."""
    from mission import drawing
    from trees.building import create_root

    root = create_root()
    if form == "unicode":
        typer.echo(drawing.as_text(root))
    elif form == "dot":
        typer.echo(drawing.as_dot(root))
    elif form in ("svg", "png"):
        path = out or Path(f"tree.{form}")
        drawing.draw(root, path)
        typer.echo(path)
    else:
        _refuse(f"--format: expected unicode, dot, svg or png, found '{form}'")


@app.command()
def report(run_folder: Annotated[Path, typer.Argument(help="A run folder.")]) -> None:
    """Write report.html and report.json of a run again, with its pictures."""
    from mission.report import write_report

    with _refusals():
        typer.echo(write_report(_existing(run_folder)))


@app.command()
def evaluate(
    run_folder: Annotated[Path, typer.Argument(help="The run folder of a simulated mission.")],
    world: Annotated[
        str | None, typer.Option(help="World as simulate takes it; by default the one the run was simulated in.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Compare a simulated mission with the truth: poses, rooms, doors, and how much was sensed."""
    from mission.evaluation import evaluate_run

    with _refusals():
        evaluation = evaluate_run(_existing(run_folder), world)
    typer.echo(json.dumps(evaluation.summary(), indent=None if as_json else 2))


@app.command()
def process(
    folder: Annotated[Path, typer.Argument(help="A folder of scans: .3d with .pose, .ply, .pcd.")],
    out: Out = Path("runs"),
    as_json: Json = False,
) -> None:
    """Put scans that somebody took through the stages of the paper: align, register, map, label; to a report."""
    from mission.process import process_folder

    with _refusals():
        result = process_folder(_existing(folder), out)
    typer.echo(json.dumps(result, indent=None if as_json else 2))


@app.command()
def doctor(
    site: Annotated[Path | None, typer.Argument(help="A site's configuration to check as well.")] = None,
    as_json: Json = False,
) -> None:
    """Look whether this machine, and a site's agents, are fit for a mission."""
    from mission.doctor import examine

    findings = examine(site)
    if as_json:
        typer.echo(json.dumps([asdict(finding) for finding in findings]))
    else:
        for finding in findings:
            typer.echo(f"{'ok  ' if finding.good else 'FAIL'}  {finding.what}: {finding.found}")
    raise typer.Exit(0 if all(finding.good for finding in findings) else 1)


@agent.command("scanner")
def agent_scanner(
    world: Annotated[Path, typer.Option(help="World file of the simulation.")],
    truth: Annotated[Path, typer.Option(help="Folder for the truth log.")],
    plant: Annotated[str, typer.Option(help="Endpoint of the simulated base's side channel.")],
    control: Annotated[str, typer.Option(help="Endpoint to listen on.")] = "tcp://127.0.0.1:5601",
    bulk: Annotated[str, typer.Option(help="Endpoint for scan data.")] = "tcp://127.0.0.1:5602",
    profile: str = "vz-400",
    seed: int = 0,
    speed: float = 1.0,
    scenario: Path | None = None,
) -> None:
    """The simulated scanner's agent."""
    from drivers.simulated.agents import run_scanner_agent
    from drivers.wire.endpoints import Endpoints

    with _refusals():
        run_scanner_agent(world, truth, plant, Endpoints(control, bulk), profile, seed, speed, scenario)


@agent.command("base")
def agent_base(
    world: Annotated[Path, typer.Option(help="World file of the simulation.")],
    truth: Annotated[Path, typer.Option(help="Folder for the truth log.")],
    plant: Annotated[str, typer.Option(help="Endpoint of the side channel to the simulated scanner.")],
    control: Annotated[str, typer.Option(help="Endpoint to listen on.")] = "tcp://127.0.0.1:5611",
    telemetry: Annotated[str, typer.Option(help="Endpoint to publish on.")] = "tcp://127.0.0.1:5612",
    seed: int = 0,
    speed: float = 1.0,
    scenario: Path | None = None,
) -> None:
    """The simulated base's agent."""
    from drivers.simulated.agents import run_base_agent
    from drivers.wire.endpoints import Endpoints

    with _refusals():
        run_base_agent(world, truth, plant, Endpoints(control, telemetry=telemetry), seed, speed, scenario)


def main() -> None:
    """Entry point of the ``mission`` command."""
    app()


def _finish(mission: Any, as_json: bool) -> None:
    """Run a mission, print its summary, and leave with the exit code of its outcome."""
    from mission.run import UnreachableError

    # Before the tick loop listens to the signals, and after it, both end the command the same way.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with _refusals():
            summary = mission()
    except UnreachableError as error:
        typer.echo(f"unreachable: {error}", err=True)
        raise typer.Exit(UNREACHABLE) from error
    except KeyboardInterrupt as interrupt:
        typer.echo("aborted", err=True)
        raise typer.Exit(EXIT_CODES["aborted"]) from interrupt
    if as_json:
        typer.echo(json.dumps(asdict(summary)))
    else:
        rooms = ", ".join(f"{room['id']} ({room['scans']} scans, {room['reason_ended']})" for room in summary.rooms)
        typer.echo(f"{summary.outcome}: {len(summary.rooms)} rooms, {summary.scans} scans in {summary.wall_s:.0f} s")
        typer.echo(rooms)
        typer.echo(f"{summary.run}/report.html")
    raise typer.Exit(EXIT_CODES[summary.outcome])


@contextmanager
def _refusals() -> Iterator[None]:
    """What a command was given and cannot use ends it with one plain message instead of a traceback."""
    from mission.config import ConfigError
    from perception.failure import FailureError

    try:
        yield
    except (ConfigError, FailureError) as error:
        _refuse(str(error))


def _display(as_json: bool) -> Any:
    from mission.display import Display

    return Display.for_terminal(quiet=as_json and not sys.stderr.isatty())


def _start(text: str | None) -> tuple[float, float, float] | None:
    """``x,y,yaw`` with the yaw in degrees."""
    if text is None:
        return None
    try:
        x, y, yaw = (float(part) for part in text.split(","))
    except ValueError:
        _refuse(f"--start: expected x,y,yaw, found '{text}'")
    return x, y, math.radians(yaw)


def _existing(folder: Path) -> Path:
    if not folder.is_dir():
        _refuse(f"{folder}: expected a folder, found {'a file' if folder.exists() else 'nothing'}")
    return folder


def _refuse(message: str) -> Any:
    typer.echo(message, err=True)
    raise typer.Exit(USAGE)
