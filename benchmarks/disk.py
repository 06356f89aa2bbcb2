"""A disk that fails at every operation of a mission in turn: ``python -m benchmarks.disk``.

One mission for each operation and way (full until room is made, an error once, a short write once): nothing half
written may be seen, no scan be lost or taken twice, and the mission holds and goes on, or ends with a code and is
resumed. Prints what failed how, and one command for each mission that broke a promise; ends with 1 then.
"""

import argparse
import sys
import tempfile
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

from benchmarks.promises import words
from mission.run import Summary
from tests.scenarios.bad_disk import BadDisk, Way
from tests.scenarios.kept import Kept, survive


def main() -> int:
    arguments = _arguments()
    operations, clean = undisturbed()
    ways = [Way[arguments.way]] if arguments.way else list(Way)
    picked = [arguments.at] if arguments.at else range(arguments.first, operations + 1, arguments.every)
    told: Counter[tuple[str, str]] = Counter()
    broken = 0
    for way in ways:
        for at in picked:
            with tempfile.TemporaryDirectory() as folder:
                try:
                    told[way.value, survive(Path(folder), way, at, clean)] += 1
                except Exception as promise:  # whatever a mission raises, the others are flown too
                    broken += 1
                    print(f"python -m benchmarks.disk --way {way.name} --at {at}: {words(promise)}", flush=True)
    print(f"{operations} operations in a mission; {told.total() + broken} missions flown, {broken} broke a promise")
    for line in _table(told):
        print(line)
    return 1 if broken else 0


def undisturbed() -> tuple[int, list[str]]:
    """How often a mission with a good disk asks it, and the scans that it takes."""
    with tempfile.TemporaryDirectory() as folder:
        kept = Kept(Path(folder))
        disk = BadDisk(kept.run.path, Way.FULL, None)
        end = kept.fly(disk)
        assert isinstance(end, Summary) and end.outcome == "complete", f"with a good disk: {end}"
        assert kept.scanner.taken and kept.errors == []
        kept.assert_folder_is_whole()
        return len(disk.log), list(kept.scanner.taken)


def _table(told: Counter[tuple[str, str]]) -> Iterator[str]:
    yield "| way | what the mission did | missions |"
    yield "|---|---|---|"
    did: Counter[tuple[str, str]] = Counter()
    for (way, what), count in told.items():
        did[way, what.partition(": ")[2]] += count
    for (way, what), count in sorted(did.items()):
        yield f"| {way} | {what} | {count} |"


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--way", choices=[way.name for way in Way], help="only this one")
    parser.add_argument("--at", type=int, help="only at this operation")
    parser.add_argument("--first", type=int, default=1)
    parser.add_argument("--every", type=int, default=1, help="only every so many operations")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
