"""Each guard removed in turn: does a test notice? `python -m benchmarks.guards [WORD ...]`.

The tree is copied to a temporary folder; there one guard of `guards.yaml` at a time is taken out by its patch, and the
tests that should notice are run. Prints a line for each: the guard, and the first test that failed without it. Ends
with 1 when a guard could be removed unnoticed. A patch that no longer applies is an error that names it: the guard has
moved, and so must its patch. Words choose the guards whose names have all of them.
"""

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import yaml

ROOT = Path(__file__).parents[1]
PRODUCT = ("perception", "drivers", "behaviours", "trees", "mission")
PATIENCE_S = 300.0
ATTEMPTS = 3
"""On a busy machine a test may fail for want of time."""


@dataclass(frozen=True)
class Guard:
    """One guard: how the text that has it, once in the whole product, reads without; and who should notice."""

    name: str
    there: str
    instead: str
    tests: tuple[str, ...]

    def file(self, tree: Path) -> Path:
        """Where it stands, whatever its module is called by now."""
        sources = (path for part in PRODUCT for path in (tree / part).rglob("*.py"))
        found = [path for path in sources if self.there in path.read_text(encoding="utf-8")]
        if len(found) != 1 or found[0].read_text(encoding="utf-8").count(self.there) != 1:
            places = ", ".join(str(path.relative_to(tree)) for path in found) or "nowhere"
            raise SystemExit(
                f"{self.name}: the text to take out must stand in one place, found {places}:\n{self.there}"
            )
        return found[0]


def guards() -> list[Guard]:
    """All of ``guards.yaml``."""
    rows = yaml.safe_load(Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8"))
    return [Guard(row["guard"], row["there"], row["instead"], tuple(row["tests"])) for row in rows]


def copied(folder: Path) -> Path:
    """The tree, with what numba compiled, for its cache goes by the time of the source."""
    tree = folder / "tree"
    left_out = shutil.ignore_patterns(".git", ".venv", "runs", "*.pyc", ".mypy_cache", ".ruff_cache", ".pytest_cache")
    shutil.copytree(ROOT, tree, ignore=left_out)
    return tree


def noticed(tree: Path, tests: Iterable[str]) -> str:
    """The first test that fails in a tree, empty if none does; one that does not end has noticed too."""
    command = [sys.executable, "-m", "pytest", "-x", "-p", "no:cacheprovider", "-rfE", *tests]
    environment = os.environ | {"PYTHONDONTWRITEBYTECODE": "1"}
    try:
        told = subprocess.run(command, cwd=tree, env=environment, capture_output=True, text=True, timeout=PATIENCE_S)
    except subprocess.TimeoutExpired:
        return f"no end within {PATIENCE_S:.0f} s"
    if told.returncode == 0:
        return ""
    failed = re.search(r"^(?:FAILED|ERROR) (\S+\.py::.+?)(?: - .*)?$", told.stdout, re.MULTILINE)
    if failed is None:  # what cannot even be loaded says nothing of the guard
        raise SystemExit(f"{' '.join(command)} says neither yes nor no:\n{told.stdout[-2000:]}{told.stderr[-2000:]}")
    return failed[1]


def removed(guard: Guard, tree: Path) -> str:
    """What notices that a guard is gone, and fails for nothing else."""
    for _ in range(ATTEMPTS):
        by = _without(guard, tree)
        # No test is named where they came to no end: then none of them may fail to with every guard in its place.
        if not by or not noticed(tree, [by] if "::" in by else guard.tests):
            return by
    raise SystemExit(f"{guard.name}: {by}, and with every guard in its place something fails too")


def _without(guard: Guard, tree: Path) -> str:
    path = guard.file(tree)
    text, times = path.read_text(encoding="utf-8"), path.stat()
    try:
        path.write_text(text.replace(guard.there, guard.instead), encoding="utf-8")
        return noticed(tree, guard.tests)
    finally:
        path.write_text(text, encoding="utf-8")
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))


def main() -> None:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("words", nargs="*", help="only guards whose names have all of these")
    asked = parser.parse_args()
    chosen = [guard for guard in guards() if all(word in guard.name for word in asked.words)]
    with tempfile.TemporaryDirectory() as folder:
        tree = copied(Path(folder))
        for guard in chosen:
            guard.file(tree)
        unnoticed = 0
        for guard in chosen:
            began = time.monotonic()
            by = removed(guard, tree)
            unnoticed += not by
            print(f"{guard.name:58} {by or 'NOBODY NOTICES'}  ({time.monotonic() - began:.0f} s)", flush=True)
    print(f"{len(chosen)} guards, {unnoticed} of which can be removed unnoticed")
    raise SystemExit(1 if unnoticed else 0)


if __name__ == "__main__":
    main()
