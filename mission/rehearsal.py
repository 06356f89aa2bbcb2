"""A mission in a simulated building: two agent processes are started, and the mission meets them over sockets only."""

import json
import re
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import yaml

from drivers.wire.endpoints import Endpoints
from mission.bulletin import Display
from mission.config import ConfigError, SiteConfig, parse_config
from mission.control import CONTROL_FILE
from mission.operator import deaf
from mission.preflight import UnreachableError
from mission.run import Summary, run_mission
from mission.store import RunFolder, write_text

_ANY_PORT = "tcp://127.0.0.1:*"
_ANYWHERE = Endpoints(_ANY_PORT, _ANY_PORT, _ANY_PORT)
_PATIENCE_S = 10
_COMING_UP_S = 300
"""A first start compiles, on a busy machine; a large building takes its time to load."""


@dataclass(frozen=True)
class Rehearsal:
    """What to rehearse, as ``mission simulate`` takes it."""

    world: str
    seed: int = 0
    step_deg: float = 0.2
    profile: str = "vz-400"
    speed: float = 10.0
    scenario: Path | None = None
    attended: bool = False
    overrides: tuple[str, ...] = ()
    options: Mapping[str, Any] = field(default_factory=dict)

    @property
    def site(self) -> str:
        """Name for the run folder: the world's, and its seed."""
        stem = re.sub("[^a-z0-9]+", "-", Path(self.world).stem.lower()).strip("-")
        return f"{stem[:40] or 'world'}-{self.seed}"


def rehearse(plan: Rehearsal, out: Path, display: Display | None = None) -> Summary:
    """Run a simulated mission to its end; :func:`mission.finish.finish` makes its report and its evaluation.

    Raises:
        FailureError: when the world cannot be loaded.
        ConfigError: when an override breaks a rule.
        UnreachableError: when an agent does not come up.
    """
    # Checked before anything is started: a wrong override must not cost a building.
    configure(plan, _ANYWHERE, _ANYWHERE)
    _check_simulation(plan)
    with TemporaryDirectory() as scratch:
        built = Path(scratch) / "world.npz"
        # What it takes to read a building would stay in the process that ticks.
        with ProcessPoolExecutor(1, get_context("spawn")) as builder:
            builder.submit(_build, plan, built).result()
        folder = RunFolder.create(out, plan.site)
        folder.simulation.mkdir()
        shutil.move(built, folder.world)
    write_text(folder.rehearsal, json.dumps(vars(plan) | {"scenario": str(plan.scenario or "")}))
    with agents(plan, folder) as (scanner, base):
        summary = run_mission(configure(plan, scanner, base), folder, display)
        deaf()  # the agents are still to be ended
        return summary


def _build(plan: Rehearsal, file: Path) -> None:
    from drivers.simulated.world import save_world
    from drivers.simulated.worlds import load_world

    save_world(load_world(plan.world, plan.seed, **plan.options), file)


def configure(plan: Rehearsal, scanner: Endpoints, base: Endpoints) -> SiteConfig:
    """The configuration a site with such agents would have."""
    data = {
        "site": plan.site,
        "scanner": {"control": scanner.control, "bulk": scanner.bulk},
        "base": {"control": base.control, "telemetry": base.telemetry},
        "clock_rate": plan.speed,
        "settings": {"scanning": {"step_deg": plan.step_deg}, "operator": {"ask": plan.attended}},
    }
    return parse_config(data, "mission simulate", plan.overrides)


def _check_simulation(plan: Rehearsal) -> None:
    """What only the agents read is refused here too, with its name, and not by an agent that does not come up."""
    from drivers.simulated.profile import SCANNERS
    from drivers.simulated.scenario import load_scenario

    if plan.profile not in SCANNERS:
        raise ConfigError(f"--profile: expected {' or '.join(SCANNERS)}, found '{plan.profile}'")
    if plan.scenario is not None:
        try:
            load_scenario(plan.scenario)
        except (OSError, yaml.YAMLError, ValueError) as error:
            raise ConfigError(f"--scenario {plan.scenario}: {error}") from error


def plan_of(folder: RunFolder) -> Rehearsal:
    """What was rehearsed in a folder."""
    told = json.loads(folder.rehearsal.read_text(encoding="utf-8"))
    scenario = Path(told["scenario"]) if told["scenario"] else None
    return Rehearsal(**told | {"scenario": scenario, "overrides": tuple(told["overrides"])})


@contextmanager
def agents(plan: Rehearsal, folder: RunFolder) -> Iterator[tuple[Endpoints, Endpoints]]:
    """Both agents as processes of their own, ended on the way out whatever happens, or by themselves a while later."""
    truth = folder.simulation
    common = [f"--world={folder.world}", f"--truth={truth.resolve()}", f"--seed={plan.seed}", f"--speed={plan.speed}"]
    common.append(f"--serves={folder.path / CONTROL_FILE}")
    if plan.scenario is not None:
        common.append(f"--scenario={plan.scenario}")
    with _process("base", [*common, f"--plant={_ANY_PORT}", f"--telemetry={_ANY_PORT}"], truth) as base:
        own = [f"--plant={base['plant']}", f"--bulk={_ANY_PORT}", f"--profile={plan.profile}"]
        with _process("scanner", [*common, *own], truth) as scanner:
            # For whoever takes up this mission, should its executive be killed.
            write_text(truth / "agents.json", json.dumps([base["pid"], scanner["pid"]]))
            yield _endpoints(scanner), _endpoints(base)


@contextmanager
def _process(name: str, arguments: list[str], log_folder: Path) -> Iterator[dict[str, Any]]:
    """An agent that has said where it listens; with its ``pid``."""
    command = [sys.executable, "-m", "mission", "agent", name, f"--control={_ANY_PORT}", *arguments]
    log = log_folder / f"{name}.log"
    with (
        log.open("a") as errors,
        # In a group of its own: Ctrl-C is the mission's to answer, and the base must still be there to be stopped.
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=errors, text=True, process_group=0) as process,
    ):
        try:
            line = _first_line(process)
            if not line:
                raise UnreachableError(f"the {name}'s agent did not come up: {log.read_text()[-2000:]}")
            yield json.loads(line) | {"pid": process.pid}
        finally:
            process.terminate()
            try:
                process.wait(_PATIENCE_S)
            except subprocess.TimeoutExpired:
                process.kill()


def _first_line(process: subprocess.Popen[str]) -> str:
    """What the agent announces; empty when it ended, or was killed because it stayed silent for too long."""
    assert process.stdout is not None
    limit = threading.Timer(_COMING_UP_S, process.kill)
    limit.start()
    try:
        return process.stdout.readline()
    finally:
        limit.cancel()


def _endpoints(told: Mapping[str, str]) -> Endpoints:
    return Endpoints(told["control"], told["bulk"], told["telemetry"])
