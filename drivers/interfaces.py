"""What the executive may ask of a scanner and of a base, whatever stands behind them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

from drivers.jobs import Job
from perception.grids import Grid
from perception.transforms import Matrix


@dataclass(frozen=True)
class ScanSettings:
    """How to take a scan: angle between neighbouring beams in radians."""

    step: float


@dataclass(frozen=True)
class ScanReceipt:
    """A finished scan that the scanner keeps until it has been fetched.

    Args:
        scan_id: the name it was ordered by.
        points: number of returned beams.
        size: length of the encoded scan in bytes.
        sha256: hash of those bytes, hexadecimal.
        started, ended: UTC, ISO 8601.
    """

    scan_id: str
    points: int
    size: int
    sha256: str
    started: str
    ended: str


@dataclass(frozen=True)
class ClockOffset:
    """How far an agent's wall clock is ahead of this computer's, as a round trip shows it.

    Args:
        seconds: the estimate, negative for a clock that is behind.
        uncertainty: seconds that the estimate may be wrong by at most: half the round trip.
    """

    seconds: float = 0.0
    uncertainty: float = 0.0

    @property
    def certain(self) -> float:
        """Seconds by which the clocks differ at least, whichever is ahead."""
        return max(abs(self.seconds) - self.uncertainty, 0.0)


@dataclass(frozen=True)
class ScannerInfo:
    """Who the scanner is; ``clock`` is measured by whoever asks, so it is no part of the identity."""

    model: str
    serial: str
    protocol: int
    clock: ClockOffset = field(default=ClockOffset(), compare=False)


@dataclass(frozen=True)
class SelfTest:
    """What an instrument's own monitor says of it.

    Args:
        faults: what is wrong, each in words for the operator; none when it is fit to scan.
        figures: what the monitor read, by name with the unit at its end, such as ``temperature_c``, ``tilt_deg``,
            ``storage_free_gb``; which ones is the instrument's business.
    """

    faults: tuple[str, ...] = ()
    figures: Mapping[str, float] = field(default_factory=dict)


class Scanner(Protocol):
    """A terrestrial laser scanner. Every scan is named by the caller; the same name is never taken twice."""

    def info(self) -> Job[ScannerInfo]:
        """Ask who answers; fails with ``AGENT_UNREACHABLE``."""
        ...

    def self_test(self) -> Job[SelfTest]:
        """Ask whether the instrument is fit to scan; moves nothing. Fails with ``AGENT_UNREACHABLE``."""
        ...

    def take(self, scan_id: str, settings: ScanSettings, odom_from_base: Matrix) -> Job[ScanReceipt]:
        """Take a scan, or join or return the one of this name. Cancelling stops the scanner."""
        ...

    def fetch(self, receipt: ScanReceipt, destination: Path) -> Job[Path]:
        """Bring the encoded scan (``drivers.scan_file``) to ``destination``, verified, resuming a partial file."""
        ...


@dataclass(frozen=True)
class BaseState:
    """The newest telemetry of the base.

    Args:
        odom_from_base: 4x4, wheel odometry; drifts, never jumps.
        map_from_base: 4x4, the base's own localisation in the last robot map it was given, or None before one.
        moving: whether the wheels turn.
        emergency_stop: whether the hardware stop is pressed.
        battery: state of charge in [0, 1].
        activity: one of ``idle``, ``driving``, ``waiting``, ``blocked``, ``stopped``, ``held`` (there is a goal, but
            nobody lets the wheels turn).
        age: seconds since it was received.
        owner: of the lease, empty while the base is free.
        odom_frame: name of what ``odom_from_base`` is told in. It changes when odometry begins anew; what was known of
            the place by the frame before says nothing of where the base stands now.
    """

    odom_from_base: Matrix
    map_from_base: Matrix | None
    moving: bool
    emergency_stop: bool
    battery: float
    activity: str
    age: float
    owner: str = ""
    odom_frame: str = ""


@dataclass(frozen=True)
class Lease:
    """The right to move a base. Of two numbers ``(epoch, sequence)`` of one base, the greater was given later.

    Args:
        epoch: of the base agent's boot.
        sequence: counts the leases of that boot.
        owner: host, process and user, for people to read.
    """

    epoch: int
    sequence: int
    owner: str

    @property
    def number(self) -> tuple[int, int]:
        return self.epoch, self.sequence


@dataclass(frozen=True)
class BaseInfo:
    """Who the base is and how large: footprint is length x width in metres, centred on ``base_link``.

    ``clock`` as for :class:`ScannerInfo`.
    """

    model: str
    serial: str
    protocol: int
    footprint: tuple[float, float]
    clock: ClockOffset = field(default=ClockOffset(), compare=False)


@dataclass(frozen=True)
class DriveGoal:
    """Where to go.

    Args:
        goal_id: name, stable over retries; the same goal is never driven twice.
        robot_map: the robot map ``M(t)`` of :class:`~perception.grids.Cell`.
        map_id: name of that map.
        map_from_base: 4x4, where the base stands now in that map, as registration found it, or None to rely on
            the base's own localisation.
        x, y: goal in the map frame, metres.
        yaw: heading at the goal in radians, or None for any.
    """

    goal_id: str
    robot_map: Grid
    map_id: str
    map_from_base: Matrix | None
    x: float
    y: float
    yaw: float | None = None


@dataclass(frozen=True)
class DriveReport:
    """The end of a drive: where the base believes it is, and the places it drove over ``(N, 3)`` x, y, yaw (map)."""

    goal_id: str
    map_from_base: Matrix
    track: tuple[tuple[float, float, float], ...]
    distance: float


class Base(Protocol):
    """A mobile base that plans and drives in the robot map it is given and stops by itself before obstacles.

    It is moved by the owner of its lease alone, and its wheels turn only while that owner's beats arrive and allow it.
    """

    def info(self) -> Job[BaseInfo]:
        """Ask who answers; fails with ``AGENT_UNREACHABLE``."""
        ...

    def state(self) -> BaseState | None:
        """Newest telemetry, or None before the first."""
        ...

    def acquire(self, owner: str) -> Job[Lease]:
        """Become the one who moves the base.

        Fails with ``LEASE_HELD``, naming the owner in its message and evidence (``owner``, ``silent_s`` since it was
        last heard of, ``free_in_s``), or ``AGENT_UNREACHABLE``.
        """
        ...

    def beat(self, tick: int, may_move: bool) -> None:
        """Say that the mission is alive; called at every tick, from the tick loop itself and from nowhere else.

        The base answers for its wheels only as far as it hears this: without a beat for half a second, or with
        ``may_move`` False, it stands still and keeps its goal, and goes on with the next beat that allows it. Never
        blocks. All calls come from one thread, ``tick`` counting up.
        """
        ...

    def release(self) -> Job[None]:
        """Give the lease back, at rest. Harmless without one."""
        ...

    def drive(self, goal: DriveGoal) -> Job[DriveReport]:
        """Drive to a goal.

        Fails with ``NAV_NO_PATH`` (nothing was driven), ``NAV_BLOCKED`` (an obstacle stayed in the way),
        ``NAV_STUCK`` (no progress, localisation lost), ``NAV_INTERRUPTED`` (the base began anew), ``COLLISION`` (it
        touched something, and stopped by itself), ``ESTOP``,
        ``LEASE_LOST`` (the base is somebody else's now, or was never ours; evidence names its ``owner``),
        ``AGENT_UNREACHABLE``. Evidence holds the ``track`` driven and its ``distance``, as far as anybody knows.
        Cancelling stops the base.
        """
        ...

    def stop(self) -> Job[None]:
        """Bring the wheels to rest and drop any goal. Harmless at any time, and obeyed with or without the lease."""
        ...
