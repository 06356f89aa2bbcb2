"""Executives that die at every crash point of the commit path: ``python -m benchmarks.deaths``.

One mission for each operation of the ledger, the run folder, the transfer and the scanner's spool, and each instant:
``os._exit`` before it, after it, and amid it where it is a write. Resumed, each must come to the scans, goals, jobs and
maps of the mission that nobody killed, with a clean folder. Prints one command for each mission that broke a promise,
and ends with 1 then.
"""

import argparse
import sys
import tempfile
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

from benchmarks.promises import words
from tests.scenarios.deaths import Undisturbed, When, die_and_resume, undisturbed


def main() -> int:
    arguments = _arguments()
    # Fresh interpreters without threads: only such a one may fork.
    with ProcessPoolExecutor(arguments.at_once, get_context("spawn")) as pool:
        clean = pool.submit(whole).result()
        points = _points(arguments, clean)
        told = pool.map(partial(died, clean), points)
        broken = 0
        for (when, at), how in zip(points, told, strict=True):
            if how:
                broken += 1
                print(
                    f"python -m benchmarks.deaths --when {when.name} --at {at} ({clean.log[at - 1]}): {how}", flush=True
                )
    print(f"{len(clean.log)} operations in a mission; {len(points)} deaths, {broken} of them broke a promise")
    print(", ".join(f"{count} at {what}" for what, count in _kinds(clean, points).most_common()))
    return 1 if broken else 0


def whole() -> Undisturbed:
    with tempfile.TemporaryDirectory() as folder:
        return undisturbed(Path(folder))


def died(clean: Undisturbed, point: tuple[When, int]) -> str:
    """What was broken by a death at one point, empty if nothing."""
    with tempfile.TemporaryDirectory() as folder:
        try:
            die_and_resume(Path(folder), *point, clean)
        except Exception as promise:  # whatever a mission raises, the others are flown too
            return words(promise)
    return ""


def _points(arguments: argparse.Namespace, clean: Undisturbed) -> list[tuple[When, int]]:
    whens = [When[arguments.when]] if arguments.when else list(When)
    points = [(when, at) for when in whens for at in clean.points(when)]
    return [point for point in points if arguments.at in (None, point[1])][arguments.first - 1 :: arguments.every]


def _kinds(clean: Undisturbed, points: list[tuple[When, int]]) -> Counter[str]:
    return Counter(f"{when.value} {clean.log[at - 1].partition(' ')[0]}" for when, at in points)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--when", choices=[when.name for when in When], help="only this one")
    parser.add_argument("--at", type=int, help="only at this operation")
    parser.add_argument("--first", type=int, default=1, help="the first of all points")
    parser.add_argument("--every", type=int, default=1, help="only every so many of them")
    parser.add_argument("--at-once", type=int, default=2, help="missions side by side")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
