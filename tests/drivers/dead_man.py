"""The bench for the dead man: a simulated base in this process, its agent, an executive in another, a cable between.

Shared by the tests and by ``benchmarks.dead_man``, which does the same fifty times.
"""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

from drivers.agent import Agent, base_agent
from drivers.interfaces import DriveGoal
from drivers.lease import STALE_S, LeaseKeeper
from drivers.simulated.agents import warm_up
from drivers.simulated.base import SimulatedBase
from drivers.simulated.clock import ScaledClock
from drivers.simulated.world import World
from drivers.wire.base_client import BaseClient
from tests.drivers.beating import START, save_map
from tests.drivers.simulated_rooms import perfect_map, two_rooms
from tests.drivers.tcp_link import TcpLink
from tests.drivers.wire_fakes import ANYWHERE, IMPATIENT, eventually, value_of

PROMISE_S = 0.5
GLANCE_S = 0.002
ROOT = Path(__file__).parents[2]


class WatchedBase(SimulatedBase):
    """A simulated base on real time that notes when it is permitted to move and what it is ordered."""

    def __init__(self, world: World, speed: float = 1.0) -> None:
        warm_up(world)
        super().__init__(world)
        self.permits: list[tuple[float, float]] = []
        self.ordered: list[str] = []
        self._ended = threading.Event()
        self._motion = threading.Thread(target=self.run, args=(ScaledClock(speed), self._ended.is_set), daemon=True)
        self._motion.start()

    def __enter__(self) -> "WatchedBase":
        return self

    def __exit__(self, *exception: object) -> None:
        self._ended.set()
        self._motion.join()

    def permit(self, until: float) -> None:
        self.permits.append((time.monotonic(), until))
        super().permit(until)

    def start_drive(self, goal: DriveGoal) -> None:
        self.ordered.append(goal.goal_id)
        super().start_drive(goal)

    @property
    def last_beat(self) -> float:
        """When the last beat came that let it move."""
        return next(at for at, until in reversed(self.permits) if until > at)

    @property
    def obeyed(self) -> int:
        """Orders and beats so far that it acted on."""
        return len(self.ordered) + len(self.permits)

    @property
    def moving(self) -> bool:
        return self.telemetry().moving


@dataclass(frozen=True)
class Halt:
    """How a base came to rest: seconds after the last valid beat, and the longest this process was not let run."""

    after: float
    starved: float

    @property
    def kept(self) -> bool:
        """Half a second, on a machine that lets the base's control loop run; what it took from it comes on top."""
        return self.after <= max(PROMISE_S, PROMISE_S - 0.05 + self.starved + GLANCE_S)


def halt_of(base: WatchedBase, seconds: float = 20.0) -> Halt:
    """Watch a moving base until it is at rest, and its last permit to move is over."""
    looked = time.monotonic()
    give_up, starved, since = looked + seconds, 0.0, None
    while since is None or looked < base.permits[-1][1]:
        time.sleep(GLANCE_S)
        now = time.monotonic()
        assert now < give_up, "it does not come to rest"
        starved, looked = max(starved, now - looked), now
        if base.moving:
            since = None
        elif since is None:
            since = now
    return Halt(since - base.last_beat, starved)


class Executive:
    """``tests.drivers.beating`` as a process, and its end of the cable."""

    def __init__(self, owner: str, agent: Agent, map_file: Path) -> None:
        endpoints = agent.endpoints
        self.links = [TcpLink(endpoints.control), TcpLink(endpoints.telemetry)]
        command = [sys.executable, "-m", "tests.drivers.beating", owner]
        command += [*(link.endpoint for link in self.links), str(map_file)]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, cwd=ROOT)
        self.first_word = self.hears()

    def __enter__(self) -> "Executive":
        return self

    def __exit__(self, *exception: object) -> None:
        self.process.kill()
        self.process.communicate()
        for link in self.links:
            link.__exit__()

    def hears(self) -> dict[str, object]:
        """Its next word."""
        assert self.process.stdout is not None
        return json.loads(self.process.stdout.readline())

    def loss(self) -> object:
        """How the next of its drives ended that did not arrive."""
        while (end := self.hears()["ended"]) == "DONE":
            pass
        return end

    def stop(self) -> None:
        os.kill(self.process.pid, signal.SIGSTOP)

    def wake(self) -> None:
        os.kill(self.process.pid, signal.SIGCONT)

    def wedge(self) -> None:
        os.kill(self.process.pid, signal.SIGUSR1)

    def cut(self) -> None:
        for link in self.links:
            link.cut()

    def heal(self) -> None:
        for link in self.links:
            link.heal()

    def kill(self) -> None:
        self.process.kill()

    def nothing(self) -> None:
        """A wedge ends by itself."""


FAULTS: dict[str, tuple[Callable[[Executive], None], Callable[[Executive], None]]] = {
    "SIGSTOP": (Executive.stop, Executive.wake),
    "wedge": (Executive.wedge, Executive.nothing),
    "link cut": (Executive.cut, Executive.heal),
}
"""What befalls the executive, and how it ends."""


@dataclass(frozen=True)
class Bench:
    """A base that drives, if somebody lets it."""

    base: WatchedBase
    map_file: Path

    @contextmanager
    def agent(self, stale_after: float = STALE_S) -> Iterator[Agent]:
        with base_agent(self.base, ANYWHERE, keeper=LeaseKeeper(time.time_ns(), stale_after=stale_after)) as agent:
            yield agent

    def executive(self, owner: str, agent: Agent) -> Executive:
        return Executive(owner, agent, self.map_file)

    def drives(self, seconds: float = 60.0) -> None:
        """Wait until it does."""
        eventually(lambda: self.base.moving, seconds)


@contextmanager
def bench(folder: Path) -> Iterator[Bench]:
    world = two_rooms(start=START)
    map_file = folder / "map.npz"
    save_map(map_file, perfect_map(world))
    with ExitStack() as stack:
        yield Bench(stack.enter_context(WatchedBase(world)), map_file)


def halts_by(fault: str, bench: Bench, rounds: int, pauses: Iterator[float]) -> Iterator[Halt]:
    """Let a fault befall the executive while the base drives, and end, again and again.

    After each one the base must drive on, to the goal that it had.
    """
    strike, end = FAULTS[fault]
    # A busy machine may keep a process from beating for seconds: the lease must outlast that, the wheels must not.
    with bench.agent(stale_after=60.0) as agent, bench.executive(fault, agent) as executive:
        for _ in range(rounds):
            bench.drives()
            time.sleep(next(pauses))
            bench.drives()
            ordered = len(bench.base.ordered)
            strike(executive)
            yield halt_of(bench.base)
            assert len(bench.base.ordered) <= ordered + 1, "no more than the order that was on its way"
            end(executive)


def halts_by_kill(bench: Bench, rounds: int, pauses: Iterator[float]) -> Iterator[Halt]:
    """Kill one executive after the other, each with an agent of its own."""
    for number in range(rounds):
        with bench.agent() as agent, bench.executive(f"killed {number}", agent) as executive:
            bench.drives()
            time.sleep(next(pauses))
            bench.drives()
            executive.kill()
            yield halt_of(bench.base)


def obeyed_after_takeover(fault: str, bench: Bench, owner: str) -> int:
    """Let a fault last until another owns the base; how much of what the first one said was obeyed after that.

    He says it again at once: what waited in queues, the beats of every tick, and new orders.
    """
    strike, end = FAULTS[fault]
    with bench.agent(stale_after=1.0) as agent, bench.executive(owner, agent) as old:
        bench.drives()
        strike(old)
        with closing(BaseClient(agent.endpoints, IMPATIENT)) as heir:
            eventually(lambda: (state := heir.state()) is not None and state.owner == "")
            value_of(heir.acquire("heir"))
            obeyed = bench.base.obeyed
            end(old)
            assert [old.loss() for _ in range(3)] == ["LEASE_LOST"] * 3
            return bench.base.obeyed - obeyed
