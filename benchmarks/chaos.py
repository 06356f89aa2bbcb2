"""Missions over links that drop, repeat, hold up and swap a tenth of all messages each, against one over good links.

``python -m benchmarks.chaos --missions 50``: real clients, agents and sockets, the real tree and executive; devices and
stages act a script. Ends with 1 when a mission came to another end, or anything was done twice; the seed of each such
mission is printed as the command that flies it again.
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

from tests.drivers.chaos_link import NONE, Mischief
from tests.scenarios.wired import Flown, fly

_BEFALLS = ("pass", "drop", "duplicate", "delay", "reorder", "hold")


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
        except AssertionError as error:
            return str(error)


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
        clean, *flown = pool.map(mission, [None, *seeds])
    assert isinstance(clean, Flown), clean
    bad = faults(clean, zip(seeds, flown, strict=True))
    whole = [one for one in flown if isinstance(one, Flown)]
    befell = {name: sum(one.befell[name] for one in whole) for name in _BEFALLS}
    failures = sum(len(one.failures) for one in whole)
    done = sum(sum(one.executed.values()) for one in whole)
    seconds = [one.seconds for one in whole]
    print(f"{len(flown)} missions, {len(bad)} of them not as over good links ({clean.seconds:.0f} s)")
    print(f"{done} goals and scans executed, {sum(len(one.twice) for one in whole)} of them twice")
    print(f"messages: {', '.join(f'{count} {name}' for name, count in befell.items())}")
    print(f"{failures} failures recovered from; seconds: median {np.median(seconds):.0f}, worst {max(seconds):.0f}")
    for one in bad:
        print(one)
    return 1 if bad else 0


if __name__ == "__main__":
    sys.exit(main())
