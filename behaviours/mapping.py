"""Leaves that give the scan its place and draw the maps from it."""

import math
from dataclasses import replace
from typing import Any

from py_trees.common import Status

from behaviours.fence import fence_of
from behaviours.keys import Key
from behaviours.leaf import Leaf
from behaviours.scanning import StageLeaf
from behaviours.survey import CurrentScan, Labelled, ScanRecord, Survey
from perception import transforms
from perception.failure import FailureError
from perception.findings import LabelCounts, Registration, RoomShape
from perception.transforms import Matrix


def poses(records: tuple[ScanRecord, ...]) -> list[tuple[str, list[list[float]]]]:
    """Scan ids with their poses, as plain values for the worker."""
    return [(record.scan_id, record.map_from_scanner.tolist()) for record in records]


class PlaceScan(StageLeaf):
    """Common part of the leaves that register: takes an accepted pose into the survey."""

    reads = (Key.ROOM,)
    writes = (Key.SCAN, Key.SURVEY)

    def finish(self, value: Registration) -> Status:
        place(self, self.read(Key.SCAN), value, self.read(Key.ROOM))
        self.say(f"{value.method}: overlap {value.overlap:.0%}, rmse {value.rmse * 1000:.1f} mm")
        return Status.SUCCESS


class AnchorScan(PlaceScan):
    """The very first scan makes the map frame: levelled, floor at zero, axes along the walls."""

    stage = "anchor_scan"

    def arguments(self) -> dict[str, object]:
        return {"scan_id": self.read(Key.SCAN).scan_id}


class RegisterScan(PlaceScan):
    """Section 5: odometry guess, then ICP to what is registered; refused unless it is sure."""

    stage = "register_scan"

    def arguments(self) -> dict[str, object]:
        survey: Survey = self.read(Key.SURVEY)
        scan: CurrentScan = self.read(Key.SCAN)
        return {
            "scan_id": scan.scan_id,
            "guess": guess(scan).tolist(),
            "reference": poses(survey.scans),
            **expected_error(self, scan),
        }


class RegisterGlobally(RegisterScan):
    """The second try: features find the pose near the guess without trusting its heading."""

    stage = "register_globally"

    def arguments(self) -> dict[str, object]:
        arguments = super().arguments()
        arguments["error_m"] = self.services.settings.registration.global_search_m
        arguments["error_rad"] = math.pi
        return arguments


class SetScanAside(Leaf):
    """Keeps a scan that found no place, to be tried again when more is known around it."""

    reads = (Key.SCAN,)
    writes = (Key.SURVEY,)

    def step(self) -> Status:
        survey, scan = self.read(Key.SURVEY), self.read(Key.SCAN)
        self.write(Key.SURVEY, replace(survey, set_aside=(*survey.set_aside, scan)))
        self.say(f"{scan.scan_id} waits for a bridging scan")
        return Status.SUCCESS


class PlaceScanSetAside(RegisterScan):
    """Tries the oldest scan set aside once more; it leaves the waiting list whatever comes out."""

    def begin(self) -> None:
        survey: Survey = self.read(Key.SURVEY)
        self._waiting, *rest = survey.set_aside
        self._current = self.read(Key.SCAN)
        self.write(Key.SURVEY, replace(survey, set_aside=tuple(rest)))
        self.write(Key.SCAN, self._waiting)
        super().begin()

    def terminate(self, new_status: Status) -> None:
        super().terminate(new_status)
        if getattr(self, "_current", None) is not None:
            self.write(Key.SCAN, self._current)
            self._current = None

    def finish(self, value: Registration) -> Status:
        place(self, self._waiting, value, self.read(Key.ROOM), standing_here=False)
        self.say(f"{self._waiting.scan_id} found its place")
        return Status.SUCCESS


class SegmentRoom(StageLeaf):
    """Section 3.1: floor, ceiling and contour H of the room being scanned, from all scans that can see into it."""

    reads = (Key.ROOM,)
    writes = (Key.SURVEY,)
    stage = "segment_room"

    def arguments(self) -> dict[str, object]:
        survey, room_id = self.read(Key.SURVEY), self.read(Key.ROOM)
        return {
            "room_id": room_id,
            "cycle": survey.cycle_number(room_id),
            "seed": survey.building.room(room_id).seed,
            "scans": poses(survey.scans_near(room_id)),
            "doors": [edge.door for edge in survey.building.doors],
            "others": [shape.contour for other, shape in survey.shapes.items() if other != room_id],
            "previous": survey.shapes.get(room_id),
        }

    def finish(self, value: RoomShape) -> Status:
        survey, room_id = self.read(Key.SURVEY), self.read(Key.ROOM)
        self.write(Key.SURVEY, survey.with_shape(room_id, value))
        self.say(f"{value.area:.1f} m², {value.ceiling_z - value.floor_z:.2f} m high, {len(value.walls)} walls")
        return Status.SUCCESS


class BuildMap(StageLeaf):
    """Section 3.2: couples this scan's map with M(t-1); the floor the robot stood and drove on is free."""

    reads = (Key.ROOM,)
    writes = (Key.SURVEY,)
    stage = "build_map"

    def arguments(self) -> dict[str, object]:
        survey: Survey = self.read(Key.SURVEY)
        latest = survey.scans[-1]
        return {
            "scan_id": latest.scan_id,
            "pose": latest.map_from_scanner.tolist(),
            "shape": survey.shapes[self.read(Key.ROOM)],
            "doors": [*(edge.door for edge in survey.building.doors), *survey.suspects],
            "previous": survey.map_id,
            "track": list(survey.track),
            "room_id": self.read(Key.ROOM),
            "cycle": survey.cycle_number(self.read(Key.ROOM)),
            "fence": fence_of(survey, self.services.settings),
        }

    def finish(self, value: Any) -> Status:
        self.write(Key.SURVEY, replace(self.read(Key.SURVEY), map_id=value.map_id))
        self.say(f"{value.free_m2:.0f} m² free, {value.obstacle_m2:.0f} m² obstacles")
        return Status.SUCCESS


class LabelSpace(StageLeaf):
    """Section 4.1: occupied, empty and occluded voxels of the room after this scan."""

    reads = (Key.SURVEY, Key.ROOM)
    writes = (Key.COUNTS,)
    stage = "label_space"

    def arguments(self) -> dict[str, object]:
        survey, room_id = self.read(Key.SURVEY), self.read(Key.ROOM)
        room = self.services.settings.room
        return {
            "room_id": room_id,
            "cycle": survey.cycle_number(room_id),
            "shape": survey.shapes[room_id],
            "scans": poses(survey.scans_near(room_id)),
            "voxel": room.voxel_m,
            "labeller": room.labeller,
        }

    def finish(self, value: LabelCounts) -> Status:
        self.write(Key.COUNTS, Labelled(self.read(Key.SURVEY).scans[-1].scan_id, value))
        self.say(f"{value.occupied:,} occupied, {value.empty:,} empty, {value.occluded:,} occluded")
        return Status.SUCCESS


def guess(scan: CurrentScan) -> Matrix:
    """``map_from_scanner`` where the base believes it stands, with the tilt that alignment measured."""
    assert scan.alignment is not None and scan.base_from_scanner is not None
    if scan.map_from_base_guess is None:
        raise FailureError("REG_NO_GUESS", f"{scan.scan_id} has no odometry to start from")
    x, y, yaw = transforms.to_planar(scan.map_from_base_guess @ scan.base_from_scanner)
    return transforms.planar(x, y, yaw) @ scan.alignment.level_from_scanner


def expected_error(leaf: StageLeaf, scan: CurrentScan) -> dict[str, object]:
    """How wrong the guess may be after the distance driven."""
    trust = leaf.services.settings.registration
    degrees = trust.guess_error_deg + trust.guess_error_deg_per_m * scan.guess_distance
    return {
        "error_m": trust.guess_error_m + trust.guess_error_m_per_m * scan.guess_distance,
        "error_rad": math.radians(degrees),
    }


def place(leaf: StageLeaf, scan: CurrentScan, found: Registration, room_id: str, standing_here: bool = True) -> None:
    """Take a registered scan into the survey and the journal."""
    assert scan.receipt is not None and scan.alignment is not None and scan.base_from_scanner is not None
    map_from_base = transforms.planar(
        *transforms.to_planar(found.map_from_scanner @ transforms.inverse(scan.base_from_scanner))
    )
    record = ScanRecord(
        scan.scan_id,
        room_id,
        found.map_from_scanner,
        map_from_base,
        scan.odom_from_base,
        scan.points,
        scan.receipt,
        scan.alignment,
        found,
        odom_frame=scan.odom_frame,
    )
    survey: Survey = leaf.read(Key.SURVEY)
    leaf.write(Key.SURVEY, survey.with_scan(record) if standing_here else survey.with_earlier_scan(record))
    leaf.services.journal.record(
        "registered",
        scan_id=scan.scan_id,
        room_id=room_id,
        map_from_scanner=found.map_from_scanner.tolist(),
        fitness=found.fitness,
        rmse=found.rmse,
        overlap=found.overlap,
        min_eigenvalue=found.min_eigenvalue,
        correction_m=found.correction_m,
        correction_rad=found.correction_rad,
        method=found.method,
    )
