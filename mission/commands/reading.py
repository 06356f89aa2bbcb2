"""Commands that look at what a mission left, or at scans that somebody took."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from mission.commands.common import Json, Out, RunArgument, existing, refusals


def fsck(run_folder: RunArgument, as_json: Json = False) -> None:
    """Look whether a run folder is whole: 0 clean, 3 something is lost but the rest is usable, 1 unusable.

    Nothing is changed, so the folder may lie on read-only media. A mission that is running is refused with 2.
    """
    from mission.fsck import check
    from mission.store import RunFolder

    with refusals():
        found = check(RunFolder(existing(run_folder)))
    if as_json:
        typer.echo(json.dumps(asdict(found) | {"next": found.next_step}))
    else:
        for words in (*found.unusable, *found.lost, *found.only_shown, *found.log):
            typer.echo(f"LOST  {words}")
        for words in found.left_over:
            typer.echo(f"left over  {words}")
        typer.echo(f"{found.scans} scans and {found.files} other files looked at")
        typer.echo(f"next: {found.next_step}" if found.next_step else "clean")
    raise typer.Exit(found.exit_code)


def report(run_folder: Annotated[Path, typer.Argument(help="A run folder.")]) -> None:
    """Write report.html and report.json of a run again, with its pictures; cloud and map too if they are missing."""
    from mission.finish import report_again
    from mission.store import RunFolder

    folder = RunFolder(existing(run_folder))
    with refusals():
        whole = report_again(folder)
    typer.echo(folder.report)
    raise typer.Exit(0 if whole else 1)


def evaluate(
    run_folder: Annotated[Path, typer.Argument(help="The run folder of a simulated mission.")],
    world: Annotated[
        str | None, typer.Option(help="World as simulate takes it; by default the one the run was simulated in.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Compare a simulated mission with the truth: poses, rooms, doors, and how much was sensed."""
    from mission.evaluation import evaluate_run

    with refusals():
        evaluation = evaluate_run(existing(run_folder), world)
    typer.echo(json.dumps(evaluation.summary(), indent=None if as_json else 2))


def process(
    folder: Annotated[Path, typer.Argument(help="A folder of scans: E57, PLY, PCD, PTX, LAS, LAZ, XYZ, CSV, 3DTK.")],
    out: Out = Path("runs"),
    as_json: Json = False,
) -> None:
    """Put scans that somebody took through the stages of the paper: align, register, map, label; to a report."""
    from mission.process import process_folder

    with refusals():
        result = process_folder(existing(folder), out)
    typer.echo(json.dumps(result, indent=None if as_json else 2))
