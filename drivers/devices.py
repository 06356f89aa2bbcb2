"""What an agent plugs in: the scanner and the base as their own computer sees them, real or not.

Every call returns at once (within some 50 ms; planning and moving happen in threads of the device), may come from
several threads, and may raise :class:`~perception.failure.FailureError`, which reaches the executive as it is.
"""

from dataclasses import dataclass
from typing import Protocol

from drivers.interfaces import BaseInfo, DriveGoal, DriveReport, ScannerInfo, ScanSettings, SelfTest
from drivers.jobs import Outcome
from perception.scan import Scan
from perception.transforms import Matrix


class ScannerDevice(Protocol):
    """A scanner at hand."""

    def info(self) -> ScannerInfo: ...

    def self_test(self) -> SelfTest:
        """What the instrument's monitor says just now; room for scans is added by the agent, which keeps them."""
        ...

    def start(self, scan_id: str, settings: ScanSettings, odom_from_base: Matrix) -> None:
        """Begin a scan. Does nothing when this name is already being taken or is done."""
        ...

    def status(self, scan_id: str) -> Outcome[Scan] | None:
        """How far it is; None for a name that was never started."""
        ...

    def abort(self, scan_id: str) -> None:
        """Give it up; the status becomes ``Failed``. Harmless for a name that is unknown or done."""
        ...


@dataclass(frozen=True)
class BaseTelemetry:
    """The base now: :class:`~drivers.interfaces.BaseState` without the age, which only the receiver knows."""

    odom_from_base: Matrix
    map_from_base: Matrix | None
    moving: bool
    emergency_stop: bool
    battery: float
    activity: str


class BaseDevice(Protocol):
    """A mobile base at hand.

    Its wheels are at rest until they are permitted to turn, and again 50 ms after the permit has run out: a device
    judges that in its own control loop, at least at 20 Hz, so that it holds however badly the rest of the agent fares.
    A control loop that finds it was itself stalled for more than 0.2 s brings the wheels to rest first.
    """

    def info(self) -> BaseInfo: ...

    def permit(self, until: float) -> None:
        """The wheels may turn until this instant of ``time.monotonic()``, which takes the place of any told before.

        After it they are brought to rest at once; the goal is kept (activity ``held``), its patience does not run
        out, and a later permit lets the drive go on.
        """
        ...

    def telemetry(self) -> BaseTelemetry: ...

    def start_drive(self, goal: DriveGoal) -> None:
        """Begin to drive, in place of any goal before. Does nothing when this goal is known."""
        ...

    def drive_status(self, goal_id: str) -> Outcome[DriveReport] | None:
        """How far it is; None for a goal that was never started."""
        ...

    def stop(self) -> None:
        """Bring the wheels to rest; the goal under way becomes ``Failed`` with its track as evidence."""
        ...
