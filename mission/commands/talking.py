"""Commands to a mission that runs, or that can be taken up again."""

import json
from pathlib import Path
from typing import Annotated, Any

import typer

from mission.commands.common import Json, RunArgument, conclude, display, existing, refusals


def status(run_folder: RunArgument, as_json: Json = False) -> None:
    """Tell what a mission is doing, and what it asks; of one that has ended, how."""
    from mission.control import AskStatus, is_live
    from mission.standing import standing_of_ended
    from mission.store import RunFolder

    if is_live(existing(run_folder)):
        _order(run_folder, AskStatus(), as_json)
        return
    with refusals():
        told = standing_of_ended(RunFolder(run_folder))
    typer.echo(json.dumps(told.figures) if as_json else told.words)


def pause(run_folder: RunArgument, as_json: Json = False) -> None:
    """Let a running mission stand still; a scan under way is finished."""
    from mission.control import Pause

    _order(run_folder, Pause(), as_json)


def resume(
    run_folder: RunArgument,
    auto: Annotated[bool, typer.Option("--auto-resume", help="Go on at once instead of waiting, paused.")] = False,
    as_json: Json = False,
) -> None:
    """Let a paused mission go on; take up one whose executive died, from its ledger: it waits, paused, to be told."""
    from mission.control import Resume, is_live

    if is_live(existing(run_folder)):
        _order(run_folder, Resume(), as_json)
        return
    from mission.resume import resume_run

    conclude(lambda: resume_run(run_folder, display(as_json), auto), as_json)


def answer(
    run_folder: RunArgument,
    question: Annotated[str, typer.Argument(help="The question's name, as `mission status` shows it.")],
    word: Annotated[str, typer.Argument(help="One of its options.")],
    as_json: Json = False,
) -> None:
    """Answer a question that a running mission asks."""
    from mission.control import AnswerQuestion

    _order(run_folder, AnswerQuestion(question, word), as_json)


def abort(run_folder: RunArgument, as_json: Json = False) -> None:
    """End a running mission safely: the base stops, a scan under way is given up, all data are kept."""
    from mission.control import Abort

    _order(run_folder, Abort(), as_json)


def _order(run_folder: Path, body: Any, as_json: bool) -> None:
    """Ask the executive of a run folder, and show what it acknowledged."""
    from mission.control import order
    from mission.standing import standing_of

    with refusals():
        told = standing_of(order(existing(run_folder), body))
    typer.echo(json.dumps(told.figures) if as_json else told.words)
