"""Small buildings and whole missions through them: real processes, real sockets, from the command to its exit code."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import yaml

from mission.journal import read_events
from tests.missions.promises import broken_in

ROOT = Path(__file__).parents[2]
PATIENCE_S = 240.0
"""For a machine that does much else at the same time; a mission here takes a tenth of it on an idle one."""

TWO_ROOMS: dict[str, Any] = {
    "name": "two rooms",
    "height": 2.7,
    "start": {"at": [2.2, 2.1], "yaw": 10},
    "rooms": {"big": {"box": [0.0, 0.0, 4.4, 4.0]}, "small": {"box": [4.6, 0.4, 7.6, 3.6]}},
    "doors": [{"room": "small", "at": [4.6, 2.0], "width": 1.0, "hinge": "right", "angle": 95}],
    "furniture": [
        {"kind": "desk", "at": [0.5, 3.3]},
        {"kind": "cabinet", "at": [3.2, 0.3]},
        {"kind": "shelf", "at": [7.3, 1.0], "yaw": 90},
    ],
}
ONE_ROOM: dict[str, Any] = {
    "name": "one room",
    "height": 2.7,
    "start": {"at": [1.6, 1.8], "yaw": 10},
    "rooms": {"only": {"box": [0.0, 0.0, 4.4, 3.6]}},
    "furniture": [{"kind": "cabinet", "at": [3.2, 0.3]}],
}
ENOUGH = "settings.room.predicted_rate=0.05"
"""A room ends with the scan after which no view promises more: two scans each, in place of three."""


@dataclass(frozen=True)
class Flight:
    """A mission that has ended: how, what it said, and the folder it left."""

    code: int
    stdout: str
    stderr: str
    seconds: float
    out: Path

    @cached_property
    def said(self) -> dict[str, Any]:
        """The one object on stdout; nothing else may be there."""
        return json.loads(self.stdout)

    @cached_property
    def folder(self) -> Path:
        (folder,) = self.out.iterdir()
        return folder

    @cached_property
    def events(self) -> list[dict[str, Any]]:
        return read_events(self.folder / "events.jsonl")

    def events_of(self, kind: str) -> list[dict[str, Any]]:
        return [event for event in self.events if event["kind"] == kind]

    def read(self, name: str) -> Any:
        return json.loads((self.folder / name).read_text())


def mission(*arguments: object) -> subprocess.Popen[str]:
    """The ``mission`` command, started."""
    command = [sys.executable, "-m", "mission", *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT)


def simulate(plan: Mapping[str, Any], folder: Path, *more: object) -> subprocess.Popen[str]:
    """``mission simulate`` in a plan, coarse and fast; runs go to ``<folder>/runs``."""
    world = folder / f"{str(plan['name']).replace(' ', '-')}.yaml"
    world.write_text(yaml.safe_dump(dict(plan)))
    coarse = ("--profile=vz-400i", "--step=0.5", "--speed=20")
    return mission("simulate", world, *coarse, f"--out={folder / 'runs'}", "--json", *more)


def landed(process: subprocess.Popen[str], folder: Path) -> Flight:
    """Wait until the command has ended; ``seconds`` are those from now on. No promise may have been broken."""
    began = time.monotonic()
    try:
        stdout, stderr = process.communicate(timeout=PATIENCE_S)
    except subprocess.TimeoutExpired:
        process.terminate()
        raise
    seconds = time.monotonic() - began
    assert broken_in(folder) == []
    return Flight(process.returncode, stdout, stderr, seconds, folder / "runs")


def wait_until(holds: Callable[[], bool], process: subprocess.Popen[str]) -> None:
    """Wait for something that a running command does."""
    end = time.monotonic() + PATIENCE_S
    while not holds():
        assert process.poll() is None, f"the command ended before that: {process.communicate()}"
        assert time.monotonic() < end, "it does not happen"
        time.sleep(0.05)


def is_running(out: Path, node: str) -> bool:
    """Whether the mission under way below ``out`` has reached a node of its tree."""
    logs = out.glob("*/events.jsonl")
    events = (event for log in logs for event in read_events(log))
    return any(event["kind"] == "node" and event["node"] == node and event["after"] == "RUNNING" for event in events)


def freeze(pid: int, seconds: float) -> None:
    """Let a process stand still for so long, and go on."""
    os.kill(pid, signal.SIGSTOP)
    try:
        time.sleep(seconds)
    finally:
        with suppress(ProcessLookupError):  # its executive has killed a worker that did not end
            os.kill(pid, signal.SIGCONT)


def worker_of(executive: int) -> int | None:
    """The executive's child that does the thinking, while it has one."""
    children = Path(f"/proc/{executive}/task/{executive}/children").read_text().split()
    for pid in map(int, children):
        if "spawn_main" in Path(f"/proc/{pid}/cmdline").read_text():
            return pid
    return None


def is_listening(endpoint: str) -> bool:
    """Whether any process still serves an endpoint."""
    address = urlsplit(endpoint)
    with socket.socket() as probe:
        probe.settimeout(1.0)
        return probe.connect_ex((address.hostname, address.port)) == 0


def free_ports(count: int) -> list[str]:
    """Endpoints that nobody listens at."""
    with_ports = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    try:
        return [f"tcp://127.0.0.1:{server.getsockname()[1]}" for server in with_ports]
    finally:
        for server in with_ports:
            server.close()


@dataclass(frozen=True)
class Agents:
    """Two agents in processes of their own, and the configuration of a site that has them."""

    scanner: subprocess.Popen[str]
    base: subprocess.Popen[str]
    site: Path


@contextmanager
def agents(world: Path, folder: Path, speed: float = 20.0) -> Iterator[Agents]:
    """Start ``mission agent base`` and ``mission agent scanner`` and wait until both have said where they listen."""
    common = (f"--world={world}", f"--truth={folder / 'truth'}", f"--speed={speed}")
    plant, control, telemetry, scans, bulk = free_ports(5)
    base = mission("agent", "base", *common, f"--plant={plant}", f"--control={control}", f"--telemetry={telemetry}")
    where = (f"--plant={plant}", f"--control={scans}", f"--bulk={bulk}", "--profile=vz-400i")
    scanner = mission("agent", "scanner", *common, *where)
    try:
        told = [json.loads(process.stdout.readline()) for process in (scanner, base) if process.stdout]
        site = folder / "site.yaml"
        write_site(site, {"control": told[0]["control"], "bulk": told[0]["bulk"]}, told[1], speed)
        yield Agents(scanner, base, site)
    finally:
        for process in (scanner, base):
            process.terminate()
        for process in (scanner, base):
            process.communicate(timeout=PATIENCE_S)


def write_site_of_nobody(folder: Path) -> Path:
    """A site whose agents were never started."""
    scans, bulk, drives, telemetry = free_ports(4)
    site = folder / "site.yaml"
    write_site(site, {"control": scans, "bulk": bulk}, {"control": drives, "telemetry": telemetry})
    return site


def write_site(path: Path, scanner: Mapping[str, str], base: Mapping[str, str], speed: float = 20.0) -> None:
    site = {
        "site": "laboratory",
        "scanner": dict(scanner),
        "base": {key: base[key] for key in ("control", "telemetry")},
        "clock_rate": speed,
        "settings": {"scanning": {"step_deg": 0.5}},
    }
    path.write_text(yaml.safe_dump(site))
