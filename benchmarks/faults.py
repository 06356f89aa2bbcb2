"""Missions with faults drawn from seeds, on the virtual clock: ``python -m benchmarks.faults --missions 500``.

Each must end in a declared state with the base at rest, its log complete, and every shortfall with a named cause.
Prints one command for each that did not, and ends with 1 then. ``--held`` instead holds every fault for good, from
the first call of every operation, and prints how long each mission took to end, or to ask.
"""

import argparse
import sys
from collections import Counter
from collections.abc import Callable
from functools import partial

from benchmarks.promises import words
from tests.scenarios.faults import EVENTS, OPERATIONS, ways_of
from tests.scenarios.ordeal import Ordeal, by_chance, held, lasting


def main() -> int:
    arguments = _arguments()
    if arguments.held:
        return _hold_all()
    if arguments.seed is not None:
        print(by_chance(arguments.seed))
        return 0
    flown, broken = [], 0
    for seed in range(arguments.first, arguments.first + arguments.missions):
        ordeal = _tried(partial(by_chance, seed), f"python -m benchmarks.faults --seed {seed}")
        flown += [] if ordeal is None else [ordeal]
        broken += ordeal is None
    _tell(flown, broken)
    return 1 if broken else 0


def _tried(fly: Callable[[], Ordeal], command: str) -> Ordeal | None:
    try:
        return fly()
    except Exception as broken:  # whatever a mission raises, the others are flown too
        print(f"{command}: {words(broken)}", flush=True)
        return None


def _tell(flown: list[Ordeal], broken: int) -> None:
    outcomes = Counter(ordeal.outcome for ordeal in flown)
    print(f"{len(flown) + broken} missions, {broken} broke a promise")
    print(", ".join(f"{outcome} {count}" for outcome, count in outcomes.most_common()))
    codes = Counter(code for ordeal in flown for code in set(ordeal.codes))
    print("missions that met each code: " + ", ".join(f"{code} {count}" for code, count in codes.most_common()))
    if flown:
        longest = max(flown, key=lambda ordeal: ordeal.seconds)
        hours, faults = longest.seconds / 3600, "; ".join(longest.faults)
        print(f"longest: {hours:.1f} h of the mission, {longest.ticks} ticks ({faults})")


def _hold_all() -> int:
    rows: list[Ordeal | None] = []
    print("| fault, held for good | outcome | ticks | mission min | asked after min |")
    print("|---|---|---|---|---|")
    for operation in OPERATIONS:
        for way in ways_of(operation):
            rows.append(_tried(partial(held, operation, way, attended=True), f"{operation} {way}"))
            _show(rows[-1])
    for name in EVENTS:
        if name != "pause":
            rows.append(_tried(partial(lasting, name), name))
            _show(rows[-1])
    return 1 if None in rows else 0


def _show(ordeal: Ordeal | None) -> None:
    if ordeal is not None:
        asked = "" if ordeal.asked is None else f"{ordeal.asked / 60:.0f}"
        print(f"| {ordeal.faults[0]} | {ordeal.outcome} | {ordeal.ticks} | {ordeal.seconds / 60:.0f} | {asked} |")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--missions", type=int, default=500)
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--seed", type=int, help="fly this one only")
    parser.add_argument("--held", action="store_true", help="hold every fault for good instead")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
