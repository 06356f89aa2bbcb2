"""kill -9 at random instants of whole missions: executive, perception worker, scanner's agent, base's agent.

``python -m benchmarks.kills --kills 200``: simulated missions through two rooms, with agents in processes of their own;
in each, several processes are killed at seeded instants, the next one no sooner than the last one was started again.
The harness does what an operator would: takes the mission up with ``mission resume RUN --auto-resume``, or starts the
agent again where it listened. With ``--signal STOP`` they are frozen (SIGSTOP) for up to ``--for`` seconds instead and
then let go on (SIGCONT), which nobody does anything about; ``--signal BOTH`` draws which. The simulator's log judges:

* no scan that the scanner had stored is missing in the survey, none of them was taken twice, no goal begun twice;
* the mission ends complete, the run folder is clean, and has the rooms and doors of the undisturbed mission;
* every pose is where the simulator says that scan was taken, and each room's area is the undisturbed one's.

Bits cannot be compared: the base's control loop runs on real time, so that no two missions, undisturbed or not, stop at
the same millimetre; ``tests/scenarios/test_resume.py`` does so on a virtual clock, for a death at each write. Ends with
1 when a promise was broken, also by the undisturbed mission; each other one is printed as the command that repeats its
victims and instants.
"""

import argparse
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from drivers.simulated.truth_log import read_truth
from drivers.simulated.world import save_world
from drivers.simulated.worlds import load_world
from drivers.wire.naming import own_name
from mission.commands.common import UNREACHABLE
from mission.journal import read_events
from perception import transforms
from tests.missions.flights import ENOUGH, PATIENCE_S, TWO_ROOMS, free_ports, freeze, mission, worker_of, write_site
from tests.missions.promises import moved_amiss

VICTIMS = ("executive", "worker", "scanner", "base")
SIGNALS = ("KILL", "STOP")
SPEED = 20.0
CHANGES = (
    ENOUGH,
    "settings.scanning.step_deg=0.8",
    # Mission time runs twenty times as fast here, and an agent takes as long as ever to come up.
    "settings.building.base_return_s=6000",
)
POSE_M, AREA = 0.02, 0.05
"""How far a pose may be from the truth, metres, and a room's area from the undisturbed one, as a share."""
_BREAKS_OFF = (AssertionError, subprocess.TimeoutExpired, OSError, ValueError, LookupError)
"""What a mission that went wrong may raise here; whatever else is raised is an error of this program."""
_FIRST_SCAN = "take the scan"


@dataclass
class Rig:
    """Two agents and a site; every process that was started here, by its name."""

    folder: Path
    world: Path
    commands: dict[str, list[object]] = field(default_factory=dict)
    processes: dict[str, "subprocess.Popen[str]"] = field(default_factory=dict)

    def __post_init__(self) -> None:
        common = (f"--world={self.world}", f"--truth={self.truth}", f"--speed={SPEED}")
        plant, control, telemetry, scans, bulk = free_ports(5)
        of_base = (f"--plant={plant}", f"--control={control}", f"--telemetry={telemetry}")
        self.commands["base"] = ["agent", "base", *common, *of_base]
        of_scanner = (f"--plant={plant}", f"--control={scans}", f"--bulk={bulk}", "--profile=vz-400i")
        self.commands["scanner"] = ["agent", "scanner", *common, *of_scanner]
        write_site(
            self.site, {"control": scans, "bulk": bulk}, {"control": control, "telemetry": telemetry}, speed=SPEED
        )

    @property
    def truth(self) -> Path:
        return self.folder / "truth"

    @property
    def site(self) -> Path:
        return self.folder / "site.yaml"

    @property
    def run(self) -> Path:
        (found,) = (self.folder / "runs").iterdir()
        return found

    def start(self, name: str, *command: object) -> None:
        self.processes[name] = mission(*(command or self.commands[name]))

    def start_agents(self) -> None:
        for name in ("base", "scanner"):
            self.start(name)
        for name in ("base", "scanner"):
            self._await(name)

    def kill(self, victim: str, pid: int) -> None:
        os.kill(pid, signal.SIGKILL)
        if victim != "worker":
            self.processes[victim].wait()

    def pid(self, victim: str) -> int | None:
        """None where there is nothing to strike: an executive that has no worker just now."""
        return worker_of(self.processes["executive"].pid) if victim == "worker" else self.processes[victim].pid

    def start_again(self, victim: str) -> None:
        """What an operator does about a process that died; the worker is its executive's business."""
        if victim == "executive":
            self.resume()
        elif victim != "worker":
            self.start(victim)
            self._await(victim)

    def resume(self) -> None:
        self.start("executive", "resume", self.run, "--auto-resume", "--json")

    def stored(self) -> set[str]:
        """Scans that the scanner's agent has, for good."""
        return {own_name(path.stem) for path in (self.truth / "spool").glob("*.json")}

    def end(self) -> None:
        for process in self.processes.values():
            process.terminate()
        for process in self.processes.values():
            process.communicate(timeout=PATIENCE_S)

    def _await(self, name: str) -> None:
        """An agent says where it listens when it is up."""
        said = self.processes[name].stdout
        assert said is not None and said.readline(), f"the {name}'s agent did not come up"


@dataclass(frozen=True)
class Strike:
    """Who is struck, how many seconds after the strike before, how, and for how long where it is not for good."""

    victim: str
    wait: float
    signal: str = "KILL"
    seconds: float = 0.0


@dataclass(frozen=True)
class Kill:
    """A process that was killed, or frozen for a while: what the mission did, what the scanner had and had done.

    Args:
        stored: scans that the scanner's agent had for good.
        taken: how often each scan had been taken.
    """

    strike: Strike
    node: str
    stored: frozenset[str]
    taken: Counter[str]

    @property
    def victim(self) -> str:
        return self.strike.victim

    def __str__(self) -> str:
        for_s = f" for {self.strike.seconds:.1f} s" if self.strike.signal == "STOP" else ""
        return f"{self.victim} at '{self.node}'{for_s}"


class BrokenOffError(Exception):
    """A mission that came to no end, and who was killed in it."""

    def __init__(self, why: str, kills: Sequence[Kill]) -> None:
        super().__init__(why)
        self.kills = tuple(kills)


@dataclass(frozen=True)
class Flight:
    """What came of a mission, and what the simulator saw."""

    code: int
    words: str
    state: dict[str, Any]
    truth: list[dict[str, Any]]
    events: list[dict[str, Any]]
    kills: tuple[Kill, ...]

    @property
    def rooms(self) -> list[tuple[str, float]]:
        return [(room["status"], room.get("area", 0.0)) for room in self.state.get("rooms", ())]

    def taken(self) -> Counter[str]:
        return taken_in(self.truth)

    def driven(self) -> Counter[str]:
        """How often each goal was begun; a base that is killed on its way never writes that a drive ended."""
        return Counter(own_name(event["goal_id"]) for event in self.truth if event["event"] == "drive_begun")

    def failures(self) -> list[str]:
        """What failed on the way, in the mission's words."""
        return [f"{event['code']}: {event['message']}" for event in self.events if event["kind"] == "failure"]

    def work_s(self) -> float:
        """Seconds of the wall from the first scan's order to the mission's end, both by the mission's clock."""
        ordered = next(event["t"] for event in self.events if event.get("node") == _FIRST_SCAN)
        ended = next(event["t"] for event in self.events if event["kind"] == "mission_ended")
        return float(ended - ordered) / SPEED

    def pose_errors(self) -> list[float]:
        """Metres from each scan's pose to where it was taken, in the frame of the first."""
        last_taken = {own_name(event["scan_id"]): event for event in self.truth if event["event"] == "scan"}
        scans = self.state.get("scans", ())
        truth = [np.array(last_taken[scan["scan_id"]]["world_from_scanner"]) for scan in scans]
        found = [np.array(scan["map_from_scanner"]) for scan in scans]
        world_from_map = truth[0] @ transforms.inverse(found[0])
        return [transforms.difference(true, world_from_map @ pose)[0] for true, pose in zip(truth, found, strict=True)]


def broken_promises(flight: Flight, whole: Flight | None) -> list[str]:
    """In words; nothing where all were kept."""
    found = [] if flight.code == 0 else [f"exit code {flight.code}: {flight.words[-600:].strip()}"]
    listed = [scan["scan_id"] for scan in flight.state.get("scans", ())]
    kept = {*listed, *flight.state.get("scans_without_place", ())}
    lost, invented = set(flight.taken()) - kept, kept - set(flight.taken())
    # A scan that was under way when the scanner's computer died was in no hands yet: it is taken by its name again.
    deaths = sum(kill.victim == "scanner" and kill.strike.signal == "KILL" for kill in flight.kills)
    often = {name for name, count in flight.taken().items() if count > 1 + deaths}
    again = {name for kill in flight.kills for name in kill.stored if flight.taken()[name] > kill.taken[name]}
    moved = [name for name, count in flight.driven().items() if count > 1]
    found += [f"scans lost: {sorted(lost)}"] * bool(lost)
    found += [f"scans that nobody took: {sorted(invented)}"] * bool(invented)
    found += [f"scans taken twice: {sorted(often | again)}"] * bool(often or again)
    found += [f"scans listed twice: {listed}"] * (len(listed) != len(set(listed)))
    found += [f"goals begun twice: {moved}"] * bool(moved)
    found += moved_amiss(flight.truth)
    if listed and not invented:
        worst = max(flight.pose_errors())
        found += [f"a pose is {worst:.3f} m off"] * (worst > POSE_M)
    if whole is not None:
        found += _unlike(flight, whole)
    return found and [*found, *flight.failures()]


def _unlike(flight: Flight, whole: Flight) -> list[str]:
    found = []
    if [status for status, _ in flight.rooms] != [status for status, _ in whole.rooms]:
        found.append(f"rooms {flight.rooms}, undisturbed {whole.rooms}")
    elif any(abs(a - b) > AREA * b for (_, a), (_, b) in zip(flight.rooms, whole.rooms, strict=True)):
        found.append(f"areas {flight.rooms}, undisturbed {whole.rooms}")
    if len(flight.state.get("doors", ())) != len(whole.state["doors"]):
        found.append(f"{len(flight.state.get('doors', ()))} doors, undisturbed {len(whole.state['doors'])}")
    return found


@contextmanager
def rig(folder: Path, world: Path) -> Iterator[Rig]:
    built = Rig(folder, world)
    try:
        built.start_agents()
        yield built
    finally:
        built.end()


def fly(world: Path, plan: Iterable[Strike] = ()) -> Flight:
    """One mission; each victim of the plan is struck so many seconds after the first scan's order, or the last strike.

    Raises:
        BrokenOffError: where it came to no end that could be judged.
    """
    kills: list[Kill] = []
    try:
        with tempfile.TemporaryDirectory() as folder, rig(Path(folder), world) as up:
            return _flown(up, plan, kills)
    except _BREAKS_OFF as error:
        raise BrokenOffError(repr(error), kills) from error


def _flown(up: Rig, plan: Iterable[Strike], kills: list[Kill]) -> Flight:
    flags = ("--unattended", "--json", *(f"--set={change}" for change in CHANGES))
    up.start("executive", "run", up.site, f"--out={up.folder / 'runs'}", *flags)
    for strike in plan:
        if not _lives_until(up, strike.wait):
            break
        kills += _struck(up, strike)
        if strike.signal == "KILL":
            up.start_again(strike.victim)
    code, words = _ended(up)
    if code == 0:
        code, words = _looked_through(up.run)
    state = json.loads((up.run / "state.json").read_text())
    return Flight(code, words, state, read_truth(up.truth), read_events(up.run / "events.jsonl"), tuple(kills))


def _looked_through(run: Path) -> tuple[int, str]:
    """Exit code and words of ``mission fsck``."""
    fsck = mission("fsck", run)
    said, errors = fsck.communicate(timeout=PATIENCE_S)
    return fsck.returncode, f"fsck: {said}{errors}"


def _struck(up: Rig, strike: Strike) -> Iterator[Kill]:
    node, pid = _doing(up.run), up.pid(strike.victim)
    if pid is None:
        return
    if strike.signal == "KILL":
        up.kill(strike.victim, pid)
    # Stored is read before taken: what the scanner takes in between was then not stored yet.
    stored = frozenset(up.stored())
    yield Kill(strike, node, stored, taken_in(read_truth(up.truth)))
    if strike.signal == "STOP":
        freeze(pid, strike.seconds)


def _ended(up: Rig) -> tuple[int, str]:
    """Exit code and words of the mission, taken up once more for each agent that was away when it was resumed."""
    for _ in VICTIMS:
        summary, errors = up.processes["executive"].communicate(timeout=PATIENCE_S)
        code = up.processes["executive"].returncode
        if code != UNREACHABLE:
            break
        up.resume()
    return code, f"{summary}{errors}"


def taken_in(truth: Iterable[dict[str, Any]]) -> Counter[str]:
    return Counter(own_name(event["scan_id"]) for event in truth if event["event"] == "scan")


def _lives_until(up: Rig, instant: float) -> bool:
    """Wait for the first scan to be ordered and then so long; False for a mission that is over by then."""
    executive = up.processes["executive"]
    end = time.monotonic() + PATIENCE_S
    while executive.poll() is None and _FIRST_SCAN not in _log(up.folder):
        assert time.monotonic() < end, "no scan is ever ordered"
        time.sleep(0.05)
    time.sleep(instant)
    return executive.poll() is None and '"mission_ended"' not in _log(up.folder)


def _log(folder: Path) -> str:
    logs = list(folder.glob("runs/*/events.jsonl"))
    return logs[0].read_text() if logs else ""


def _doing(run: Path) -> str:
    """The leaf that runs now, by the log."""
    running = ""
    for event in read_events(run / "events.jsonl"):
        if event["kind"] == "node" and event["after"] == "RUNNING":
            running = event["node"]
    return running


def main() -> int:
    options = _arguments()
    most = options.kills if options.missions is None else options.missions
    until = time.monotonic() + 60 * options.minutes
    died: Counter[str] = Counter()
    missions = broken = 0
    with tempfile.TemporaryDirectory() as folder:
        world = _built(Path(folder))
        whole = undisturbed(world)
        lasts = options.lasts or round(whole.work_s(), 1)
        print(f"undisturbed: {len(whole.taken())} scans, {len(whole.driven())} drives, ", end="")
        print(f"worst pose {1000 * max(whole.pose_errors()):.1f} mm; kills are spread over {lasts} s", flush=True)
        while died.total() < options.kills and missions < most and time.monotonic() < until:
            seed = options.seed + missions
            kills, promises = _tried(world, ordeal(seed, lasts, options), whole)
            missions += 1
            broken += bool(promises)
            died.update(kill.victim for kill in kills)
            told = ", ".join(map(str, kills))
            print(f"{seed}: {told or 'over before any strike'}: {'; '.join(promises) or 'kept'}", flush=True)
            if promises:
                print(f"  again: {_command(seed, lasts, options)}", flush=True)
    print(f"{missions} missions, {broken} broke a promise; struck: {', '.join(f'{v} {died[v]}' for v in VICTIMS)}")
    return 1 if broken else 0


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=200, help="in all; no mission begins after so many")
    parser.add_argument("--missions", type=int, help="at most; as many as kills unless told otherwise")
    parser.add_argument("--each", type=int, default=4, help="kills in each mission, if it lasts that long")
    parser.add_argument("--seed", type=int, default=0, help="of the first mission")
    parser.add_argument("--victim", choices=VICTIMS, help="only this one")
    parser.add_argument(
        "--signal", choices=(*SIGNALS, "BOTH"), default="KILL", help="kill, freeze, or either by chance"
    )
    parser.add_argument("--for", dest="longest", type=float, default=8.0, help="seconds to freeze for at most")
    parser.add_argument("--lasts", type=float, help="seconds to spread kills over; as measured by default")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="begin no mission after so many")
    return parser.parse_args()


def ordeal(seed: int, lasts: float, options: argparse.Namespace) -> list[Strike]:
    """Who is struck, when and how; the same whenever it is drawn."""
    chance = random.Random(seed)
    victims = [options.victim or chance.choice(VICTIMS) for _ in range(options.each)]
    waits = [chance.uniform(0.0, 1.5 * lasts / options.each) for _ in victims]
    if options.signal == "KILL":
        return [Strike(victim, wait) for victim, wait in zip(victims, waits, strict=True)]
    signals = [chance.choice(SIGNALS) if options.signal == "BOTH" else "STOP" for _ in victims]
    seconds = [chance.uniform(0.3, options.longest) for _ in victims]
    return [Strike(*drawn) for drawn in zip(victims, waits, signals, seconds, strict=True)]


def undisturbed(world: Path) -> Flight:
    """The mission that all others are measured by, which must be a whole one."""
    whole = fly(world)
    promises = broken_promises(whole, None)
    if len(whole.rooms) != len(TWO_ROOMS["rooms"]):
        promises.append(f"rooms {whole.rooms}")
    if promises:
        raise SystemExit(f"the undisturbed mission is not whole: {'; '.join(promises)}")
    return whole


def _built(folder: Path) -> Path:
    plan, world = folder / "plan.yaml", folder / "world.npz"
    plan.write_text(yaml.safe_dump(TWO_ROOMS))
    save_world(load_world(str(plan)), world)
    return world


def _command(seed: int, lasts: float, options: argparse.Namespace) -> str:
    only = f" --victim {options.victim}" if options.victim else ""
    how = "" if options.signal == "KILL" else f" --signal {options.signal} --for {options.longest}"
    return f"python -m benchmarks.kills --missions 1 --each {options.each} --seed {seed} --lasts {lasts}{only}{how}"


def _tried(world: Path, plan: Iterable[Strike], whole: Flight) -> tuple[tuple[Kill, ...], list[str]]:
    """Who was struck, and which promises were broken."""
    try:
        flight = fly(world, plan)
    except BrokenOffError as broken:
        return broken.kills, [str(broken)]
    return flight.kills, broken_promises(flight, whole)


if __name__ == "__main__":
    sys.exit(main())
