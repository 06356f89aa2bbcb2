"""Commands that serve a device: the simulated agents."""

from pathlib import Path
from typing import Annotated

import typer

from mission.commands.common import Keys, refusals

World = Annotated[Path, typer.Option(help="Saved world (.npz): a simulated mission leaves its own in RUN/simulation.")]
Truth = Annotated[Path, typer.Option(help="Folder for the truth log.")]
Serves = Annotated[
    Path | None,
    typer.Option("--serves", help="File that names the process of the one mission it is for; it ends 10 min after it."),
]


def agent_scanner(
    world: World,
    truth: Truth,
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

    with refusals():
        run_scanner_agent(world, truth, plant, Endpoints(control, bulk), profile, seed, speed, scenario, keys, serves)


def agent_base(
    world: World,
    truth: Truth,
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

    with refusals():
        listens = Endpoints(control, telemetry=telemetry)
        run_base_agent(world, truth, plant, listens, seed, speed, scenario, keys, serves)
