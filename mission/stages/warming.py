"""A rehearsal of all stages on a toy room, so that no first scan waits for a library to load or a kernel to compile."""

from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from drivers import scan_file
from mission.stages import placing, seeing, shaping
from mission.stages.scan_library import Library, PlacedScans
from mission.store import RunFolder
from perception import transforms
from perception.failure import FailureError
from perception.findings import RoomShape
from perception.scan import BeamPattern, Scan

_PATTERN = BeamPattern.with_step(np.deg2rad(0.8), (np.deg2rad(-40.0), np.deg2rad(60.0)), (0.5, 120.0))
_ROOM = np.array([[-2.0, -1.6, 0.0], [3.4, 2.2, 2.8]])
_DOORWAY = (-0.5, 0.5, 2.1)
_WITH_NEXT_ROOM = np.array([[-2.0, -1.6, 0.0], [6.4, 2.2, 2.8]])
_PLACES = {"W1": (0.0, 0.0, 0.0), "W2": (0.8, 0.4, 0.3)}
_HEIGHT = 1.3


def warm_up(_library: Library) -> None:
    """Run every stage once, in a folder of its own; what a stage says of the toy room does not matter."""
    with TemporaryDirectory() as folder:
        library = Library(RunFolder.at(Path(folder)))
        for name, place in _PLACES.items():
            scan_file.write(library.run.scan_file(name), _scan(name, place))
        # What refuses the toy room has been loaded by then.
        with suppress(FailureError):
            _all_stages(library)


def _all_stages(library: Library) -> None:
    placed: PlacedScans = []
    shape: RoomShape | None = None
    for cycle, name in enumerate(_PLACES, 1):
        placing.validate_scan(library, name)
        earlier, placed = placed, [*placed, (name, _placed(library, name, placed))]
        if shape is not None:
            placing.find_movement(library, *placed[-1], earlier, shape)
        shape = shaping.segment_room(library, "W", cycle, (0.0, 0.0), placed, (), (), shape)
        track = [transforms.to_planar(np.asarray(pose)) for _, pose in placed]
        ground = shaping.build_map(library, *placed[-1], shape, (), None, track, "W", cycle)
        seeing.label_space(library, "W", cycle, shape, placed, 0.10, "paper")
        seeing.label_space(library, "W", cycle, shape, placed, 0.10, "range")
        rules: tuple[Any, ...] = ("graded", "all", 0.36, 0.58)
        where = (name, track[-1], placed, track, ground.map_id, ())
        seeing.choose_view(library, "W", cycle, shape, *where, *rules)
        shaping.find_doors(library, "W", shape, placed)


def _placed(library: Library, name: str, reference: PlacedScans) -> list[list[float]]:
    if not reference:
        return placing.anchor_scan(library, name).map_from_scanner.tolist()
    level = placing.align_scan(library, name).level_from_scanner
    guess = (transforms.planar(*_PLACES[name]) @ level).tolist()
    with suppress(FailureError):
        placing.register_scan(library, name, guess, reference, error_m=0.2, error_rad=0.1)
    with suppress(FailureError):
        placing.register_globally(library, name, guess, reference, error_m=0.5, error_rad=0.5)
    return guess


def _scan(name: str, place: tuple[float, float, float]) -> Scan:
    """What a scanner would see in a box with a doorway and a box behind it."""
    mounted = transforms.from_euler(0, 0, 0, (0, 0, _HEIGHT))
    pose = transforms.planar(*place) @ mounted
    directions = _PATTERN.directions().astype(float) @ pose[:3, :3].T
    ranges = _to_the_walls(pose[:3, 3], directions, _ROOM)
    hit = pose[:3, 3] + ranges[:, None] * directions
    through = (hit[:, 0] > _ROOM[1, 0] - 1e-6) & (hit[:, 1] > _DOORWAY[0]) & (hit[:, 1] < _DOORWAY[1])
    through &= hit[:, 2] < _DOORWAY[2]
    ranges[through] = _to_the_walls(pose[:3, 3], directions[through], _WITH_NEXT_ROOM)
    ranges += np.random.default_rng(len(name)).normal(0, 0.002, len(ranges))
    points = (_PATTERN.directions() * ranges[:, None]).astype(np.float32)
    beam = np.arange(_PATTERN.size, dtype=np.int32)
    odometry = transforms.planar(*place)
    return Scan(name, points, np.ones(len(beam), np.float32), beam, _PATTERN, odometry, mounted)


def _to_the_walls(origin: np.ndarray, directions: np.ndarray, box: np.ndarray) -> np.ndarray:
    """Distance from inside a box to its faces along each direction."""
    with np.errstate(divide="ignore", invalid="ignore"):
        faces = [(side - origin) / directions for side in box]
    ranges: np.ndarray = np.nanmin(np.where(np.maximum(*faces) > 0, np.maximum(*faces), np.inf), axis=1)
    return ranges
