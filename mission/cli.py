"""The ``mission`` command. Every command loads what it needs when it is called, so that ``--help`` answers at once."""

import typer

from mission.commands import preparing, reading, serving, starting, talking

app = typer.Typer(
    help="A robot with a laser scanner scans a building by itself.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for _command in (
    *(starting.simulate, starting.run),
    *(talking.status, talking.pause, talking.resume, talking.answer, talking.abort),
    *(reading.report, reading.evaluate, reading.process, reading.fsck),
    *(preparing.doctor, preparing.keys, preparing.pair, preparing.unpair, preparing.tree),
):
    app.command()(_command)

agent = typer.Typer(
    help="Start an agent: the process on the scanner's or on the base's computer.", no_args_is_help=True
)
agent.command("scanner")(serving.agent_scanner)
agent.command("base")(serving.agent_base)
app.add_typer(agent, name="agent")


def main() -> None:
    """Entry point of the ``mission`` command."""
    app()
