"""What a base is asked, what it answers, and what it tells whoever listens."""

import zlib
from typing import Annotated, ClassVar

import numpy as np
from msgspec import Meta

from drivers import interfaces
from drivers.messages.common import Identify, Pose
from drivers.messages.envelope import Body, Command, Finite, Fraction, Name, Query, WallClock, Wire
from perception.failure import FailureError
from perception.grids import Cell, Grid

MAX_MAP_CELLS = 64_000_000

GoalId = Annotated[str, Meta(min_length=1, max_length=128)]
LeaseNumber = tuple[Annotated[int, Meta(ge=0)], Annotated[int, Meta(ge=0)]]
"""Epoch and sequence of a :class:`drivers.interfaces.Lease`."""
Nonce = Annotated[int, Meta(ge=0)]
Owner = Annotated[str, Meta(pattern=r"\A[^\x00-\x1f\x7f]{1,256}\Z")]


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


class Late(Body, frozen=True):
    """Refused for an old nonce. Its sender may ask anew with the newest, if it still wants to."""


class BaseIdentity(Body, frozen=True):
    model: Name
    serial: Name
    footprint: tuple[Finite, Finite]
    wall_clock: WallClock


class LeaseGranted(Body, frozen=True):
    """:class:`drivers.interfaces.Lease` on the wire."""

    lease: LeaseNumber
    owner: Owner


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


BaseRequest = Identify | AcquireLease | ReleaseLease | Beat | Drive | DriveStatus | Stop
