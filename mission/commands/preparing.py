"""Commands for before a mission: is everything fit, who may come in, what will it do."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from mission.commands.common import Json, Keys, refusals, refuse


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


def keys(folder: Keys = None, as_json: Json = False) -> None:
    """Show this computer's public key, made on the first call, and whose keys may come in."""
    from mission.keys import as_text, describe, keyring_in

    with refusals():
        found = describe(keyring_in(folder))
    typer.echo(json.dumps(found) if as_json else as_text(found))


def pair(
    key: Annotated[str, typer.Argument(help="Public key, as `mission keys` prints it on the other computer.")],
    role: Annotated[str, typer.Option(help="observer, operator or executive.")],
    name: Annotated[str, typer.Option(help="A name for it.")],
    folder: Keys = None,
) -> None:
    """Let another computer command the agents of this one."""
    from mission.keys import keyring_in, pair

    with refusals():
        typer.echo(pair(keyring_in(folder), key, role, name))


def unpair(name: Annotated[str, typer.Argument(help="The name it was paired by.")], folder: Keys = None) -> None:
    """Let a computer in no more."""
    from mission.keys import keyring_in, unpair

    with refusals():
        typer.echo(unpair(keyring_in(folder), name))


def tree(
    form: Annotated[str, typer.Option("--format", help="unicode, dot, svg or png.")] = "unicode",
    out: Annotated[Path | None, typer.Option(help="File for svg and png.")] = None,
    whole: Annotated[bool, typer.Option("--whole", help="Draw every branch each time that it stands there.")] = False,
) -> None:
    """Draw the behaviour tree; no robot is needed."""
    from mission import drawing
    from trees.building import create_root

    root = create_root() if whole else drawing.folded(create_root())
    if form == "unicode":
        typer.echo(drawing.as_text(root))
    elif form == "dot":
        typer.echo(drawing.as_dot(root))
    elif form in ("svg", "png"):
        path = out or Path(f"tree.{form}")
        drawing.draw(root, path)
        typer.echo(path)
    else:
        refuse(f"--format: expected unicode, dot, svg or png, found '{form}'")
