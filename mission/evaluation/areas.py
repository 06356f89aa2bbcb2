"""Table 2: the area of walls, floor and ceiling that was sensed, and that could have been (paper section 6)."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from drivers.simulated.profile import ScannerProfile
from drivers.simulated.world import Surface, World
from drivers.simulated.worlds.free_space import flood
from drivers.simulated.worlds.surfaces import structural_surfaces
from mission.evaluation.settings import EvaluationSettings
from mission.report.run import Run
from perception import transforms
from perception.coverage import PatchCounter, ViewLimits, coverable
from perception.patches import Patches, sample_surfaces
from perception.transforms import Matrix

_STRUCTURE = {Surface.WALL: "wall", Surface.FLOOR: "floor", Surface.CEILING: "ceiling"}
_STEP = float(np.deg2rad(0.5))


@dataclass(frozen=True)
class _Measured:
    """Surface of a room: its patches, the element each is part of, and which of them could be and were sensed.

    ``near`` patches have points of the cloud within the tolerance. Where no place sees the patch itself, those are
    points of a board or of a cupboard that stands against it, and the patch was not sensed.
    """

    name: str
    areas: NDArray[np.float64]
    element: NDArray[np.str_]
    coverable: NDArray[np.bool_]
    near: NDArray[np.bool_]

    @property
    def sensed(self) -> NDArray[np.bool_]:
        return self.near & self.coverable


def table_2(
    run: Run, world_from_map: Matrix, world: World, rooms: Sequence[str], settings: EvaluationSettings
) -> list[dict[str, Any]]:
    """One row a room, by element, and a last row with the total; empty where there is nothing to measure."""
    found = {room_id: _room_patches(world, room_id, settings.cell_m) for room_id in rooms}
    # A room of an imported mesh may have no surface of a known class.
    surfaces = {room_id: surface for room_id, surface in found.items() if surface is not None}
    if not surfaces:
        return []
    near = _near(run, world_from_map, {name: patches for name, (patches, _) in surfaces.items()}, settings)
    stations, view = _stations(run, world, settings)
    blockers = world.corners([surface for surface in Surface if surface != Surface.GLASS])
    measured = []
    for name, (patches, element) in surfaces.items():
        outline = shapely.Polygon(world.truth.room(name).polygon)
        close = shapely.dwithin(outline, shapely.points(stations[:, :2]), settings.station_reach_m)
        possible = coverable(patches, stations[close], blockers, view)
        measured.append(_Measured(name, patches.areas, element, possible, near[name]))
    return [_row(room.name, [room]) for room in measured] + [_row("Total", measured)]


def _room_patches(world: World, room_id: str, cell: float) -> tuple[Patches, NDArray[np.str_]] | None:
    """Patches of a room's structure, and ``wall``, ``floor`` or ``ceiling`` for each; None without any."""
    corners, surface = structural_surfaces(world, room_id)
    parts, elements = [], []
    for kind, name in _STRUCTURE.items():
        if np.any(surface == kind):
            parts.append(sample_surfaces(corners[surface == kind], cell))
            elements.append(np.full(parts[-1].count, name))
    return (Patches.merged(parts), np.concatenate(elements)) if parts else None


def _near(
    run: Run, world_from_map: Matrix, surfaces: Mapping[str, Patches], settings: EvaluationSettings
) -> dict[str, NDArray[np.bool_]]:
    """Which patches of each room hold enough points of the registered cloud; every scan is read once."""
    counter = PatchCounter(Patches.merged(list(surfaces.values())), settings.tolerance_m)
    for _, map_from_scanner, scan in run.clouds():
        counter.add(transforms.apply(world_from_map @ map_from_scanner, scan.points))
    enough = counter.counts >= settings.min_points
    ends = np.cumsum([patches.count for patches in surfaces.values()])
    return dict(zip(surfaces, np.split(enough, ends[:-1]), strict=True))


def _stations(run: Run, world: World, settings: EvaluationSettings) -> tuple[NDArray[np.float64], ViewLimits]:
    """Optical centres ``(P, 3)`` over all places where the base can stand, and the scanner's limits."""
    incidence = float(np.deg2rad(settings.incidence_deg))
    scan = next((scan for _, _, scan in run.clouds()), None)
    pattern = scan.pattern if scan else ScannerProfile().pattern(_STEP)
    mount = scan.base_from_scanner if scan else ScannerProfile().base_from_scanner
    view = ViewLimits((pattern.elevation_min, pattern.elevation_max), (pattern.range_min, pattern.range_max), incidence)
    region = flood(world)
    cells = np.argwhere(region.data)
    # One cell of each block, not one of each grid point: a doorway narrower than the step keeps its stations.
    blocks = cells // max(1, round(settings.station_step_m / region.resolution))
    _, first = np.unique(blocks, axis=0, return_index=True)
    places = region.centres_of(cells[first]).reshape(-1, 2)
    return np.column_stack([places, np.full(len(places), mount[2, 3])]), view


def _row(name: str, rooms: list[_Measured]) -> dict[str, Any]:
    """Areas in square metres by element; ``hidden`` is where only what stands against the surface was measured."""
    areas = np.concatenate([room.areas for room in rooms])
    element = np.concatenate([room.element for room in rooms])
    which = {
        "truth": np.ones(len(areas), bool),
        "sensed": np.concatenate([room.sensed for room in rooms]),
        "coverable": np.concatenate([room.coverable for room in rooms]),
        "hidden": np.concatenate([room.near & ~room.coverable for room in rooms]),
    }
    row: dict[str, Any] = {"name": name}
    for part in (*_STRUCTURE.values(), "total"):
        chosen = (element == part) | (part == "total")
        sums = {key: float(areas[chosen & mask].sum()) for key, mask in which.items()}
        row[part] = sums | {
            "share": _ratio(sums["sensed"], sums["truth"]),
            "coverable_share": _ratio(sums["coverable"], sums["truth"]),
            "of_coverable": _ratio(sums["sensed"], sums["coverable"]),
        }
    return row


def _ratio(part: float, whole: float) -> float | None:
    return part / whole if whole else None
