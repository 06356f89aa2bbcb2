"""Missions over many buildings and seeds, each in processes of its own; prints the tables of the README.

    python -m benchmarks.campaign school --seeds 5
    python -m benchmarks.campaign procedural --seeds 20
    python -m benchmarks.campaign buildings

Each mission's figures are kept in ``--out``; a campaign that was broken off goes on where it stopped. Ends with 1 where
a mission came to no report, left out a room that can be reached, ran into something, or has a pose that is off.
"""

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from tests.shared_data import BUILDINGS

REAL = (
    ("AC20-FZK-Haus.ifc", ()),
    ("bimwhale_LargeBuilding.ifc", ()),
    ("aws_hospital.glb", ("--floor", "0.18", "--ceiling", "3.0")),
)
POSE_M, POSE_DEG = 0.01, 0.1
"""How far a pose may be from the truth."""
_ENDS = ("complete", "incomplete")
"""Of a mission that did what it could: an entry may stay partial where its room was finished through another."""
COLUMNS = (
    ("rooms", lambda r: f"{r['rooms_finished']}/{r['rooms_reachable']}"),
    ("scans", lambda r: str(r["scans"])),
    ("collisions", lambda r: str(r["collisions"])),
    ("worst pose", lambda r: f"{1000 * r['pose_error_max_m']:.1f} mm, {r['pose_error_max_deg']:.3f}°"),
    ("sensed", lambda r: f"{r['sensed_fraction']:.1%}"),
    ("of coverable", lambda r: f"{r['sensed_of_coverable']:.1%}"),
    ("doors P/R", lambda r: f"{r['doors_precision']:.2f}/{r['doors_recall']:.2f}"),
    ("outcome", lambda r: r["outcome"]),
    ("wall", lambda r: f"{r['wall_s']:.0f} s"),
)


def main() -> int:
    arguments = _arguments()
    arguments.out.mkdir(parents=True, exist_ok=True)
    rows = []
    for name, world, seed, options in _missions(arguments):
        kept = arguments.out / f"{name}-{seed}.json"
        if not kept.exists():
            command = ["--seed", str(seed), "--step", str(arguments.step), "--speed", str(arguments.speed)]
            kept.write_text(json.dumps(fly(world, [*command, *options], arguments.out)))
        row = json.loads(kept.read_text())
        rows.append((name, seed, row))
        print(_line(name, seed, row), flush=True)
    print("\n" + table(rows))
    bad = [f"{name} {seed}: {'; '.join(found)}" for name, seed, row in rows if (found := shortcomings(row))]
    print("\n".join(bad))
    return 1 if bad else 0


def shortcomings(row: dict[str, Any]) -> list[str]:
    """What one mission fell short of, in words; one that the truth cannot judge must have come to its report."""
    if "rooms_finished" not in row:
        return [] if row["outcome"] in _ENDS else [f"{row['outcome']} {row.get('error', '')[-300:]}".strip()]
    found = [] if row["outcome"] in _ENDS else [str(row["outcome"])]
    missed = (row["rooms_reachable"] or 0) - row["rooms_finished"]
    found += [f"{missed} rooms not finished"] * (missed > 0)
    found += [f"{row['collisions']} collisions"] * (row["collisions"] > 0)
    if not (row["pose_error_max_m"] <= POSE_M and row["pose_error_max_deg"] <= POSE_DEG):
        found.append(f"a pose is {1000 * row['pose_error_max_m']:.1f} mm, {row['pose_error_max_deg']:.3f}° off")
    return found


def fly(world: str, options: list[str], out: Path) -> dict[str, Any]:
    """One mission by the command line; its summary and its evaluation, or the way it ended."""
    began = time.monotonic()
    command = [sys.executable, "-m", "mission", "simulate", world, *options, "--out", str(out / "runs"), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if not done.stdout.strip():
        return {"outcome": f"exit {done.returncode}", "error": done.stderr[-2000:], "wall_s": time.monotonic() - began}
    summary = json.loads(done.stdout.splitlines()[-1])
    evaluation = subprocess.run(
        [sys.executable, "-m", "mission", "evaluate", summary["run"], "--json"],
        capture_output=True,
        text=True,
        check=True,
    )
    return json.loads(evaluation.stdout) | summary | {"rooms_detail": summary["rooms"]}


def table(rows: list[tuple[str, int, dict[str, Any]]]) -> str:
    """Markdown: a row for each mission, and the totals."""
    head = "| building | seed | " + " | ".join(name for name, _ in COLUMNS) + " |"
    lines = [head, "|" + "---|" * (len(COLUMNS) + 2)]
    lines += [_line(name, seed, row) for name, seed, row in rows]
    good = [row for _, _, row in rows if "sensed_fraction" in row]
    if good:
        lines.append("")
        lines.append(_totals(good, len(rows)))
    return "\n".join(lines)


def _line(name: str, seed: int, row: dict[str, Any]) -> str:
    cells = [_cell(show, row) for _, show in COLUMNS]
    return f"| {name} | {seed} | " + " | ".join(cells) + " |"


def _cell(show: Any, row: dict[str, Any]) -> str:
    try:
        return str(show(row))
    except (KeyError, TypeError):
        return "–"


def _totals(rows: list[dict[str, Any]], flown: int) -> str:
    def total(key: str) -> float:
        return sum(row[key] for row in rows)

    def mean(key: str) -> float:
        return total(key) / len(rows)

    return (
        f"{len(rows)} of {flown} missions evaluated: "
        f"{total('rooms_finished'):.0f} of {total('rooms_reachable'):.0f} rooms, "
        f"{total('collisions'):.0f} collisions, worst pose {1000 * max(r['pose_error_max_m'] for r in rows):.1f} mm / "
        f"{max(r['pose_error_max_deg'] for r in rows):.3f}°, sensed {mean('sensed_fraction'):.1%} in the mean "
        f"(least {min(r['sensed_fraction'] for r in rows):.1%}), of coverable {mean('sensed_of_coverable'):.1%}, "
        f"scans {mean('scans'):.1f} in the mean"
    )


def _missions(arguments: argparse.Namespace) -> list[tuple[str, str, int, list[str]]]:
    if arguments.what == "buildings":
        present = [(name, options) for name, options in REAL if (BUILDINGS / name).exists()]
        return [(Path(name).stem, str(BUILDINGS / name), 0, list(options)) for name, options in present]
    return [
        (arguments.what, arguments.what, seed, []) for seed in range(arguments.first, arguments.first + arguments.seeds)
    ]


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("what", choices=("school", "procedural", "buildings"), nargs="?", default="school")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--seeds", type=int, default=5, help="how many seeds, from --first on")
    parser.add_argument("--step", type=float, default=0.2)
    parser.add_argument("--speed", type=float, default=15.0)
    parser.add_argument("--out", type=Path, default=Path("runs/campaign"))
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
