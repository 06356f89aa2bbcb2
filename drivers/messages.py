"""What is said on the wire between executive and agents: typed msgpack messages, one frame each.

A :class:`Query` asks and may be answered at any time. A :class:`Command` changes the world: it is obeyed once however
often it arrives, and only while fresh. Freshness needs no common clock: every reply carries the agent's ``boot`` and
``clock``, and a command names the boot it is meant for and the instant of that clock after which it is void, so that
neither a frame that a broken link held back nor one meant for the agent before its restart moves anything.
"""

import math
import zlib
from typing import Annotated, Any, ClassVar, Generic, TypeVar

import msgspec
import numpy as np
from msgspec import Meta

from drivers import interfaces
from drivers.poses import TOLERANCE, rigid
from perception import transforms
from perception.failure import Failure, FailureError
from perception.grids import Cell, Grid
from perception.transforms import Matrix

PROTOCOL = 3
MAX_MESSAGE = 2 << 20
"""Bytes of the largest frame; sockets drop a peer that sends more."""
CHUNK = 1 << 20
"""Bytes of a scan in one message."""
MAX_SCAN = 4 << 30
MAX_MAP_CELLS = 64_000_000

ScanId = Annotated[str, Meta(pattern=r"\A[A-Za-z0-9][A-Za-z0-9_.:-]{0,63}\Z")]
GoalId = Annotated[str, Meta(min_length=1, max_length=128)]
Name = Annotated[str, Meta(max_length=256)]
Finite = Annotated[float, Meta(ge=-1e9, le=1e9)]
Fraction = Annotated[float, Meta(ge=0.0, le=1.0)]
Count = Annotated[int, Meta(ge=0, le=MAX_SCAN)]
WallClock = Annotated[float, Meta(ge=0.0, le=1e11)]
"""Seconds since 1970, UTC, by the sender's own clock: to be compared, never to be obeyed."""
LeaseNumber = tuple[Annotated[int, Meta(ge=0)], Annotated[int, Meta(ge=0)]]
"""Epoch and sequence of a :class:`drivers.interfaces.Lease`."""
Nonce = Annotated[int, Meta(ge=0)]
Owner = Annotated[str, Meta(pattern=r"\A[^\x00-\x1f\x7f]{1,256}\Z")]
Sha256 = Annotated[str, Meta(pattern=r"\A[0-9a-f]{64}\Z")]


class Wire(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Anything on the wire: immutable, and nothing in it that is not asked for."""


class Body(Wire, frozen=True, tag_field="type", tag=True):
    """What an envelope carries."""


class Query(Body, frozen=True):
    """Asks, changes nothing."""


class Command(Body, frozen=True):
    """Changes the world, once per request id. ``always`` marks one that is obeyed however old it is."""

    always: ClassVar[bool] = False


B = TypeVar("B")


class Request(Wire, Generic[B], frozen=True):
    """From the executive. ``request_id`` stays the same over retries."""

    version: int
    request_id: Annotated[str, Meta(min_length=1, max_length=64)]
    body: B
    boot: Name | None = None
    valid_until: float | None = None


class Reply(Wire, Generic[B], frozen=True):
    """From the agent process named ``boot``, at ``clock`` seconds of its monotonic clock."""

    version: int
    request_id: str
    body: B
    boot: Name
    clock: float


class Pose(Wire, frozen=True):
    """A rigid transform: translation in metres and unit quaternion x, y, z, w (REP-103)."""

    translation: tuple[Finite, Finite, Finite]
    rotation: tuple[Finite, Finite, Finite, Finite]

    def __post_init__(self) -> None:
        norm = math.hypot(*self.rotation)
        if abs(norm - 1.0) > TOLERANCE:
            raise ValueError(f"the norm of a rotation must be 1, not {norm:g}")

    @classmethod
    def of(cls, matrix: Matrix) -> "Pose":
        """Raises ``BAD_TRANSFORM`` unless the matrix is a rigid transform."""
        try:
            x, y, z = (float(value) for value in rigid(matrix)[:3, 3])
        except ValueError as error:
            raise FailureError("BAD_TRANSFORM", str(error)) from error
        return cls((x, y, z), transforms.to_quaternion(matrix))

    def matrix(self) -> Matrix:
        return transforms.from_quaternion(self.rotation, self.translation)


class RobotMap(Wire, frozen=True):
    """The robot map ``M(t)``, its cells deflated row by row."""

    map_id: Name
    rows: Annotated[int, Meta(ge=1, le=MAX_MAP_CELLS)]
    columns: Annotated[int, Meta(ge=1, le=MAX_MAP_CELLS)]
    origin: tuple[Finite, Finite]
    resolution: Annotated[float, Meta(gt=0.0, le=10.0)]
    cells: bytes

    def __post_init__(self) -> None:
        if self.rows * self.columns > MAX_MAP_CELLS:
            raise ValueError(f"a robot map has at most {MAX_MAP_CELLS} cells, not {self.rows} x {self.columns}")

    @classmethod
    def of(cls, map_id: str, grid: Grid) -> "RobotMap":
        cells = zlib.compress(np.ascontiguousarray(grid.data, np.uint8).tobytes(), 1)
        x, y = grid.origin
        return cls(map_id, *grid.shape, (float(x), float(y)), float(grid.resolution), cells)

    def grid(self) -> Grid:
        """Raises ``BAD_MESSAGE`` unless the cells inflate to exactly the announced shape; never inflates more."""
        expected = self.rows * self.columns
        inflater = zlib.decompressobj()
        try:
            cells = inflater.decompress(self.cells, expected + 1)
        except zlib.error as error:
            raise FailureError("BAD_MESSAGE", f"the robot map does not inflate: {error}") from error
        data = np.frombuffer(cells, np.uint8)
        if len(data) != expected or not inflater.eof or int(data.max()) > max(Cell):
            raise FailureError("BAD_MESSAGE", f"the robot map is not {self.rows} x {self.columns} known cells")
        return Grid(data.reshape(self.rows, self.columns).copy(), self.origin, self.resolution)


class Goal(Wire, frozen=True):
    """:class:`drivers.interfaces.DriveGoal` on the wire."""

    goal_id: GoalId
    robot_map: RobotMap
    map_from_base: Pose | None
    x: Finite
    y: Finite
    yaw: Finite | None

    @classmethod
    def of(cls, goal: interfaces.DriveGoal) -> "Goal":
        start = None if goal.map_from_base is None else Pose.of(goal.map_from_base)
        yaw = None if goal.yaw is None else float(goal.yaw)
        return cls(goal.goal_id, RobotMap.of(goal.map_id, goal.robot_map), start, float(goal.x), float(goal.y), yaw)

    def value(self) -> interfaces.DriveGoal:
        start = None if self.map_from_base is None else self.map_from_base.matrix()
        grid = self.robot_map.grid()
        return interfaces.DriveGoal(self.goal_id, grid, self.robot_map.map_id, start, self.x, self.y, self.yaw)


class Receipt(Wire, frozen=True):
    """:class:`drivers.interfaces.ScanReceipt` on the wire and beside the stored scan."""

    scan_id: ScanId
    points: Count
    size: Count
    sha256: Sha256
    started: Name
    ended: Name

    def value(self) -> interfaces.ScanReceipt:
        return interfaces.ScanReceipt(**msgspec.structs.asdict(self))


# --- requests ---------------------------------------------------------------------------------------------------------


class Identify(Query, frozen=True):
    """Who answers? ``ScannerIdentity`` or ``BaseIdentity``."""


class SelfTest(Query, frozen=True):
    """Is the instrument fit to scan? ``SelfTested``."""


class Take(Command, frozen=True):
    """Take a scan: ``Pending``, or ``ScanDone`` when it exists."""

    scan_id: ScanId
    step: Annotated[float, Meta(gt=0.0, le=1.0)]
    odom_from_base: Pose


class ScanStatus(Query, frozen=True):
    """``Pending``, ``ScanDone``, ``Problem``, or ``Unknown`` when this agent knows nothing of it."""

    scan_id: ScanId


class Abort(Command, frozen=True):
    """Give a scan up: ``Ok``."""

    scan_id: ScanId


class Release(Command, frozen=True):
    """The scan with this hash is safe elsewhere, its data may go: ``Ok``."""

    scan_id: ScanId
    sha256: Sha256


class Open(Query, frozen=True):
    """What a stored scan is made of: ``Manifest``."""

    scan_id: ScanId


class Read(Query, frozen=True):
    """One chunk of it: ``Chunk``. Asking is the credit: nothing is sent that was not asked for."""

    scan_id: ScanId
    index: Count


class AcquireLease(Command, frozen=True):
    """Who asks wants to move the base: ``LeaseGranted``."""

    owner: Owner


class ReleaseLease(Command, frozen=True):
    """Its owner needs the base no more: ``Ok``."""

    lease: LeaseNumber


class Beat(Body, frozen=True):
    """The owner's tick loop is alive, and the wheels may turn or not: ``Ok``, or ``Late`` for one held back.

    No :class:`Command`, for its nonce says how old it is, and there is nothing to obey twice.
    """

    lease: LeaseNumber
    nonce: Nonce
    tick: Annotated[int, Meta(ge=0)]
    may_move: bool


class Drive(Command, frozen=True):
    """Drive to a goal: ``Pending``, or the end of it when it is known, or ``Late`` when the nonce is too old."""

    goal: Goal
    lease: LeaseNumber
    nonce: Nonce


class DriveStatus(Query, frozen=True):
    """``Pending``, ``DriveDone``, ``Problem``, or ``Unknown`` when this agent knows nothing of it."""

    goal_id: GoalId


class Stop(Command, frozen=True):
    """Stand still, and never start this goal if it is still to come; without a goal whatever is done: ``Ok``.

    The one order that moves nothing, and so the one that needs no lease.
    """

    always: ClassVar[bool] = True
    goal_id: GoalId | None = None


# --- replies ----------------------------------------------------------------------------------------------------------


class Ok(Body, frozen=True):
    """Done as asked."""


class Pending(Body, frozen=True):
    """Under way."""

    fraction: Fraction | None = None
    note: Name = ""


class Unknown(Body, frozen=True):
    """Never heard of it; an agent that restarted says so of what it was doing."""


class Stale(Body, frozen=True):
    """A command was refused: another boot is meant, or it came too late. Its sender may stamp it anew."""


class Late(Body, frozen=True):
    """Refused for an old nonce. Its sender may ask anew with the newest, if it still wants to."""


class Problem(Body, frozen=True):
    """A :class:`~perception.failure.Failure` on the wire."""

    code: Name
    message: Annotated[str, Meta(max_length=4096)]
    evidence: dict[str, Any] = {}

    @classmethod
    def of(cls, failure: Failure) -> "Problem":
        evidence = msgspec.to_builtins(dict(failure.evidence), enc_hook=_plain, str_keys=True)
        return cls(failure.code[:256], failure.message[:4096], evidence)

    def error(self) -> FailureError:
        error = FailureError(self.code, self.message)
        # Set whole: evidence may have keys that the constructor takes for its own arguments.
        error.failure = Failure(self.code, self.message, self.evidence)
        return error


class ScannerIdentity(Body, frozen=True):
    model: Name
    serial: Name
    wall_clock: WallClock


class BaseIdentity(Body, frozen=True):
    model: Name
    serial: Name
    footprint: tuple[Finite, Finite]
    wall_clock: WallClock


class SelfTested(Body, frozen=True):
    """:class:`drivers.interfaces.SelfTest` on the wire."""

    faults: Annotated[list[Name], Meta(max_length=64)]
    figures: Annotated[dict[Name, Finite], Meta(max_length=64)]

    @classmethod
    def of(cls, test: interfaces.SelfTest) -> "SelfTested":
        figures = {name[:256]: float(value) for name, value in test.figures.items()}
        return cls([fault[:256] for fault in test.faults], figures)

    def value(self) -> interfaces.SelfTest:
        return interfaces.SelfTest(tuple(self.faults), self.figures)


class LeaseGranted(Body, frozen=True):
    """:class:`drivers.interfaces.Lease` on the wire."""

    lease: LeaseNumber
    owner: Owner


class ScanDone(Body, frozen=True):
    receipt: Receipt


class Manifest(Body, frozen=True):
    """A stored scan: its size, its hash, and the hash of each chunk of ``chunk`` bytes."""

    size: Count
    sha256: Sha256
    chunk: Annotated[int, Meta(ge=1, le=CHUNK)]
    digests: list[Annotated[bytes, Meta(min_length=32, max_length=32)]]

    def __post_init__(self) -> None:
        if len(self.digests) != -(-self.size // self.chunk):
            raise ValueError(f"{len(self.digests)} chunk hashes do not fit {self.size} bytes")


class Chunk(Body, frozen=True):
    index: Count
    data: bytes


class DriveDone(Body, frozen=True):
    """:class:`drivers.interfaces.DriveReport` on the wire."""

    goal_id: GoalId
    map_from_base: Pose
    track: list[tuple[Finite, Finite, Finite]]
    distance: Finite

    @classmethod
    def of(cls, report: interfaces.DriveReport) -> "DriveDone":
        track = [(float(x), float(y), float(yaw)) for x, y, yaw in report.track]
        return cls(report.goal_id, Pose.of(report.map_from_base), track, float(report.distance))

    def value(self) -> interfaces.DriveReport:
        return interfaces.DriveReport(self.goal_id, self.map_from_base.matrix(), tuple(self.track), self.distance)


class Telemetry(Wire, frozen=True):
    """What the base tells whoever listens; ``sequence`` counts up within a ``boot``, and so does its ``clock``.

    Each has a ``nonce`` of its own: whoever echoes it has heard this very message, and the base knows when it spoke.
    ``owner`` is that of the lease, empty while the base is free.
    """

    version: int
    boot: Name
    sequence: Annotated[int, Meta(ge=0)]
    clock: float
    odom_from_base: Pose
    map_from_base: Pose | None
    moving: bool
    emergency_stop: bool
    battery: Fraction
    activity: Annotated[str, Meta(max_length=32)]
    nonce: Nonce
    owner: Name


ScannerRequest = Identify | SelfTest | Take | ScanStatus | Abort | Release
BulkRequest = Open | Read
BaseRequest = Identify | AcquireLease | ReleaseLease | Beat | Drive | DriveStatus | Stop
AnyReply = (
    Ok
    | Pending
    | Unknown
    | Stale
    | Late
    | Problem
    | ScannerIdentity
    | BaseIdentity
    | SelfTested
    | LeaseGranted
    | ScanDone
    | Manifest
    | Chunk
    | DriveDone
)


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else str(value)
