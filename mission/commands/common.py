"""What the commands share: options, what they say when they refuse, and how a mission's end becomes an exit code."""

import json
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

if TYPE_CHECKING:
    from mission.run import Summary

EXIT_CODES = {"complete": 0, "incomplete": 3, "aborted": 4, "safety_stop": 5, "fault": 1}
USAGE, UNREACHABLE, NO_GO = 2, 6, 7

Json = Annotated[bool, typer.Option("--json", help="One JSON object on stdout; words go to stderr.")]
Keys = Annotated[Path | None, typer.Option("--keys", help="Folder of this computer's keys.")]
RunArgument = Annotated[Path, typer.Argument(metavar="RUN", help="The mission's run folder.")]
Out = Annotated[Path, typer.Option("--out", help="Folder that run folders are made in.")]


def conclude(mission: Callable[[], "Summary"], as_json: bool) -> NoReturn:
    """Run a mission, deliver what came of it, print its summary, and leave with the exit code of its outcome."""
    from mission.preflight import NoGoError, UnreachableError

    _end_by_signals()
    try:
        with refusals():
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
    _end_by_signals()
    report = _delivered(Path(summary.run))
    if as_json:
        typer.echo(json.dumps(asdict(summary)))
    else:
        rooms = ", ".join(
            f"{room['id']} ({room['scans']} scans, {room['reason_ended'] or 'not ended'})" for room in summary.rooms
        )
        typer.echo(f"{summary.outcome}: {len(summary.rooms)} rooms, {summary.scans} scans in {summary.wall_s:.0f} s")
        if summary.reason:
            typer.echo(summary.reason)
        typer.echo(rooms)
        typer.echo(report)
    raise typer.Exit(EXIT_CODES[summary.outcome])


def _end_by_signals() -> None:
    """Before the tick loop listens to the signals, and after it, both end the command the same way."""
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, signal.default_int_handler)


def _delivered(run: Path) -> str:
    """Write what an ended mission delivers; where its report is, or how to have what is missing of it.

    How the mission ended stays its outcome, whatever becomes of that.
    """
    # What the deliveries load must not be in the process while it ticks.
    from mission.finish import finish
    from mission.store import RunFolder

    try:
        if finish(RunFolder(run)):
            return str(RunFolder(run).report)
    except KeyboardInterrupt:
        """The mission is over; there is nothing to abort."""
    missing = f"not all that the mission delivers was written: `mission report {run}` writes it"
    typer.echo(missing, err=True)
    return missing


@contextmanager
def refusals() -> Iterator[None]:
    """What a command was given and cannot use ends it with one plain message instead of a traceback."""
    from mission.config import ConfigError
    from perception.failure import FailureError

    try:
        yield
    except (ConfigError, FailureError) as error:
        refuse(str(error))


def display(as_json: bool) -> Any:
    """What shows a mission's progress; nothing where a program reads the output."""
    from mission.display import Display

    return Display.for_terminal(quiet=as_json and not sys.stderr.isatty())


def existing(folder: Path) -> Path:
    """The folder, where there is one."""
    if not folder.is_dir():
        refuse(f"{folder}: expected a folder, found {'a file' if folder.exists() else 'nothing'}")
    return folder


def refuse(message: str) -> NoReturn:
    """End the command with a message and the exit code of a wrong use."""
    typer.echo(message, err=True)
    raise typer.Exit(USAGE)
