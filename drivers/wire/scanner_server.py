"""A scanner behind the wire: scans by name, each taken at most once and kept until it was fetched."""

import math
import time
from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

from drivers.devices import ScannerDevice
from drivers.interfaces import ScanSettings
from drivers.jobs import Failed, Progress
from drivers.messages import (
    Abort,
    Body,
    Chunk,
    Identify,
    Manifest,
    Ok,
    Open,
    Read,
    Receipt,
    Release,
    ScanDone,
    ScannerIdentity,
    ScannerRequest,
    ScanStatus,
    SelfTest,
    SelfTested,
    Take,
    Unknown,
)
from drivers.scan_file import BYTES_PER_POINT
from drivers.wire.follow import Errands, follow, tell
from drivers.wire.spool import Spool


class ScannerService:
    """Answers what a scanner is asked on its control and on its bulk endpoint.

    A name whose scan failed or was aborted is free again; one whose scan was stored never is, not even after the
    agent restarted or the data was released.
    """

    def __init__(self, device: ScannerDevice, spool_folder: Path) -> None:
        self._device = device
        self._spool = Spool(spool_folder)
        self._errands = Errands()

    def control(self, request: ScannerRequest) -> Body:
        """Reply to a request on the control endpoint."""
        match request:
            case Identify():
                info = self._device.info()
                return ScannerIdentity(info.model, info.serial, time.time())
            case SelfTest():
                return self._self_test()
            case Take():
                return self._take(request)
            case ScanStatus(scan_id):
                return self._status(scan_id)
            case Abort(scan_id):
                self._errands.cancel(scan_id)
                self._device.abort(scan_id)
            case Release(scan_id, sha256):
                self._spool.release(scan_id, sha256)
        return Ok()

    def bulk(self, request: Open | Read) -> Manifest | Chunk:
        """Reply to a request on the bulk endpoint."""
        match request:
            case Open(scan_id):
                return self._spool.open(scan_id)
            case Read(scan_id, index):
                return self._spool.read(scan_id, index)

    def close(self) -> None:
        """Stop the scanner."""
        for scan_id in self._errands.cancel_all():
            self._device.abort(scan_id)

    def _self_test(self) -> SelfTested:
        found = self._device.self_test()
        return SelfTested.of(replace(found, figures={**found.figures, "storage_free_gb": self._spool.free / 1e9}))

    def _take(self, request: Take) -> Body:
        status = self._status(request.scan_id)
        if isinstance(status, Unknown) or self._has_failed(request.scan_id):
            self._spool.require_room(_largest_size(request.step))
            self._errands.begin(request.scan_id, self._scanning(request))
            return self._status(request.scan_id)
        return status

    def _has_failed(self, scan_id: str) -> bool:
        job = self._errands.get(scan_id)
        return job is not None and isinstance(job.poll(), Failed)

    def _status(self, scan_id: str) -> Body:
        job = self._errands.get(scan_id)
        if job is not None:
            return tell(job.poll(), ScanDone)
        stored = self._spool.find(scan_id)
        return Unknown() if stored is None else ScanDone(stored.receipt)

    def _scanning(self, request: Take) -> Callable[[Progress], Receipt]:
        def run(progress: Progress) -> Receipt:
            scan_id = request.scan_id
            started = _now()
            self._device.start(scan_id, ScanSettings(request.step), request.odom_from_base.matrix())
            if progress.cancelled:  # the abort may have come before there was anything to abort
                self._device.abort(scan_id)
            scan = follow(lambda: self._device.status(scan_id), progress, f"scan {scan_id}")
            ended = _now()
            progress.report(1.0, "storing")
            return self._spool.store(scan, started, ended)

        return run


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="milliseconds")


def _largest_size(step: float) -> int:
    """Bytes of a scan in which every beam of a whole sphere returns."""
    return math.ceil(2 * math.pi / step * math.pi / step) * BYTES_PER_POINT
