"""Recorded scans of real places through ``mission process``: what works, what fails and why, as one table.

    python -m benchmarks.real_scans [--data ../shared/data/scans] [--only NAME ...] [--pictures docs/pictures]

Three tables: each scan by itself; each consecutive pair against the pose that came with the data, where any did; and
scans of different places offered to each other, every one of which must be refused.
"""

import argparse
import math
import tempfile
from collections.abc import Callable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.spatial import cKDTree

from drivers import scan_file
from mission.process import process_folder
from perception import alignment, global_registration, registration, transforms
from perception.failure import FailureError
from perception.matching import surfels
from perception.transforms import Matrix
from tests.shared_data import SCANS

BAR_M, BAR_DEG = 0.05, 0.5
OVERLAP = 0.30
GOOD_SHARE = 0.95
ANY_HEIGHT = (0.2, 2.2)
NEAR = 0.03

Row = dict[str, Any]


def published_guess(folder: Path) -> Matrix:
    """PCL's tutorial on the normal distributions transform starts its registration of the two scans here."""
    del folder
    return transforms.planar(1.79387, 0.720047, 0.6931)


def reference_file(folder: Path) -> Matrix:
    """The file has target_from_source, and the source comes first by name."""
    return transforms.inverse(np.loadtxt(folder / "T_target_source.txt"))


REFERENCES: dict[str, Callable[[Path], Matrix]] = {"pcl_room": published_guess, "gicp_pair": reference_file}
"""Poses that came with the data outside the scan files: of the second scan in the frame of the first."""


def main() -> None:
    arguments = _arguments()
    folders = sorted(path for path in arguments.data.iterdir() if path.is_dir())
    with tempfile.TemporaryDirectory() as out:
        results: dict[str, Row] = {}
        for folder in folders:
            if not arguments.only or folder.name in arguments.only:
                results[folder.name] = process_folder(folder, Path(out))
                _scan_table(folder.name, results[folder.name])
                if arguments.pictures:
                    _keep_pictures(folder.name, Path(results[folder.name]["run"]), arguments.pictures)
        fair = _pair_table(arguments.data, results)
        wrong = _strangers(results)
    if fair < GOOD_SHARE or wrong:
        raise SystemExit("the bar is missed")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--data", type=Path, default=SCANS)
    parser.add_argument("--only", nargs="*", default=[], help="names of sets")
    parser.add_argument("--pictures", type=Path, help="folder for the pictures of each set")
    return parser.parse_args()


# --- each scan -------------------------------------------------------------------------------------------------------


def _scan_table(name: str, result: Row) -> None:
    print(f"\n{name}")
    print(f"  {'scan':30} {'points':>8} {'beams':>11} {'roll':>6} {'pitch':>6} {'height':>6} {'ceiling':>7}"
          f" {'area':>6} {'doors':>5} {'seconds':>7}  registration")  # fmt: skip
    for row in result["scans"]:
        found, alone = row.get("alignment"), row.get("alone", {})
        beams = f"{row['beams']['columns']}x{row['beams']['rows']}" if "beams" in row else "-"
        print(
            f"  {row['source'][:30]:30} {row.get('points', 0):8} {beams:>11}"
            + (f" {math.degrees(found['roll']):6.2f} {math.degrees(found['pitch']):6.2f}" if found else " " * 14)
            + (f" {found['scanner_height']:6.3f} {found['ceiling_z']:7.3f}" if found else " " * 15)
            + f" {_figure(alone.get('area'))} {len(alone.get('doors', [])):5} {sum(row['seconds'].values()):7.1f}"
            + f"  {_verdict(row)}"
        )
        for key in ("contour_refused", "doors_refused"):
            if key in alone:
                print(f"    {key}: {alone[key]}")
    room = result["room"]
    print(f"  all together: area {_figure(room.get('area')).strip()} m², doors {len(room.get('doors', []))}"
          f"{''.join(f', {key}: {room[key]}' for key in room if key.endswith('_refused'))}")  # fmt: skip


def _figure(value: float | None) -> str:
    return f"{value:6.1f}" if value is not None else f"{'-':>6}"


def _verdict(row: Row) -> str:
    if "refused" in row:
        return f"REFUSED {row['refused']}"
    r = row["registration"]
    if r["method"] == "anchor":
        return "first"
    agreement = r["fitness"] / r["overlap"]
    return (
        f"{r['method']} to {r['reference']}: overlap {r['overlap']:.0%}, agreement {agreement:.0%}, "
        f"rmse {1e3 * r['rmse']:.1f} mm, conflict {r['conflict']:.1%}"
    )


# --- pairs against what came with the data ---------------------------------------------------------------------------


def _pair_table(data: Path, results: dict[str, Row]) -> float:
    """Share of the pairs that keep the bar."""
    bar = f"{100 * BAR_M:.0f} cm and {BAR_DEG}°, overlap {OVERLAP:.0%}"
    print(f"\npairs with a pose that came with the data (bar: {bar}; share of points on the other's planes, rms)")
    print(f"  {'pair':28} {'overlap':>7} {'cm':>6} {'deg':>6} {'in our pose':>18} {'in the given pose':>18}  verdict")
    good = counted = 0
    for pair in _pairs(data, results):
        if pair.step is None:
            counted += 1
            print(f"  {pair.name:28} {'-':>7}  {_verdict(pair.row)}")
            continue
        distance, angle = transforms.difference(pair.given, pair.step)
        ours, theirs = (_residual(*pair.clouds, pose) for pose in (pair.step, pair.given))
        overlap = pair.row["registration"]["overlap"]
        within = distance <= BAR_M and math.degrees(angle) <= BAR_DEG
        better = ours[0] >= theirs[0] and ours[1] <= theirs[1]
        counted += overlap >= OVERLAP
        good += overlap >= OVERLAP and (within or better)
        said = "within" if within else "beyond; ours fits better" if better else "BEYOND"
        print(
            f"  {pair.name:28} {overlap:7.0%} {100 * distance:6.2f} {math.degrees(angle):6.2f}"
            f" {ours[0]:9.1%} {1e3 * ours[1]:5.1f} mm {theirs[0]:9.1%} {1e3 * theirs[1]:5.1f} mm  {said}"
        )
    print(f"  {good} of {counted}" if counted else "  none")
    return good / counted if counted else 1.0


class _Pair(NamedTuple):
    """A scan and the one before it: our step or None, the step that came with the data, and both clouds."""

    name: str
    row: Row
    step: Matrix | None
    given: Matrix
    clouds: list[NDArray[np.float32]]


def _pairs(data: Path, results: dict[str, Row]) -> Iterator[_Pair]:
    """Consecutive scans with a given step; two views of one cloud are no pair."""
    for name, result in results.items():
        for before, row in pairwise(result["scans"]):
            given = REFERENCES[name](data / name) if name in REFERENCES else row.get("given_step")
            if given is None or row.get("origin") == "floor":
                continue
            placed = "map_from_scanner" in row and "map_from_scanner" in before
            poses = [np.asarray(r["map_from_scanner"]) for r in (before, row)] if placed else []
            step = transforms.inverse(poses[0]) @ poses[1] if placed else None
            folder = Path(result["run"]) / "scans"
            clouds = [scan_file.read(folder / f"{r['scan_id']}.scan").points for r in (before, row)]
            yield _Pair(f"{name} {before['scan_id']}-{row['scan_id']}", row, step, np.asarray(given, float), clouds)


def _residual(target: NDArray[np.float32], source: NDArray[np.float32], step: Matrix) -> tuple[float, float]:
    """How well two raw clouds agree in a pose: share of the source's points within 3 cm, and their rms distance to the
    target's planes, metres. Planes by the ten nearest points: none of what registration thinned."""
    moved = transforms.apply(step, source)
    tree = cKDTree(target)
    distance, nearest = tree.query(moved, distance_upper_bound=0.30, workers=2)
    seen = np.isfinite(distance)
    _, around = tree.query(target[nearest[seen]], 10, workers=2)
    block = target[around].astype(np.float64)
    offsets = block - block.mean(axis=1, keepdims=True)
    _, axes = np.linalg.eigh(np.einsum("nij,nik->njk", offsets, offsets))
    off = np.abs(np.einsum("ij,ij->i", moved[seen] - block.mean(axis=1), axes[:, :, 0]))
    near = off < NEAR
    return float(near.mean()), float(np.sqrt(np.mean(off[off < 3 * NEAR] ** 2)))


# --- scans of different places ---------------------------------------------------------------------------------------


def _strangers(results: dict[str, Row]) -> int:
    """The first scan of each place offered to each other place, with no guess; how many were accepted, all wrongly."""
    surfaces = {}
    for name, result in results.items():
        row = result["scans"][0]
        if "alignment" not in row:
            continue
        points = scan_file.read(Path(result["run"]) / "scans" / f"{row['scan_id']}.scan").points
        surfaces[name] = surfels.surface_of(points), alignment.align(points, scanner_heights=ANY_HEIGHT)
    tried, accepted = 0, []
    for target, (known, level) in surfaces.items():
        reference = registration.reference_from([(known, level.level_from_scanner)])
        for source, (surface, own) in surfaces.items():
            if source == target:
                continue
            tried += 1
            try:
                found = global_registration.register_globally(surface, reference, own.level_from_scanner)
                registration.judge(found, (3.0, math.pi))
                accepted.append(f"{source} in {target}")
            except FailureError:
                pass
    print(f"\nscans of different places: {tried} pairs, accepted {len(accepted)} {', '.join(accepted)}")
    return len(accepted)


def _keep_pictures(name: str, run: Path, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    kinds = ("cloud_top", "plan") if any((run / "pictures").glob("*_ceiling.png")) else ("cloud_top",)
    for kind in kinds:
        source = run / "pictures" / f"{kind}.png"
        if source.exists():
            Image.open(source).convert("RGB").quantize(48).save(folder / f"real-{name}-{kind}.png", optimize=True)


if __name__ == "__main__":
    main()
