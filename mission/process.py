"""Recorded scans through the stages of the paper, in order, to a report; each refusal with its reason."""

import math
import time
from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from drivers import recorded, scan_file
from drivers.disk import writing
from mission import stages
from mission.clock import MissionClock
from mission.finish import finish
from mission.journal import JsonLines
from mission.set_ups import SetUp, set_ups
from mission.stages.scan_library import Library
from mission.store import RunFolder
from perception import transforms
from perception.failure import Failure, FailureError
from perception.findings import Alignment, DoorFindings, Registration, RoomShape
from perception.transforms import Matrix
from perception.validation import Limits

ROOM = "R1"
_UNKNOWN_GUESS = (1.0, math.radians(20.0))
_GIVEN_GUESS = (0.15, math.radians(3.0))
_SEARCH = (3.0, math.pi)
_ANY_SCANNER = Limits(bad_share=0.05, return_share=0.01, empty_sector=2 * math.pi)
"""Somebody else's scanner may look to one side only, and its beams are known by direction alone."""

Row = dict[str, Any]
Reading = tuple[Path, SetUp | FailureError, float]
"""A set-up of a file, or why there is none, and the seconds that reading took."""


def process_folder(folder: Path, out: Path) -> Row:
    """Align, register, segment, map and label the scans of a folder; a run folder with a report comes of it.

    Returns:
        ``run`` and ``report`` (paths), ``scans`` (a row each: source, beams, alignment, the room and the doors that the
        scan shows by itself, registration, how far that is from the given poses, seconds by stage; or ``refused``) and
        ``room`` (contour, area, levels, doors and label counts of all that was placed).

    Raises:
        FailureError: ``RECORDED_NONE`` for a folder without scans; where no file of it can be read, as
            :func:`drivers.recorded.read_file` for the first; ``DISK_FULL``, ``IO_ERROR`` of the run folder.
    """
    readings = _readings(recorded.files_of(folder))
    refused, usable = _until_usable(readings)
    run = RunFolder.create(out, folder.resolve().name.lower())
    journal = JsonLines(run.events, MissionClock())
    processing = _Processing(run, journal)
    for reading in chain(refused, (usable,), readings):  # one after the other: all clouds at once are too many
        processing.read(*reading)
    processing.shape()
    journal.close()
    finish(run)
    return {"run": str(run.path), "report": str(run.report), "scans": processing.rows, "room": processing.room}


def _until_usable(readings: Iterator[Reading]) -> tuple[list[Reading], Reading]:
    """What was refused before the first set-up, and that; raises the first refusal where there is none."""
    refused: list[Reading] = []
    for reading in readings:
        if isinstance(reading[1], SetUp):
            return refused, reading
        refused.append(reading)
    why = refused[0][1]
    assert isinstance(why, FailureError)
    raise why


def _readings(files: list[Path]) -> Iterator[Reading]:
    """Each set-up of each file, or why there is none, and the seconds that reading took."""
    number = 1
    for path in files:
        found = set_ups(path, number)
        while True:
            began = time.perf_counter()
            try:
                item: SetUp | FailureError | None = next(found, None)
            except FailureError as error:
                item = error
            if item is None:
                break
            yield path, item, time.perf_counter() - began
            number += isinstance(item, SetUp)


class _Processing:
    """The books of one folder: what is placed so far, and a row for each scan."""

    def __init__(self, run: RunFolder, journal: JsonLines) -> None:
        self._run = run
        self._library = Library(run, _ANY_SCANNER)
        self._journal = journal
        self._placed: list[tuple[str, list[list[float]]]] = []
        self._given: dict[str, Matrix] = {}
        self._map_id: str | None = None
        self._seconds: dict[str, float] = {}
        self.rows: list[Row] = []
        self.room: Row = {"id": ROOM, "status": "partial", "reason_ended": "recorded", "cycles": []}

    def read(self, path: Path, item: SetUp | FailureError, seconds: float) -> None:
        """Take a set-up into the books, or the reason why a file has none."""
        self._seconds = {"read": round(seconds, 4)}
        if isinstance(item, FailureError):
            self.rows.append({"source": path.name, "seconds": self._seconds})
            self._refuse(self.rows[-1], path.name, item)
            return
        file = self._run.scan_file(item.scan.scan_id)
        with writing(file):
            scan_file.write(file, item.scan)
        self.take(item)

    def take(self, item: SetUp) -> None:
        """Align and register one scan; one that is refused stays out of the maps, and its row says why."""
        scan_id = item.scan.scan_id
        row = _set_up_row(item) | {"seconds": self._seconds}
        self.rows.append(row)
        self._journal.record("scan", scan_id=scan_id, points=len(item.scan.points))
        if item.world_from_scanner is not None:
            self._given[scan_id] = item.world_from_scanner
        given_step = self._given_step(scan_id)
        row |= {"given_step": None if given_step is None else given_step.tolist(), "from_given_pose": None}
        try:
            self._stage("validate_scan", scan_id=scan_id)
            alignment: Alignment = self._stage("align_scan", scan_id=scan_id)
            row["alignment"] = _alignment_row(alignment)
            row["alone"] = self._alone(scan_id, alignment)
            found, reference = self._place(scan_id, alignment, given_step)
        except FailureError as error:
            self._refuse(row, scan_id, error)
            return
        row["registration"] = _registration_row(found) | {"reference": reference}
        row["map_from_scanner"] = found.map_from_scanner.tolist()
        if given_step is not None:
            row["from_given_pose"] = self._from_given(given_step, found.map_from_scanner)
        self._placed.append((scan_id, found.map_from_scanner.tolist()))
        self._journal.record("registered", scan_id=scan_id, room_id=ROOM, **row["registration"])

    def shape(self) -> None:
        """Contour, maps, labels and doors from all that was placed."""
        if self._placed:
            self._seconds = self.room["seconds"] = {}
            self._attempt(self.room, "contour", self._shape_room)
        self._run.write_state(
            {
                "outcome": "processed",
                "rooms": [self.room | {"scans": [name for name, _ in self._placed]}],
                "doors": self.room.get("doors", []),
                "scans": [self._state_row(row) for row in self.rows if "map_from_scanner" in row],
                "recorded": self.rows,
                "map_id": self._map_id,
            }
        )

    def _alone(self, scan_id: str, alignment: Alignment) -> Row:
        """Floor, ceiling, contour and doors as this scan by itself shows them, in its own levelled frame."""
        found: Row = {}
        placed = [(scan_id, alignment.level_from_scanner.tolist())]

        def look() -> None:
            shape = self._segment(scan_id, (0.0, 0.0), placed)
            found.update(_shape_row(shape))
            self._attempt(found, "doors", lambda: found.update(self._doors(scan_id, shape, placed)))

        self._attempt(found, "contour", look)
        return found

    def _place(self, scan_id: str, alignment: Alignment, given_step: Matrix | None) -> tuple[Registration, str]:
        """The registration, and what it was registered to.

        A scan that does not fit all earlier ones may fit the last: an instrument whose angles are off bends what it
        sees from afar, and the last one saw the same from nearby.
        """
        if not self._placed:
            return self._stage("anchor_scan", scan_id=scan_id), "none"
        guess, (error_m, error_rad) = self._guess(alignment, given_step)
        near = {"scan_id": scan_id, "guess": guess.tolist(), "error_m": error_m, "error_rad": error_rad}
        far = near | {"error_m": _SEARCH[0], "error_rad": _SEARCH[1]}
        attempts = [("register_scan", near, self._placed, "all"), ("register_globally", far, self._placed, "all")]
        if len(self._placed) > 1:
            attempts.insert(1, ("register_scan", near, self._placed[-1:], "the scan before"))
        reasons: list[FailureError] = []
        for stage, arguments, reference, name in attempts:
            try:
                return self._stage(stage, **arguments, reference=reference), name
            except FailureError as error:
                reasons.append(error)
        # With a guess that is worth something, why it did not hold says more than what a search found instead.
        raise reasons[-1] if given_step is None else reasons[0]

    def _guess(self, alignment: Alignment, given_step: Matrix | None) -> tuple[Matrix, tuple[float, float]]:
        """Where the given poses put the scan; without them, where the one before stands."""
        last = np.asarray(self._placed[-1][1])
        expected = _UNKNOWN_GUESS if given_step is None else _GIVEN_GUESS
        x, y, yaw = transforms.to_planar(last if given_step is None else last @ given_step)
        return transforms.planar(x, y, yaw) @ alignment.level_from_scanner, expected

    def _given_step(self, scan_id: str) -> Matrix | None:
        """From the last scan that was placed to this one, as the given poses have it."""
        last = self._given.get(self._placed[-1][0]) if self._placed else None
        own = self._given.get(scan_id)
        return None if last is None or own is None else transforms.inverse(last) @ own

    def _from_given(self, given: Matrix, pose: Matrix) -> dict[str, float]:
        """How far the step from the scan before is from the step of the given poses."""
        distance, angle = transforms.difference(given, transforms.inverse(np.asarray(self._placed[-1][1])) @ pose)
        return {"distance_m": round(distance, 4), "angle_deg": round(math.degrees(angle), 3)}

    def _segment(self, name: str, seed: tuple[float, float], scans: list[tuple[str, list[list[float]]]]) -> RoomShape:
        shape: RoomShape = self._stage(
            "segment_room", room_id=name, cycle=1, seed=seed, scans=scans, doors=[], others=[], previous=None
        )
        return shape

    def _shape_room(self) -> None:
        x, y, _ = transforms.to_planar(np.asarray(self._placed[0][1]))
        shape = self._segment(ROOM, (x, y), self._placed)
        self.room |= _shape_row(shape)
        self._attempt(self.room, "map", lambda: self._build_maps(shape))
        self._attempt(self.room, "labels", lambda: self._label(shape))
        self._attempt(self.room, "doors", lambda: self.room.update(self._doors(ROOM, shape, self._placed)))

    def _build_maps(self, shape: RoomShape) -> None:
        for cycle, (scan_id, pose) in enumerate(self._placed, 1):
            track = [transforms.to_planar(np.asarray(pose))]
            known = {"shape": shape, "doors": [], "previous": self._map_id, "track": track}
            ids = {"scan_id": scan_id, "room_id": ROOM, "cycle": cycle}
            self._map_id = self._stage("build_map", pose=pose, **ids, **known).map_id

    def _label(self, shape: RoomShape) -> None:
        scans = {"scans": self._placed, "voxel": 0.10, "labeller": "range"}
        counts = self._stage("label_space", room_id=ROOM, cycle=1, shape=shape, **scans)
        self.room["cycles"] = [{"scan_id": self._placed[-1][0], **vars(counts)}]

    def _doors(self, name: str, shape: RoomShape, scans: list[tuple[str, list[list[float]]]]) -> Row:
        found: DoorFindings = self._stage("find_doors", room_id=name, shape=shape, scans=scans)
        doors = [
            {"id": f"D{n}", "x": d.x, "y": d.y, "normal": d.normal, "width": d.width, "net_width": d.net_width,
             "height": d.height, "confidence": d.confidence, "rooms": [ROOM, None], "state": "unexplored"}
            for n, d in enumerate(found.doors, 1)
        ]  # fmt: skip
        return {"doors": doors}

    def _attempt(self, row: Row, what: str, step: Callable[[], None]) -> None:
        """A stage that fails on somebody else's scans is reported, and the others go on."""
        try:
            step()
        except FailureError as error:
            row[f"{what}_refused"] = str(error)
            self._journal.record("failure", leaf=what, code=error.failure.code, message=error.failure.message)

    def _refuse(self, row: Row, name: str, error: FailureError) -> None:
        row["refused"] = str(error)
        self._journal.record("failure", leaf=name, code=error.failure.code, message=error.failure.message)

    def _stage(self, name: str, **arguments: Any) -> Any:
        began = time.perf_counter()
        failure: Failure | None = None
        try:
            return stages.run(self._library, name, arguments)
        except FailureError as error:
            failure = error.failure
            raise
        finally:
            seconds = round(time.perf_counter() - began, 4)
            self._seconds[name] = round(self._seconds.get(name, 0.0) + seconds, 4)
            ids = {key: arguments[key] for key in ("scan_id", "room_id") if key in arguments}
            self._journal.record("stage", name=name, seconds=seconds, failure=failure and failure.code, **ids)

    def _state_row(self, row: Row) -> Row:
        kept = ("scan_id", "points", "map_from_scanner", "alignment", "registration")
        return {"room_id": ROOM, "file": f"scans/{row['scan_id']}.scan", **{key: row[key] for key in kept}}


def _set_up_row(item: SetUp) -> Row:
    scan = item.scan
    beams = {"columns": scan.pattern.columns, "rows": scan.pattern.rows, "from_file": item.gridded}
    return {
        "scan_id": scan.scan_id,
        "source": item.source,
        "points": len(scan.points),
        "beams": beams,
        "origin": item.origin,
    }


def _alignment_row(found: Alignment) -> Row:
    names = ("roll", "pitch", "scanner_height", "ceiling_z", "wall_yaw")
    return {name: getattr(found, name) for name in names}


def _shape_row(shape: RoomShape) -> Row:
    return {
        "contour": shape.contour.tolist(),
        "floor_z": shape.floor_z,
        "ceiling_z": shape.ceiling_z,
        "area": shape.area,
    }


def _registration_row(found: Registration) -> Row:
    names = ("fitness", "rmse", "overlap", "min_eigenvalue", "correction_m", "correction_rad", "method", "conflict")
    return {name: getattr(found, name) for name in names}
