"""Missions over links that drop, repeat, hold up and swap a tenth of all messages each, against one over good links.

``python -m benchmarks.chaos --missions 50``: real clients, agents and sockets, the real tree and executive; devices and
stages act a script. Ends with 1 when a mission came to another end, or anything was done twice; the seed of each such
mission is printed as the command that flies it again. Nothing is judged by a mission over good links that is not whole.
"""

import argparse
import sys
import tempfile
from collections.abc import Iterable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from perception.failure import FailureError
from tests.drivers.chaos_link import NONE, Mischief
from tests.scenarios.wired import Flown, fly

_BEFALLS = ("pass", "drop", "duplicate", "delay", "reorder", "hold")
_ROOMS = _SCANS = 2
"""Rooms of the site, and scans in each."""


@dataclass(frozen=True)
class Bad:
    """What went wrong in one mission, in words."""

    seed: int
    words: str

    def __str__(self) -> str:
        return f"{self.words}\n  again: python -m benchmarks.chaos --missions 1 --seed {self.seed}"


def mission(seed: int | None) -> Flown | str:
    """One mission over bad links, or over good ones without a seed; how it broke off, if so."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            return fly(Path(folder), str(seed), NONE if seed is None else Mischief())
        except (AssertionError, FailureError) as error:
            return f"broke off: {error}"


def whole(clean: Flown | str) -> Flown:
    """The mission over good links, which must be what the others are to come to."""
    if isinstance(clean, str):
        raise SystemExit(f"over good links: {clean}")
    outcome, survey, _ = clean.result
    rooms, scans = len(survey["rooms"]), len(survey["scans"])
    if (outcome, rooms, scans, clean.twice) != ("complete", _ROOMS, _ROOMS * _SCANS, []):
        raise SystemExit(f"over good links: {outcome}, {rooms} rooms, {scans} scans, done twice: {clean.twice}")
    return clean


def faults(clean: Flown, flown: Iterable[tuple[int, Flown | str]]) -> list[Bad]:
    found = []
    for seed, one in flown:
        if isinstance(one, str):
            found.append(Bad(seed, one))
        elif one.twice:
            found.append(Bad(seed, f"done twice: {', '.join(one.twice)}"))
        elif one.result != clean.result:
            found.append(Bad(seed, f"came to another end: {one.result[0]}, {'; '.join(one.failures) or 'no failure'}"))
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--missions", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0, help="of the first one")
    parser.add_argument("--at-once", type=int, default=4, help="missions side by side; they mostly wait")
    options = parser.parse_args()
    seeds = range(options.seed, options.seed + options.missions)
    with ProcessPoolExecutor(options.at_once, get_context("spawn")) as pool:
        first, *flown = pool.map(mission, [None, *seeds])
    clean = whole(first)
    bad = faults(clean, zip(seeds, flown, strict=True))
    for one in bad:
        print(one)
    print(f"{len(flown)} missions, {len(bad)} of them not as over good links ({clean.seconds:.0f} s)")
    _tell([one for one in flown if isinstance(one, Flown)])
    return 1 if bad else 0


def _tell(flown: list[Flown]) -> None:
    """Figures of the missions that came to an end."""
    done = sum(sum(one.executed.values()) for one in flown)
    befell = {name: sum(one.befell[name] for one in flown) for name in _BEFALLS}
    print(f"{done} goals and scans executed, {sum(len(one.twice) for one in flown)} of them twice")
    print(f"messages: {', '.join(f'{count} {name}' for name, count in befell.items())}")
    print(f"{sum(len(one.failures) for one in flown)} failures recovered from", end="")
    seconds = [one.seconds for one in flown]
    print(f"; seconds: median {np.median(seconds):.0f}, worst {max(seconds):.0f}" if seconds else "")


if __name__ == "__main__":
    sys.exit(main())
