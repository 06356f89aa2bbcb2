"""The survey as E57 (ASTM E2807): every set-up apart, in its own frame, with its pose; nothing is merged."""

import os
import uuid
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pye57
from numpy.typing import NDArray
from pye57 import libe57

from mission.report.run import Record, Run, read_run
from mission.store import whole_file
from perception import transforms
from perception.failure import FailureError
from perception.scan import Scan

_GPS_EPOCH = datetime(1980, 1, 6, tzinfo=UTC)
_GPS_AHEAD_OF_UTC = 18.0
"""Leap seconds since the epoch; E57 counts GPS time, which has none."""


def write_e57(folder: Path) -> Path:
    """Write ``building.e57`` into a run folder: one Data3D a registered scan, named ``room/scan``.

    Points stay in the scanner's frame with intensity, row and column; the pose is ``map_from_scanner``.

    Raises:
        FailureError: ``EXPORT_NOTHING`` if no registered scan has its file and points.
    """
    run = read_run(folder)
    path = run.folder / "building.e57"
    scanner = _scanner_of(run)
    written = 0
    with whole_file(path) as partial:
        with _Image(partial, run.state.get("ended")) as image:
            for record, pose, scan in run.clouds():
                if len(scan.points):
                    _write_set_up(image, record, pose, scan, scanner)
                    written += 1
        if not written:
            raise FailureError("EXPORT_NOTHING", f"{run.folder} holds no registered scan to export")
    return path


def gps_seconds(moment: Any) -> float:
    """GPS time of an ISO 8601 moment (UTC unless it says otherwise); 0, E57's "not known", for anything else."""
    try:
        parsed = datetime.fromisoformat(str(moment))
    except ValueError:
        return 0.0
    aware = parsed if parsed.tzinfo else parsed.replace(tzinfo=UTC)
    return (aware - _GPS_EPOCH).total_seconds() + _GPS_AHEAD_OF_UTC


class _Image(pye57.E57):
    """An E57 file for writing whose header carries a date: pye57 leaves it at the epoch, and fields are set once."""

    def __init__(self, path: Path, created: Any) -> None:
        self._created = gps_seconds(created) or gps_seconds(datetime.now(UTC).isoformat())
        super().__init__(os.fspath(path), mode="w")

    def write_default_header(self) -> None:
        file = self.image_file
        file.extensionsAdd("", libe57.E57_V1_0_URI)
        created = libe57.StructureNode(file)
        created.set("dateTimeValue", libe57.FloatNode(file, self._created))
        created.set("isAtomicClockReferenced", libe57.IntegerNode(file, 0))
        fields = {
            "formatName": libe57.StringNode(file, "ASTM E57 3D Imaging Data File"),
            "guid": libe57.StringNode(file, _guid()),
            "versionMajor": libe57.IntegerNode(file, libe57.E57_FORMAT_MAJOR),
            "versionMinor": libe57.IntegerNode(file, libe57.E57_FORMAT_MINOR),
            "e57LibraryVersion": libe57.StringNode(file, libe57.E57_LIBRARY_ID),
            "coordinateMetadata": libe57.StringNode(file, ""),
            "creationDateTime": created,
            "data3D": libe57.VectorNode(file, True),
            "images2D": libe57.VectorNode(file, True),
        }
        for name, node in fields.items():
            self.root.set(name, node)


def _guid() -> str:
    return f"{{{uuid.uuid4()}}}"


def _scanner_of(run: Run) -> dict[str, str]:
    """Model and serial number as the scanner gave them; what is not known stays empty."""
    said = next((event for event in run.events_of("agent") if event.get("name") == "scanner"), {})
    return {"sensorModel": str(said.get("model") or ""), "sensorSerialNumber": str(said.get("serial") or "")}


def _write_set_up(
    image: _Image, record: Record, pose: NDArray[np.float64], scan: Scan, scanner: dict[str, str]
) -> None:
    x, y, z, w = transforms.to_quaternion(pose)
    points = scan.points.astype(np.float64)
    data = {
        "cartesianX": points[:, 0],
        "cartesianY": points[:, 1],
        "cartesianZ": points[:, 2],
        "intensity": scan.intensity,
        "rowIndex": (scan.beam // scan.pattern.columns).astype(np.uint16),
        "columnIndex": (scan.beam % scan.pattern.columns).astype(np.uint16),
    }
    room = record.get("room_id")
    image.write_scan_raw(
        data,
        name=f"{room}/{record['scan_id']}" if room else str(record["scan_id"]),
        rotation=np.array([w, x, y, z]),
        translation=pose[:3, 3],
        scan_header=_header(points, record),
    )
    node = image.data3d[image.scan_count - 1]
    for field, value in scanner.items():
        node.set(field, libe57.StringNode(image.image_file, value))


def _header(points: NDArray[np.float64], record: Record) -> SimpleNamespace:
    """What pye57 takes from a header instead of guessing: bounds in the scanner's frame, and the dates."""
    low, high = points.min(axis=0), points.max(axis=0)
    return SimpleNamespace(
        **{f"{axis}Minimum": value for axis, value in zip("xyz", low, strict=True)},
        **{f"{axis}Maximum": value for axis, value in zip("xyz", high, strict=True)},
        intensityMinimum=0.0,
        intensityMaximum=1.0,
        acquisitionStart_dateTimeValue=gps_seconds(record.get("started")),
        acquisitionStart_isAtomicClockReferenced=0,
        acquisitionEnd_dateTimeValue=gps_seconds(record.get("ended")),
        acquisitionEnd_isAtomicClockReferenced=0,
    )
