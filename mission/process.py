"""Recorded scans through the stages of the paper, in order, to a report; each refusal with its reason."""

import math
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from drivers import recorded, scan_file
from mission import stages
from mission.clock import MissionClock
from mission.finish import finish
from mission.journal import JsonLines
from mission.stages.scan_library import Library
from mission.store import RunFolder
from perception import transforms
from perception.failure import Failure, FailureError
from perception.findings import Alignment, Registration, RoomShape
from perception.transforms import Matrix
from perception.validation import Limits

ROOM = "R1"
_UNKNOWN_GUESS = (1.0, math.radians(20.0))
_GIVEN_GUESS = (0.15, math.radians(3.0))
_SEARCH = (3.0, math.pi)
_ANY_SCANNER = Limits(bad_share=0.05, return_share=0.01, empty_sector=2 * math.pi)
"""Somebody else's scanner may look to one side only, and its beams are known by direction alone."""


def process_folder(folder: Path, out: Path) -> dict[str, Any]:
    """Align, register, segment, map and label the scans of a folder; a run folder with a report comes of it.

    Raises:
        FailureError: as :func:`drivers.recorded.read_folder`.
    """
    scans = recorded.read_folder(folder)
    run = RunFolder.create(out, folder.resolve().name.lower())
    journal = JsonLines(run.events, MissionClock())
    processing = _Processing(run, journal)
    for item in scans:
        scan_file.write(run.scan_file(item.scan.scan_id), item.scan)
        processing.take(item)
    processing.shape()
    journal.close()
    report = finish(run)
    return {"run": str(run.path), "report": str(report), "scans": processing.rows, "room": processing.room}


class _Processing:
    """The books of one folder: what is placed so far, and a row for each scan."""

    def __init__(self, run: RunFolder, journal: JsonLines) -> None:
        self._run = run
        self._library = Library(run, _ANY_SCANNER)
        self._journal = journal
        self._placed: list[tuple[str, list[list[float]]]] = []
        self._given: dict[str, Matrix] = {}
        self._map_id: str | None = None
        self.rows: list[dict[str, Any]] = []
        self.room: dict[str, Any] = {"id": ROOM, "status": "partial", "reason_ended": "recorded", "cycles": []}

    def take(self, item: recorded.Recorded) -> None:
        """Align and register one scan; one that is refused stays out of the maps, and its row says why."""
        scan_id = item.scan.scan_id
        row: dict[str, Any] = {"scan_id": scan_id, "points": len(item.scan.points)}
        self.rows.append(row)
        self._journal.record("scan", scan_id=scan_id, points=len(item.scan.points))
        try:
            self._stage("validate_scan", scan_id=scan_id)
            alignment: Alignment = self._stage("align_scan", scan_id=scan_id)
            row["alignment"] = _alignment_row(alignment)
            found = self._place(item, alignment)
        except FailureError as error:
            row["refused"] = str(error)
            self._journal.record("failure", leaf=scan_id, code=error.failure.code, message=error.failure.message)
            return
        row["registration"] = _registration_row(found)
        row["map_from_scanner"] = found.map_from_scanner.tolist()
        if item.world_from_scanner is not None:
            self._given[scan_id] = item.world_from_scanner
            row["from_given_pose"] = self._from_given(scan_id, found.map_from_scanner)
        self._placed.append((scan_id, found.map_from_scanner.tolist()))
        self._journal.record("registered", scan_id=scan_id, room_id=ROOM, **row["registration"])

    def shape(self) -> None:
        """Contour, maps, labels and doors from all that was placed."""
        if self._placed:
            self._attempt("contour", self._shape_room)
        self._run.write_state(
            {
                "outcome": "processed",
                "rooms": [self.room | {"scans": [name for name, _ in self._placed]}],
                "doors": self.room.get("doors", []),
                "scans": [self._state_row(row) for row in self.rows if "map_from_scanner" in row],
                "map_id": self._map_id,
            }
        )

    def _place(self, item: recorded.Recorded, alignment: Alignment) -> Registration:
        scan_id = item.scan.scan_id
        if not self._placed:
            return self._stage("anchor_scan", scan_id=scan_id)
        guess, error = self._guess(item, alignment)
        common = {"scan_id": scan_id, "guess": guess.tolist(), "reference": self._placed}
        try:
            return self._stage("register_scan", **common, error_m=error[0], error_rad=error[1])
        except FailureError:
            return self._stage("register_globally", **common, error_m=_SEARCH[0], error_rad=_SEARCH[1])

    def _guess(self, item: recorded.Recorded, alignment: Alignment) -> tuple[Matrix, tuple[float, float]]:
        """Where the given poses put the scan; without them, where the one before stands."""
        last_id, last_pose = self._placed[-1]
        x, y, yaw = transforms.to_planar(np.asarray(last_pose))
        expected = _UNKNOWN_GUESS
        if item.world_from_scanner is not None and last_id in self._given:
            step = transforms.inverse(self._given[last_id]) @ item.world_from_scanner
            x, y, yaw = transforms.to_planar(transforms.planar(x, y, yaw) @ step)
            expected = _GIVEN_GUESS
        return transforms.planar(x, y, yaw) @ alignment.level_from_scanner, expected

    def _from_given(self, scan_id: str, pose: Matrix) -> dict[str, float] | None:
        """How far the step from the scan before is from the step of the given poses."""
        if not self._placed or self._placed[-1][0] not in self._given:
            return None
        last_id, last_pose = self._placed[-1]
        given = transforms.inverse(self._given[last_id]) @ self._given[scan_id]
        distance, angle = transforms.difference(given, transforms.inverse(np.asarray(last_pose)) @ pose)
        return {"distance_m": round(distance, 4), "angle_deg": round(math.degrees(angle), 3)}

    def _shape_room(self) -> None:
        seed = tuple(np.asarray(self._placed[0][1])[:2, 3])
        shape: RoomShape = self._stage(
            "segment_room", room_id=ROOM, cycle=1, seed=seed, scans=self._placed, doors=[], others=[], previous=None
        )
        self.room |= {
            "contour": shape.contour.tolist(),
            "floor_z": shape.floor_z,
            "ceiling_z": shape.ceiling_z,
            "area": shape.area,
        }
        self._attempt("map", lambda: self._build_maps(shape))
        self._attempt("labels", lambda: self._label(shape))
        self._attempt("doors", lambda: self._find_doors(shape))

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

    def _find_doors(self, shape: RoomShape) -> None:
        found = self._stage("find_doors", room_id=ROOM, shape=shape, scans=self._placed)
        self.room["doors"] = [
            {"id": f"D{n}", "x": d.x, "y": d.y, "normal": d.normal, "width": d.width, "net_width": d.net_width,
             "height": d.height, "confidence": d.confidence, "rooms": [ROOM, None], "state": "unexplored"}
            for n, d in enumerate(found.doors, 1)
        ]  # fmt: skip

    def _attempt(self, what: str, step: Callable[[], None]) -> None:
        """A stage that fails on somebody else's scans is reported, and the others go on."""
        try:
            step()
        except FailureError as error:
            self.room[f"{what}_refused"] = str(error)
            self._journal.record("failure", leaf=what, code=error.failure.code, message=error.failure.message)

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
            ids = {key: arguments[key] for key in ("scan_id", "room_id") if key in arguments}
            self._journal.record("stage", name=name, seconds=seconds, failure=failure and failure.code, **ids)

    def _state_row(self, row: dict[str, Any]) -> dict[str, Any]:
        kept = ("scan_id", "points", "map_from_scanner", "alignment", "registration")
        return {"room_id": ROOM, "file": f"scans/{row['scan_id']}.scan", **{key: row[key] for key in kept}}


def _alignment_row(found: Alignment) -> dict[str, float]:
    return {
        "roll": found.roll,
        "pitch": found.pitch,
        "scanner_height": found.scanner_height,
        "ceiling_z": found.ceiling_z,
    }


def _registration_row(found: Registration) -> dict[str, Any]:
    names = ("fitness", "rmse", "overlap", "min_eigenvalue", "correction_m", "correction_rad", "method", "conflict")
    return {name: getattr(found, name) for name in names}
