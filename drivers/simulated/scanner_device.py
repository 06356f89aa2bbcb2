"""The simulated scanner as its agent sees it: scans by name that take their time, and sometimes go wrong."""

import math
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from drivers.interfaces import ScannerInfo, ScanSettings, SelfTest
from drivers.jobs import Done, Failed, Outcome, Running
from drivers.messages import PROTOCOL
from drivers.simulated.clock import Clock
from drivers.simulated.scanner import SimulatedScanner
from drivers.simulated.scenario import ScannerFaults
from drivers.simulated.stance import Stance
from drivers.simulated.truth_log import TruthLog
from perception import transforms
from perception.failure import Failure, FailureError
from perception.scan import Scan
from perception.transforms import Matrix

_KEPT = 3
_TRUNCATED_SHARE = 0.1
_WARM_C = 31.0
_STILL_M, _STILL_RAD = 0.005, 0.002


@dataclass
class _Taking:
    """A scan under way: when it began, where, what it will be (None for one that never answers), what spoilt it."""

    started: float
    stance: Stance
    work: Future[Scan] | None
    spoilt: Failure | None = None
    complete: bool = False


class SimulatedScannerDevice:
    """A :class:`~drivers.devices.ScannerDevice` in a world.

    A scan shows the building as it is when the scan begins. None is begun on a base that rolls, and one during which
    the base moved is none, as its inclinometer tells a real scanner.

    Args:
        scanner: casts the rays.
        stance: asks where the base truly stands; raises ``AGENT_UNREACHABLE`` where nobody can tell.
        clock: a scan takes ``profile.duration`` of its seconds.
        faults: scripted.
        truth: log for the evaluation.
    """

    def __init__(
        self,
        scanner: SimulatedScanner,
        stance: Callable[[], Stance],
        clock: Clock,
        faults: ScannerFaults | None = None,
        truth: TruthLog | None = None,
    ) -> None:
        self._scanner = scanner
        self._stance = stance
        self._clock = clock
        self._truth = truth or TruthLog()
        faults = faults or ScannerFaults()
        self._script = (
            ["fail"] * faults.fail_first + ["hang"] * faults.hang_first + ["truncate"] * faults.truncate_first
        )
        self._complaints = faults.self_test
        self._takings: dict[str, _Taking] = {}
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="scanner")

    def info(self) -> ScannerInfo:
        return ScannerInfo(self._scanner.profile.model, f"SIM-{self._scanner.seed:04d}", PROTOCOL)

    def self_test(self) -> SelfTest:
        """What is scripted; the tilt is that of the floor it stands on, where anybody can tell."""
        figures = {"temperature_c": _WARM_C}
        try:
            tilt = np.hypot(*self._stance().tilt)
        except FailureError:
            return SelfTest(("the inclinometer does not answer", *self._complaints), figures)
        return SelfTest(self._complaints, {**figures, "tilt_deg": round(math.degrees(tilt), 3)})

    def start(self, scan_id: str, settings: ScanSettings, odom_from_base: Matrix) -> None:
        """Begin a scan; nothing happens where one of this name is under way or done. One that failed is taken anew.

        Raises:
            FailureError: ``SCAN_REJECTED`` while the base moves; ``AGENT_UNREACHABLE``.
        """
        known = self.status(scan_id)
        if known is not None and not isinstance(known, Failed):
            return
        stance = self._stance()
        if stance.moving:
            raise FailureError("SCAN_REJECTED", f"scan {scan_id} was not begun: the base is moving", scan_id=scan_id)
        fault = self._script.pop(0) if self._script else ""
        taking = _Taking(self._clock.now(), stance, None)
        if fault != "hang":
            taking.work = self._pool.submit(self._take, scan_id, settings, odom_from_base, fault, taking)
        self._takings[scan_id] = taking
        # A scan is up to a hundred megabytes; the agent has stored the older ones long ago.
        for old in list(self._takings)[:-_KEPT]:
            del self._takings[old]

    def status(self, scan_id: str) -> Outcome[Scan] | None:
        """How far a scan is; None for a name that is not known."""
        taking = self._takings.get(scan_id)
        if taking is None:
            return None
        fraction = (self._clock.now() - taking.started) / self._scanner.profile.duration
        if fraction >= 1.0:
            self._look_whether_it_moved(scan_id, taking)
        if taking.spoilt is not None:
            return Failed(taking.spoilt)
        if fraction < 1.0:
            return Running(fraction, "scanning")
        if taking.work is None or not taking.work.done():
            return Running(1.0, "reading out")
        try:
            return Done(taking.work.result())
        except FailureError as error:
            return Failed(error.failure)

    def abort(self, scan_id: str) -> None:
        """Give a scan up; harmless for one that is not under way."""
        if isinstance(self.status(scan_id), Running):
            self._takings[scan_id].spoilt = Failure("CANCELLED", f"scan {scan_id} was aborted")

    def _look_whether_it_moved(self, scan_id: str, taking: _Taking) -> None:
        """Once, when the last beam is out; a base that is gone cannot have been seen to move."""
        if taking.complete:
            return
        taking.complete = True
        try:
            now = self._stance()
        except FailureError:
            return
        metres, radians = transforms.difference(taking.stance.map_from_base, now.map_from_base)
        if now.moving or metres > _STILL_M or radians > _STILL_RAD:
            taking.spoilt = taking.spoilt or Failure(
                "SCAN_MOVED",
                f"the base moved by {1000 * metres:.0f} mm during scan {scan_id}",
                {"scan_id": scan_id, "metres": metres, "radians": radians},
            )

    def _take(self, scan_id: str, settings: ScanSettings, odom_from_base: Matrix, fault: str, taking: _Taking) -> Scan:
        if fault == "fail":
            raise FailureError("SCAN_FAILED", f"the scanner reported an error during {scan_id}", scan_id=scan_id)
        stance = taking.stance
        scan = self._scanner.cast(
            stance.map_from_base, settings.step, scan_id, odom_from_base, stance.tilt, stance.bodies
        )
        self._truth.write(
            "scan",
            taking.started,
            scan_id=scan_id,
            world_from_scanner=self._scanner.map_from_scanner(stance.map_from_base, stance.tilt),
            world_from_base=stance.map_from_base,
            moving=stance.moving,
        )
        return _truncated(scan) if fault == "truncate" else scan


def _truncated(scan: Scan) -> Scan:
    """What is left when the transfer inside the instrument breaks off."""
    kept = int(len(scan.points) * _TRUNCATED_SHARE)
    return replace(scan, points=scan.points[:kept], intensity=scan.intensity[:kept], beam=np.copy(scan.beam[:kept]))
