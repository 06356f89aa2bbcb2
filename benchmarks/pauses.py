"""Pause and resume, again and again, while the robot drives: `python -m benchmarks.pauses`.

A whole mission in a building runs, and an operator who comes at random instants of its drives pauses it and lets it go
on. Prints a line for each time: seconds to rest, seconds until it went on, both from the word on, and with what. A goal
that was reached while the wheels came to rest needs no motion any more: the base says that it is idle, and the mission
goes on with a scan. Ends with 1 where a base was not at rest half a second after the word, where one that was held on
its way did not move within a second of being let go, or where orders were not acknowledged in 200 ms, at the 99th
percentile of all that were given.
"""

import argparse
import random
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from drivers.interfaces import BaseState
from drivers.wire.sockets import Sockets
from drivers.wire.telemetry import Listener
from mission.config import load_config
from mission.control import CONTROL_FILE, AskStatus, Pause, Resume, Status, order

PATIENCE_S = 300.0
ACK_S = 0.2
REST_S = 0.5
LET_GO_S = 1.0
STAY_S = (0.1, 4.0)
_LONGER = 20
"""So many times the bar is looked whether what comes too late comes at all."""


@dataclass(frozen=True)
class Round:
    """One pause: seconds from each word to rest and to going on, what the base said in it, what was done next."""

    rested: bool
    rest_s: float
    on_s: float
    activity: str
    next: str

    @property
    def good(self) -> bool:
        """Only a base that was held has somewhere to go at once."""
        return self.rested and self.rest_s <= REST_S and (not self.held or self.on_s <= LET_GO_S)

    @property
    def held(self) -> bool:
        return self.activity == "held"

    def __str__(self) -> str:
        figures = f"to rest {self.rest_s:.2f} s, on after {self.on_s:.2f} s; {self.activity}, then {self.next}"
        why = "TOO LATE" if self.rested else "NEVER AT REST"
        return figures if self.good else f"{figures} {why}"


class Operator:
    """Gives orders to the mission of a run folder, and knows how long each took to be acknowledged."""

    def __init__(self, run: Path) -> None:
        self.waits: list[float] = []
        self._run = run

    def says(self, word: Pause | Resume | AskStatus) -> Status:
        began = time.monotonic()
        status = order(self._run, word)
        self.waits.append(time.monotonic() - began)
        return status

    def doing(self) -> str:
        """What the mission says that it does."""
        return str(self.says(AskStatus()).figures.get("doing", ""))

    @property
    def ack_p99_s(self) -> float:
        """Infinite where nothing was ordered."""
        return sorted(self.waits)[int(0.99 * (len(self.waits) - 1))] if self.waits else float("inf")


def pause_once(operator: Operator, listener: Listener, rng: random.Random) -> Round:
    """Pause somewhere on the way of a drive, and let it go on."""
    while not _state(listener).moving:
        if not _wait(lambda: _state(listener).moving):
            raise SystemExit("the base does not drive any more")
        time.sleep(rng.uniform(0.0, 1.0))
    paused = time.monotonic()
    operator.says(Pause())
    rested = _wait(lambda: not _state(listener).moving, _LONGER * REST_S)
    rest = time.monotonic() - paused
    time.sleep(rng.uniform(*STAY_S))
    activity = _state(listener).activity
    resumed = time.monotonic()
    operator.says(Resume())
    held = activity == "held"
    _wait(
        lambda: _state(listener).moving if held else operator.doing() not in ("", "pause ordered?"), _LONGER * LET_GO_S
    )
    return Round(rested, rest, time.monotonic() - resumed, activity, operator.doing())


def _wait(holds: Callable[[], bool], seconds: float = PATIENCE_S) -> bool:
    end = time.monotonic() + seconds
    while not holds():
        if time.monotonic() > end:
            return False
        time.sleep(0.01)
    return True


def _state(listener: Listener) -> BaseState:
    state = listener.state()
    if state is None or state.age > PATIENCE_S:
        raise SystemExit("the base says nothing any more")
    return state


def main() -> int:
    """0 where every bar was kept."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=30)
    parser.add_argument("--speed", type=float, default=3.0)
    parser.add_argument("--seed", type=int, default=0)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        rehearsal = ("simulate", "procedural", "--step=0.8", f"--speed={asked.speed}", f"--out={folder}", "--json")
        command = [sys.executable, "-m", "mission", *rehearsal]
        with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as mission:
            try:
                good = _pause_often(Path(folder), asked.rounds, random.Random(asked.seed))
            finally:
                mission.terminate()
    return 0 if good else 1


def _pause_often(folder: Path, count: int, rng: random.Random) -> bool:
    if not _wait(lambda: any(folder.glob(f"*/{CONTROL_FILE}"))):
        raise SystemExit("the mission does not start")
    (address,) = folder.glob(f"*/{CONTROL_FILE}")
    config = load_config(address.parent / "config.yaml")
    listener = Listener(Sockets().subscriber(config.base.telemetry))
    _wait(lambda: listener.state() is not None)
    operator = Operator(address.parent)
    rounds = []
    for number in range(1, count + 1):
        rounds.append(pause_once(operator, listener, rng))
        print(f"{number:3}  {rounds[-1]}", flush=True)
    listener.close()
    return verdict(rounds, operator)


def verdict(rounds: list[Round], operator: Operator) -> bool:
    """Whether all of it was kept; printed with the figures it is judged by."""
    bad, rest = sum(not found.good for found in rounds), max(found.rest_s for found in rounds)
    print(f"{len(rounds)} pauses, {bad} of them too late; to rest {rest:.2f} s at most (bar {REST_S:g})")
    ack = operator.ack_p99_s
    print(f"{len(operator.waits)} orders acknowledged, p99 {1000 * ack:.1f} ms (bar {1000 * ACK_S:.0f})")
    return not bad and ack <= ACK_S


if __name__ == "__main__":
    sys.exit(main())
