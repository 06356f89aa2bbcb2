"""The worker's memory and time over a building that grows to sixty scans of five million points.

``python -m benchmarks.memory [--scans 60]`` runs all stages of every cycle in the real worker process and prints its
peak of resident memory and the processor seconds of each cycle (the wall's are its neighbours' too); ends with 1 where
a bar is missed. The building is the school's largest room again and again, side by side: its scans are rendered once,
given fresh noise and another odometry, and stored as new ones.
"""

import argparse
import math
import os
import sys
import tempfile
import time
from dataclasses import dataclass, replace
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from drivers import scan_file
from drivers.jobs import Failed, Job, Running
from mission.store import RunFolder
from mission.worker import PerceptionWorker
from perception import transforms
from perception.transforms import Matrix

PER_ROOM = 6
PITCH_M = 14.0
"""From one copy of the room to the next; what a scan saw beyond half of it, through doors and windows, is left out,
for it would contradict the next copy."""
MIDDLE_X = 4.3
NOISE_M = 0.001
GUESS = (0.06, -0.04, 0.01)
"""Error of the odometry of every scan: x, y in metres, yaw in radians."""
WORKER_BAR_MB, RATIO_BAR, EARLY = 1500, 1.2, 5
RULES = {"avoid": (), "rule": "graded", "gain": "all", "path_clearance": 0.36, "goal_clearance": 0.58}


@dataclass(frozen=True)
class Cycle:
    """After one scan: processor seconds of each stage, the worker's memory now and at its highest, megabytes."""

    scan: int
    seconds: dict[str, float]
    resident: float
    peak: float

    @property
    def total(self) -> float:
        return sum(self.seconds.values())


class NoJournal:
    """Keeps nothing: the seconds are taken here."""

    def record(self, event: str, **fields: object) -> None: ...


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scans", type=int, default=60)
    cycles = rows(parser.parse_args().scans)
    early, last = cycles[min(EARLY, len(cycles)) - 1], cycles[-1]
    print(f"worker's peak after {len(cycles)} scans: {last.peak:.0f} MB (bar {WORKER_BAR_MB})")
    # Cycle by cycle the stations differ in points, so that one pair of cycles may flatter or slander.
    first, final = (sum(cycle.total for cycle in part) / len(part) for part in (cycles[:PER_ROOM], cycles[-PER_ROOM:]))
    print(f"mean of the last {PER_ROOM} cycles over the first {PER_ROOM}: {final / first:.2f} (bar {RATIO_BAR})")
    print(f"cycle {last.scan} over cycle {early.scan}: {last.total / early.total:.2f}")
    for stage in last.seconds:
        print(f"  {stage:16s} {early.seconds[stage]:6.2f} s -> {last.seconds[stage]:6.2f} s")
    print(f"the process that asks: {_memory('self')[1]:.0f} MB")
    return 0 if last.peak <= WORKER_BAR_MB and final / first <= RATIO_BAR else 1


def rows(scans: int = 60) -> list[Cycle]:
    """Run so many cycles, printing each as it ends."""
    with tempfile.TemporaryDirectory() as name:
        run = RunFolder.at(Path(name))
        building = _Building(run)
        try:
            cycles = []
            for number in range(1, scans + 1):
                cycles.append(building.cycle(number))
                last = cycles[-1]
                print(f"scan {number:3d}  {last.total:6.2f} s  {last.resident:6.0f} MB  peak {last.peak:6.0f} MB")
            return cycles
        finally:
            building.close()


class _Building:
    """The tree's books, kept by hand."""

    def __init__(self, run: RunFolder) -> None:
        self._run = run
        self._worker = PerceptionWorker(run.path, NoJournal(), deadline=600.0)
        self._placed: list[tuple[str, list[list[float]]]] = []
        self._shapes: list[Any] = []
        self._map_id: str | None = None
        self._seconds: dict[str, float] = {}
        _value(self._worker.submit("warm_up"))

    def close(self) -> None:
        self._worker.close()

    def cycle(self, number: int) -> Cycle:
        self._seconds = {}
        scan_id, room = f"S{number:03d}", (number - 1) // PER_ROOM
        guess = _in_own_process(self._run.scan_file(scan_id), number)
        self._stage("validate_scan", scan_id=scan_id)
        self._stage("align_scan", scan_id=scan_id)
        pose = self._place(scan_id, guess)
        self._placed.append((scan_id, pose.tolist()))
        self._map_and_look(number, room, scan_id, pose)
        return Cycle(number, self._seconds, *_memory(str(_child())))

    def _place(self, scan_id: str, true: Matrix) -> Matrix:
        """Each copy of the room is new to the others: its first scan has nothing to be registered to but the truth."""
        room = [scan for scan in self._placed if _room_of(scan[0]) == _room_of(scan_id)]
        if not room:
            self._stage("anchor_scan", scan_id=scan_id)
            self._seconds["register_scan"] = self._seconds.pop("anchor_scan")
            return true
        guess = transforms.planar(*GUESS[:2], 0.0) @ true @ transforms.from_euler(0, 0, GUESS[2])
        trust = {"error_m": 0.3, "error_rad": math.radians(4)}
        found = self._stage("register_scan", scan_id=scan_id, guess=guess.tolist(), reference=self._placed, **trust)
        distance, angle = transforms.difference(true, found.map_from_scanner)
        if distance > 0.03 or angle > math.radians(0.3):
            raise RuntimeError(f"{scan_id} is {distance:.3f} m off")
        return np.asarray(found.map_from_scanner)

    def _map_and_look(self, number: int, room: int, scan_id: str, pose: Matrix) -> None:
        near = [scan for scan in self._placed if _room_of(scan[0]) in (room, room - 1)]
        own = [scan for scan in near if _room_of(scan[0]) == room]
        track = [transforms.to_planar(np.asarray(station)) for _, station in self._placed]
        seed = tuple(np.asarray(own[0][1])[:2, 3])
        place = {"room_id": f"R{room}", "cycle": len(own)}
        previous = self._shapes[room] if len(self._shapes) > room else None
        if previous is not None:
            self._stage("find_movement", scan_id=scan_id, pose=pose.tolist(), earlier=near[:-1], shape=previous)
        others = [shape.contour for shape in self._shapes[:room]]
        shape = self._stage("segment_room", **place, seed=seed, scans=near, doors=(), others=others, previous=previous)
        self._shapes[room:] = [shape]
        books = {"shape": shape, "doors": (), "previous": self._map_id, "track": track}
        self._map_id = self._stage("build_map", **place, scan_id=scan_id, pose=pose.tolist(), **books).map_id
        self._stage("label_space", **place, shape=shape, scans=near, voxel=0.1, labeller="range")
        where = {"scan_id": scan_id, "pose": track[-1], "stations": own, "track": track, "map_id": self._map_id}
        self._stage("choose_view", **place, shape=shape, **where, **RULES)
        self._stage("find_doors", room_id=place["room_id"], shape=shape, scans=near)

    def _stage(self, name: str, **arguments: object) -> Any:
        began = _processor_seconds(_child())
        value = _value(self._worker.submit(name, **arguments))
        self._seconds[name] = _processor_seconds(_child()) - began
        return value


def _value(job: Job) -> Any:
    while isinstance(outcome := job.poll(), Running):
        time.sleep(0.002)
    if isinstance(outcome, Failed):
        raise RuntimeError(outcome.failure)
    return outcome.value


def _room_of(scan_id: str) -> int:
    return (int(scan_id[1:]) - 1) // PER_ROOM


def _in_own_process(path: Path, number: int) -> Matrix:
    """Store scan ``number`` from a process that ends, so that rendering leaves nothing behind in this one."""
    context = get_context("spawn")
    ours, theirs = context.Pipe()
    process = context.Process(target=_store, args=(path, number, theirs))
    process.start()
    theirs.close()
    pose = ours.recv()
    process.join()
    return np.asarray(pose)


def _store(path: Path, number: int, answer: Any) -> None:
    """Write scan ``number`` of the building and answer its true ``map_from_scanner``."""
    from benchmarks.data import STATIONS, placed

    room, station = divmod(number - 1, PER_ROOM)
    rendered = placed(STATIONS[station], f"S{station + 1:02d}")
    scan, shift = rendered.scan, transforms.planar(PITCH_M * room, 0.0, 0.0)
    x = transforms.apply(rendered.map_from_scanner, scan.points)[:, 0]
    scan = scan.without(np.flatnonzero(np.abs(x - MIDDLE_X) > PITCH_M / 2))
    ranges = np.linalg.norm(scan.points, axis=1)
    noise = np.random.default_rng(number).normal(0.0, NOISE_M, len(ranges)).astype(np.float32)
    points = scan.points * (1 + noise / ranges)[:, None]
    new = replace(scan, scan_id=path.stem, points=points, odom_from_base=shift @ scan.odom_from_base)
    scan_file.write(path, new)
    answer.send((shift @ rendered.map_from_scanner).tolist())
    answer.close()


def _child() -> int:
    """The worker's process: the one child that lasts."""
    task = Path("/proc/self/task")
    children = [child for thread in task.iterdir() for child in (thread / "children").read_text().split()]
    return max((int(child) for child in children), key=lambda child: _memory(str(child))[1])


def _processor_seconds(process: int) -> float:
    """Of all threads of a process so far, its own and the kernel's for it."""
    user, system = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[11:13]
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


def _memory(process: str) -> tuple[float, float]:
    """Resident memory of a process now and at its highest, megabytes."""
    status = dict(
        line.split(":", 1) for line in Path(f"/proc/{process}/status").read_text().splitlines() if ":" in line
    )
    return tuple(int(status[key].split()[0]) / 1024 for key in ("VmRSS", "VmHWM"))  # type: ignore[return-value]


if __name__ == "__main__":
    sys.exit(main())
