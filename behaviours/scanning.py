"""Leaves that take a scan, bring it home, and look whether it is one."""

import math
from dataclasses import replace
from typing import Any

from py_trees.common import Status

from behaviours.job import JobLeaf
from behaviours.keys import Key
from behaviours.leaf import Leaf
from behaviours.survey import CurrentScan
from drivers.interfaces import ScanReceipt, ScanSettings
from drivers.jobs import Job
from perception.failure import Failure, FailureError
from perception.findings import Alignment


class StandStill(Leaf):
    """Waits for telemetry that is newer than its first tick and says that the wheels are at rest.

    A drive that has just ended was sensed at the beginning of this tick, when the base still rolled: a scan ordered
    now would carry an odometry that is not its own.
    """

    reads = (Key.BASE,)
    patience_s = 20.0

    def begin(self) -> None:
        self._began = self.services.clock.now()
        self._sensed_anew = False

    def step(self) -> Status:
        base = self.read(Key.BASE)
        if self._sensed_anew and base is not None and not base.moving:
            return Status.SUCCESS
        self._sensed_anew = True
        if self.services.clock.now() - self._began > self.patience_s:
            raise FailureError("BASE_LOST" if base is None else "SCAN_MOVED", "the base does not come to rest")
        return Status.RUNNING


class TakeScan(JobLeaf):
    """Orders a scan under a new name where the base stands and waits until the scanner has it.

    Nothing lets the base move from the order to the scan's end, whatever else goes on; where nobody tells of the end,
    to that of the time that a scan may take.
    """

    reads = (Key.BASE,)
    writes = (Key.SCAN, Key.SURVEY)
    timeout_code = "SCAN_TIMEOUT"
    _turns_on = False
    """Whether the scanner may be at it still, though this leaf has given it up."""

    def start(self) -> Job[ScanReceipt]:
        base = self.read(Key.BASE)
        if base is None:
            raise FailureError("BASE_LOST", "the base sends no odometry, so a scan would have no place")
        survey = self.read(Key.SURVEY)
        survey = replace(survey, scans_ordered=survey.scans_ordered + 1)
        scan_id = f"S{survey.scans_ordered:02d}"
        scan = CurrentScan(
            scan_id,
            base.odom_from_base,
            survey.believed_pose(base),
            survey.driven,
            odom_frame=base.odom_frame,
            adrift=not survey.knows_place(base),
        )
        self.write(Key.SURVEY, survey)
        self.write(Key.SCAN, scan)
        self._turns_on = False
        self.services.interlock.hold(self.name)
        step = self.services.settings.scanning.step_deg * math.pi / 180
        return self.services.scanner.take(scan_id, ScanSettings(step), base.odom_from_base)

    def timeout(self) -> float:
        return self.services.settings.scanning.timeout_s

    def terminate(self, new_status: Status) -> None:
        super().terminate(new_status)
        if hasattr(self, "services") and not self._turns_on:
            self.services.interlock.release(self.name)

    def failed(self, failure: Failure) -> Status:
        self._turns_on = failure.code == "AGENT_UNREACHABLE"
        if self._turns_on:
            self.services.interlock.hold(self.name, until=self._began + self.timeout())
        return super().failed(failure)

    def finish(self, value: ScanReceipt) -> Status:
        self.write(Key.SCAN, replace(self.read(Key.SCAN), receipt=value))
        self.say(f"{value.scan_id}: {value.points:,} points")
        return Status.SUCCESS


class FetchScan(JobLeaf):
    """Brings the scan from the scanner's computer into the run folder, verified."""

    reads = (Key.SCAN,)
    timeout_code = "XFER_TIMEOUT"

    def start(self) -> Job[Any]:
        scan = self.read(Key.SCAN)
        return self.services.scanner.fetch(scan.receipt, self.services.files.scan_file(scan.scan_id))

    def timeout(self) -> float:
        return self.services.settings.scanning.fetch_timeout_s

    def finish(self, value: Any) -> Status:
        scan = self.read(Key.SCAN)
        self.services.journal.record(
            "scan", scan_id=scan.scan_id, file=value.name, points=scan.receipt.points, sha256=scan.receipt.sha256
        )
        self.say(f"{scan.receipt.size / 1e6:.1f} MB, hash verified")
        return Status.SUCCESS


class StageLeaf(JobLeaf):
    """A stage of the paper in the perception worker: :meth:`arguments` builds the goal."""

    stage: str

    def arguments(self) -> dict[str, object]:
        raise NotImplementedError(type(self).__name__)

    def start(self) -> Job[Any]:
        return self.services.perception.submit(self.stage, **self.arguments())


class ValidateScan(StageLeaf):
    """Looks whether the scan is a cloud of a room at all, before anything believes it."""

    reads = ()
    writes = (Key.SCAN,)
    stage = "validate_scan"

    def arguments(self) -> dict[str, object]:
        return {"scan_id": self.read(Key.SCAN).scan_id}

    def finish(self, value: Any) -> Status:
        scan = replace(self.read(Key.SCAN), points=value.points, base_from_scanner=value.base_from_scanner)
        self.write(Key.SCAN, scan)
        self.say(f"{value.points:,} points, median range {value.median_range:.1f} m")
        return Status.SUCCESS


class AlignScan(StageLeaf):
    """Section 3.1: takes the tilt out and finds floor and ceiling."""

    writes = (Key.SCAN,)
    stage = "align_scan"

    def arguments(self) -> dict[str, object]:
        return {"scan_id": self.read(Key.SCAN).scan_id}

    def finish(self, value: Alignment) -> Status:
        self.write(Key.SCAN, replace(self.read(Key.SCAN), alignment=value))
        tilt = [angle * 180 / math.pi for angle in (value.roll, value.pitch)]
        self.say(f"roll {tilt[0]:+.2f}°, pitch {tilt[1]:+.2f}°, ceiling at {value.ceiling_z:.2f} m")
        return Status.SUCCESS
