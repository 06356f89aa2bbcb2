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
USAGE, UNREACHABLE, NO_GO = 2, 6, 7

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
Keys = Annotated[Path | None, typer.Option("--keys", help="Folder of this computer's keys.")]
Serves = Annotated[
    Path | None,
    typer.Option("--serves", help="File that names the process of the one mission it is for; it ends 10 min after it."),
]
RunArgument = Annotated[Path, typer.Argument(metavar="RUN", help="The mission's run folder.")]
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
    _finish(lambda: rehearse(plan, out, _display(as_json)), as_json)


@app.command()
def run(
    site: Annotated[Path, typer.Argument(help="The site's configuration, YAML.")],
    unattended: Annotated[bool, typer.Option("--unattended", help="Ask nobody: take every default at once.")] = False,
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
        alone = ["settings.operator.ask=false"] if unattended else []
        config = load_config(site, [*(overrides or ()), *alone])
        folder = RunFolder.create(out, config.site)
        summary = run_mission(config, folder, _display(as_json))
        finish(folder)
        return summary

    _finish(mission, as_json)


@app.command()
def pause(run_folder: RunArgument, as_json: Json = False) -> None:
    """Let a running mission stand still; a scan under way is finished."""
    from mission.control import Pause

    _order(run_folder, Pause(), as_json)


@app.command()
def resume(
    run_folder: RunArgument,
    auto: Annotated[bool, typer.Option("--auto-resume", help="Go on at once instead of waiting, paused.")] = False,
    as_json: Json = False,
) -> None:
    """Let a paused mission go on; take up one whose executive died, from its ledger: it waits, paused, to be told."""
    from mission.control import Resume, is_live

    if is_live(_existing(run_folder)):
        _order(run_folder, Resume(), as_json)
        return
    from mission.resume import resume_run

    _finish(lambda: resume_run(run_folder, _display(as_json), auto), as_json)


@app.command()
def fsck(run_folder: RunArgument, as_json: Json = False) -> None:
    """Look whether a run folder is whole: 0 clean, 3 something is lost but the rest is usable, 1 unusable."""
    from mission.fsck import check
    from mission.store import RunFolder

    found = check(RunFolder(_existing(run_folder)))
    if as_json:
        typer.echo(json.dumps(asdict(found)))
    else:
        for words in (*found.unusable, *found.lost):
            typer.echo(f"LOST  {words}")
        for words in found.left_over:
            typer.echo(f"left over  {words}")
        typer.echo(f"{found.scans} scans looked at")
    raise typer.Exit(found.exit_code)


@app.command()
def abort(run_folder: RunArgument, as_json: Json = False) -> None:
    """End a running mission safely: the base stops, a scan under way is given up, all data are kept."""
    from mission.control import Abort

    _order(run_folder, Abort(), as_json)


@app.command()
def answer(
    run_folder: RunArgument,
    question: Annotated[str, typer.Argument(help="The question's name, as `mission status` shows it.")],
    word: Annotated[str, typer.Argument(help="One of its options.")],
    as_json: Json = False,
) -> None:
    """Answer a question that a running mission asks."""
    from mission.control import AnswerQuestion

    _order(run_folder, AnswerQuestion(question, word), as_json)


@app.command()
def status(run_folder: RunArgument, as_json: Json = False) -> None:
    """Tell what a mission is doing, and what it asks; of one that has ended, how."""
    from mission.control import AskStatus, is_live
    from mission.standing import standing_of_ended
    from mission.store import RunFolder

    if is_live(_existing(run_folder)):
        _order(run_folder, AskStatus(), as_json)
        return
    with _refusals():
        told = standing_of_ended(RunFolder(run_folder))
    typer.echo(json.dumps(told.figures) if as_json else told.words)


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
    folder: Annotated[Path, typer.Argument(help="A folder of scans: E57, PLY, PCD, PTX, LAS, LAZ, XYZ, CSV, 3DTK.")],
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
            typer.echo(f"{finding.mark:4}  {finding.what}: {finding.found}")
    raise typer.Exit(0 if all(finding.good for finding in findings) else 1)


@app.command()
def keys(folder: Keys = None, as_json: Json = False) -> None:
    """Show this computer's public key, made on the first call, and whose keys may come in."""
    from mission.keys import as_text, describe, keyring_in

    with _refusals():
        found = describe(keyring_in(folder))
    typer.echo(json.dumps(found) if as_json else as_text(found))


@app.command()
def pair(
    key: Annotated[str, typer.Argument(help="Public key, as `mission keys` prints it on the other computer.")],
    role: Annotated[str, typer.Option(help="observer, operator or executive.")],
    name: Annotated[str, typer.Option(help="A name for it.")],
    folder: Keys = None,
) -> None:
    """Let another computer command the agents of this one."""
    from mission.keys import keyring_in, pair

    with _refusals():
        typer.echo(pair(keyring_in(folder), key, role, name))


@app.command()
def unpair(name: Annotated[str, typer.Argument(help="The name it was paired by.")], folder: Keys = None) -> None:
    """Let a computer in no more."""
    from mission.keys import keyring_in, unpair

    with _refusals():
        typer.echo(unpair(keyring_in(folder), name))


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
    keys: Keys = None,
    serves: Serves = None,
) -> None:
    """The simulated scanner's agent."""
    from drivers.simulated.agents import run_scanner_agent
    from drivers.wire.endpoints import Endpoints

    with _refusals():
        run_scanner_agent(world, truth, plant, Endpoints(control, bulk), profile, seed, speed, scenario, keys, serves)


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
    keys: Keys = None,
    serves: Serves = None,
) -> None:
    """The simulated base's agent."""
    from drivers.simulated.agents import run_base_agent
    from drivers.wire.endpoints import Endpoints

    with _refusals():
        listens = Endpoints(control, telemetry=telemetry)
        run_base_agent(world, truth, plant, listens, seed, speed, scenario, keys, serves)


def main() -> None:
    """Entry point of the ``mission`` command."""
    app()


def _order(run_folder: Path, body: Any, as_json: bool) -> None:
    """Ask the executive of a run folder, and show what it acknowledged."""
    from mission.control import order
    from mission.standing import standing_of

    with _refusals():
        told = standing_of(order(_existing(run_folder), body))
    typer.echo(json.dumps(told.figures) if as_json else told.words)


def _finish(mission: Any, as_json: bool) -> None:
    """Run a mission, print its summary, and leave with the exit code of its outcome."""
    from mission.preflight import NoGoError, UnreachableError

    # Before the tick loop listens to the signals, and after it, both end the command the same way.
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        with _refusals():
            summary = mission()
    except UnreachableError as error:
        typer.echo(f"unreachable: {error}", err=True)
        raise typer.Exit(UNREACHABLE) from error
    except NoGoError as error:
        typer.echo(f"no-go:\n{error}", err=True)
        raise typer.Exit(NO_GO) from error
    except KeyboardInterrupt as interrupt:
        typer.echo("aborted", err=True)
        raise typer.Exit(EXIT_CODES["aborted"]) from interrupt
    if as_json:
        typer.echo(json.dumps(asdict(summary)))
    else:
        rooms = ", ".join(f"{room['id']} ({room['scans']} scans, {room['reason_ended']})" for room in summary.rooms)
        typer.echo(f"{summary.outcome}: {len(summary.rooms)} rooms, {summary.scans} scans in {summary.wall_s:.0f} s")
        if summary.reason:
            typer.echo(summary.reason)
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
