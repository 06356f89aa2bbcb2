"""How fast the wheels stand when the executive dies, hangs or is cut off, and what it still moves when it comes back.

``python -m benchmarks.dead_man --rounds 50``: the tests' bench, as often as it takes to be believed. Ends with 1 when a
promise was broken.
"""

import argparse
import random
import sys
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np

from tests.drivers.dead_man import FAULTS, PROMISE_S, Bench, Halt, bench, halts_by, halts_by_kill, obeyed_after_takeover

ROW = "{:<10} {:>4} {:>11} {:>11} {:>11} {:>13} {:>12}"


def pauses(seed: int) -> Iterator[float]:
    chance = random.Random(seed)
    return iter(lambda: chance.uniform(0.1, 0.6), None)


def tell(fault: str, halts: Iterable[Halt]) -> bool:
    """One row of the table; whether the promise was kept each time."""
    taken = list(halts)
    after = 1000 * np.array([halt.after for halt in taken])
    starved = 1000 * max(halt.starved for halt in taken)
    over = sum(halt.after > PROMISE_S for halt in taken)
    broken = sum(not halt.kept for halt in taken)
    print(
        ROW.format(fault, len(taken), f"{np.median(after):.0f}", f"{after.max():.0f}", over, f"{starved:.0f}", broken)
    )
    sys.stdout.flush()
    return not broken


def takeovers(rig: Bench, rounds: int) -> bool:
    obeyed = {
        fault: sum(obeyed_after_takeover(fault, rig, f"{fault} {n}") for n in range(rounds))
        for fault in ("SIGSTOP", "link cut")
    }
    for fault, count in obeyed.items():
        print(f"{fault}, takeover, and back: {rounds} times, {count} old orders or beats obeyed")
    return not any(obeyed.values())


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    print("Milliseconds from the last valid beat to wheels at rest, and the longest that this process was not let run.")
    print(ROW.format("fault", "n", "median", "worst", "over 500", "not let run", "broken"))
    with tempfile.TemporaryDirectory() as folder, bench(Path(folder)) as rig:
        kept = [tell(fault, halts_by(fault, rig, options.rounds, pauses(options.seed))) for fault in FAULTS]
        kept.append(tell("kill -9", halts_by_kill(rig, options.rounds, pauses(options.seed))))
        kept.append(takeovers(rig, options.rounds))
    return 0 if all(kept) else 1


if __name__ == "__main__":
    sys.exit(main())
