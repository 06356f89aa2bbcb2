"""Does the building's pose graph help? Rings of corridors, scanned once round, with and without a false comparison.

    python -m benchmarks.pose_graph [--seeds 6] [RUN ...]

Each seed is another building, another instrument (its systematic range error) and other guesses. The chain is either
what a mission makes, every scan registered to all that stands in the map, or one that drifts more, every scan
registered to the one before it alone. Runs of simulated missions, given by their folders, are judged in the same way;
their truth is in them.
"""

import argparse
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from drivers.simulated.profile import ScannerProfile
from drivers.simulated.scanner import SimulatedScanner
from drivers.simulated.truth_log import read_truth
from drivers.simulated.worlds.assembly import build_plan
from drivers.simulated.worlds.plan import DoorPlan, Plan, RoomPlan
from mission.evaluation.survey import true_poses
from mission.report.run import read_run
from mission.store import RunFolder
from perception import pose_graph, registration, transforms
from perception.failure import FailureError
from perception.matching.surfels import Surface, surface_of
from perception.pose_graph import Comparison
from perception.transforms import Matrix

WIDTH, LENGTH, DEPTH, WALL = 2.2, 26.0, 18.0, 0.15
STEP = np.deg2rad(0.4)
FALSE_M = (0.01, 0.03, 0.10, 0.50)
FALSE_DRAWS = 20


@dataclass(frozen=True)
class Chain:
    """Scans as a mission registered them, and the truth (relative to the first)."""

    name: str
    surfaces: dict[str, Surface]
    poses: dict[str, Matrix]
    truth: dict[str, Matrix]

    def worst(self, poses: dict[str, Matrix]) -> float:
        """Largest error of a pose, metres."""
        return max(transforms.difference(self.truth[name], poses[name])[0] for name in poses)


def ring_plan() -> Plan:
    """Four corridors round a closed core, joined at the corners by doorways; boards, lamps and radiators inside."""
    furniture = {"lamp": 4, "board": 3, "radiator": 2, "cabinet": 2}
    inner = WIDTH + WALL
    boxes = {
        "south": (0.0, 0.0, LENGTH, WIDTH),
        "east": (LENGTH - WIDTH, inner, LENGTH, DEPTH - inner),
        "north": (0.0, DEPTH - WIDTH, LENGTH, DEPTH),
        "west": (0.0, inner, WIDTH, DEPTH - inner),
    }
    corners = [("south", x, WIDTH) for x in (WIDTH / 2, LENGTH - WIDTH / 2)]
    corners += [("north", x, DEPTH - WIDTH) for x in (WIDTH / 2, LENGTH - WIDTH / 2)]
    return Plan(
        name="ring",
        rooms={name: RoomPlan(box=box, seeded=furniture) for name, box in boxes.items()},
        doors=tuple(DoorPlan(room=room, at=(x, y), width=1.4, leaf=0) for room, x, y in corners),
    )


def once_round() -> list[tuple[float, float]]:
    """Places down the middle of the corridors, in each of the doorways, and again near the first one."""
    middle, right, top = WIDTH / 2, LENGTH - WIDTH / 2, DEPTH - WIDTH / 2
    jamb = WIDTH + WALL / 2
    south = [(x, middle) for x in (6.0, 11.0, 16.0, 21.0, right)]
    east = [(right, y) for y in (jamb, 6.0, 11.0, DEPTH - jamb)]
    north = [(x, top) for x in (right, 20.0, 15.0, 10.0, 5.0, middle)]
    west = [(middle, y) for y in (DEPTH - jamb, 12.0, 7.0, jamb)]
    return [*south, *east, *north, *west, (middle, middle)]


def ring(seed: int, look_back: int) -> Chain:
    """A ring that was scanned once round, each scan registered to so many of those before it."""
    rng = np.random.default_rng([seed, 31])
    scanner = SimulatedScanner(build_plan(ring_plan(), seed), ScannerProfile(), seed)
    surfaces: dict[str, Surface] = {}
    poses: dict[str, Matrix] = {}
    truth: dict[str, Matrix] = {}
    for number, (x, y) in enumerate(once_round(), 1):
        name = f"S{number:02d}"
        base = transforms.planar(x, y, rng.uniform(-np.pi, np.pi))
        tilt = tuple(rng.normal(0.0, 0.005, 2))
        truth[name] = scanner.map_from_scanner(base, tilt)
        surfaces[name] = surface_of(scanner.cast(base, STEP, name, np.eye(4), tilt).points)
        guess = truth[name] @ transforms.planar(*rng.normal(0.0, 0.05, 2), rng.normal(0.0, 0.01))
        known = [(surfaces[other], poses[other]) for other in list(poses)[-look_back:]]
        poses[name] = truth[name] if not known else _registered(surfaces[name], known, guess)
    against = "the map" if look_back >= len(poses) else "the scan before"
    return Chain(f"ring {seed}, registered to {against}", surfaces, poses, truth)


def _registered(surface: Surface, known: Sequence[tuple[Surface, Matrix]], guess: Matrix) -> Matrix:
    reference = registration.reference_from(known, (float(guess[0, 3]), float(guess[1, 3])), 20.0)
    return registration.register(surface, reference, guess).map_from_scanner


def of_run(folder: Path) -> Chain:
    """The scans of a simulated mission's run folder, as they were registered before any adjustment."""
    run = read_run(folder)
    true = true_poses(run, read_truth(RunFolder(run.folder).simulation))
    registered = {e["scan_id"]: np.asarray(e["map_from_scanner"], float) for e in run.events_of("registered")}
    surfaces = {record["scan_id"]: surface_of(scan.points) for record, _, scan in run.clouds()}
    poses = {name: registered[name] for name in surfaces}
    first = next(iter(poses))
    map_from_world = poses[first] @ transforms.inverse(true[first])
    return Chain(run.name, surfaces, poses, {name: map_from_world @ true[name] for name in poses})


def compared(chain: Chain) -> tuple[list[Comparison], int]:
    """All comparisons that fit, and the number of those that do not."""
    footprints = {name: pose_graph.footprint(chain.surfaces[name], pose) for name, pose in chain.poses.items()}
    pairs, refused = [], 0
    for a, b in pose_graph.pairs_to_compare(footprints):
        guess = transforms.inverse(chain.poses[a]) @ chain.poses[b]
        try:
            pairs.append(pose_graph.compare((a, chain.surfaces[a]), (b, chain.surfaces[b]), guess))
        except FailureError:
            refused += 1
    return pairs, refused


def with_a_false_one(chain: Chain, pairs: Sequence[Comparison], metres: float) -> Iterator[list[Comparison]]:
    """The comparisons with one more: two scans that see nothing of each other, said to be off by so much."""
    rng = np.random.default_rng(int(1000 * metres))
    names, known = list(chain.poses), {(pair.target, pair.source) for pair in pairs}
    strangers = [(a, b) for n, a in enumerate(names) for b in names[n + 1 :] if (a, b) not in known]
    for _ in range(FALSE_DRAWS):
        a, b = strangers[rng.integers(len(strangers))]
        way = rng.normal(size=2)
        off = transforms.planar(*(metres * way / np.linalg.norm(way)), rng.normal(0.0, metres / 10))
        model = pairs[rng.integers(len(pairs))]
        said = transforms.inverse(chain.poses[a]) @ chain.poses[b] @ off
        yield [*pairs, replace(model, target=a, source=b, target_from_source=said)]


def row(chain: Chain) -> str:
    began = time.process_time()
    pairs, refused = compared(chain)
    seconds = time.process_time() - began
    began = time.process_time()
    found = pose_graph.optimise(chain.poses, pairs)
    solving = time.process_time() - began
    false = [
        max(
            chain.worst(dict(pose_graph.optimise(chain.poses, more).poses))
            for more in with_a_false_one(chain, pairs, m)
        )
        for m in FALSE_M
    ]
    figures = [1000 * value for value in (chain.worst(chain.poses), chain.worst(dict(found.poses)), *false)]
    return (
        f"{chain.name:38s} {len(chain.poses):5d} {len(pairs):5d} {refused:3d} "
        + " ".join(f"{value:7.1f}" for value in figures)
        + f" {1000 * found.moved_m:6.1f} {1000 * found.rms_before:6.2f} {1000 * found.rms_after:6.2f}"
        + f" {seconds / max(1, len(pairs)):7.3f} {solving:6.3f}  {found.reason}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=6)
    parser.add_argument("runs", type=Path, nargs="*")
    arguments = parser.parse_args()
    print("worst pose error, mm: of the chain, after optimisation, and with a false comparison off by so many cm")
    false = " ".join(f"{f'{100 * metres:.0f} cm':>7s}" for metres in FALSE_M)
    print(f"{'':38s} scans pairs ref   chain   graph {false}  moved rms mm  after  s/pair  solve")
    for seed in range(arguments.seeds):
        for look_back in (1000, 1):
            print(row(ring(seed, look_back)), flush=True)
    for folder in arguments.runs:
        print(row(of_run(folder)), flush=True)


if __name__ == "__main__":
    main()
