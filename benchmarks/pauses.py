"""Pause and resume, again and again, while the robot drives: `python -m benchmarks.pauses`.

A whole mission in a building runs, and an operator who comes at random instants of its drives pauses it and lets it go
on. Prints a line for each time: seconds to rest, seconds until it went on, both from the word on, and with what. A goal
that was reached while the wheels came to rest needs no motion any more: the base says that it is idle, and the mission
goes on with a scan. Ends with 1 where a base did not come to rest, or one that was held on its way did not move within
a second of being let go.
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
from mission.control import CONTROL_FILE, AskStatus, Pause, Resume, order

PATIENCE_S = 300.0
REST_S = 10.0
LET_GO_S = 1.0
STAY_S = (0.1, 4.0)


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
        return self.rested and (not self.held or self.on_s <= LET_GO_S)

    @property
    def held(self) -> bool:
        return self.activity == "held"

    def __str__(self) -> str:
        figures = f"to rest {self.rest_s:.2f} s, on after {self.on_s:.2f} s; {self.activity}, then {self.next}"
        why = "TOO LATE" if self.rested else "NEVER AT REST"
        return figures if self.good else f"{figures} {why}"


def pause_once(run: Path, listener: Listener, rng: random.Random) -> Round:
    """Pause somewhere on the way of a drive, and let it go on."""
    while not _state(listener).moving:
        if not _wait(lambda: _state(listener).moving):
            raise SystemExit("the base does not drive any more")
        time.sleep(rng.uniform(0.0, 1.0))
    paused = time.monotonic()
    order(run, Pause())
    rested = _wait(lambda: not _state(listener).moving, REST_S)
    rest = time.monotonic() - paused
    time.sleep(rng.uniform(*STAY_S))
    activity = _state(listener).activity
    resumed = time.monotonic()
    order(run, Resume())
    held = activity == "held"
    _wait(lambda: _state(listener).moving if held else _doing(run) not in ("", "pause ordered?"), 10 * LET_GO_S)
    return Round(rested, rest, time.monotonic() - resumed, activity, _doing(run))


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


def _doing(run: Path) -> str:
    return str(order(run, AskStatus()).figures.get("doing", ""))


def main() -> None:
    """Entry point."""
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
    raise SystemExit(0 if good else 1)


def _pause_often(folder: Path, count: int, rng: random.Random) -> bool:
    if not _wait(lambda: any(folder.glob(f"*/{CONTROL_FILE}"))):
        raise SystemExit("the mission does not start")
    (address,) = folder.glob(f"*/{CONTROL_FILE}")
    config = load_config(address.parent / "config.yaml")
    listener = Listener(Sockets().subscriber(config.base.telemetry))
    _wait(lambda: listener.state() is not None)
    good = True
    for number in range(1, count + 1):
        found = pause_once(address.parent, listener, rng)
        good &= found.good
        print(f"{number:3}  {found}", flush=True)
    listener.close()
    return good


if __name__ == "__main__":
    main()
