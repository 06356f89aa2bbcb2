"""What the mission knows of the building: scans with poses, rooms with their cycles, doors. Small, immutable values."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from drivers.interfaces import BaseState, ScanReceipt
from perception.building import Building
from perception.failure import Failure
from perception.findings import Alignment, Door, LabelCounts, Registration, RoomShape
from perception.stopping import StopDecision
from perception.transforms import Matrix, difference, inverse, planar, to_planar

PlanarPose = tuple[float, float, float]
"""x, y in metres and yaw in radians, map frame."""


@dataclass(frozen=True)
class CurrentScan:
    """The scan of this cycle on its way to a pose; each stage adds what it found.

    Args:
        scan_id: name of the scan.
        map_from_base_guess: 4x4, where the base believed it stood, None for the very first scan.
        guess_distance: metres driven since the last registered scan, which the guess's error grows with.
        odom_frame: what ``odom_from_base`` is told in.
        adrift: whether odometry began anew since the last registered scan, so that the guess is worth little.
    """

    scan_id: str
    odom_from_base: Matrix
    map_from_base_guess: Matrix | None
    guess_distance: float
    receipt: ScanReceipt | None = None
    base_from_scanner: Matrix | None = None
    points: int = 0
    alignment: Alignment | None = None
    odom_frame: str = ""
    adrift: bool = False


@dataclass(frozen=True)
class ScanRecord:
    """A registered scan.

    Args:
        registration: how it was registered; ``map_from_scanner`` may have been adjusted since.
        residual: metres rms between its surface and that of the scans around it; None before it was compared.
        odom_frame: what ``odom_from_base`` is told in.
        movement: share of its points that was not there before; None where there was nothing to compare with.
    """

    scan_id: str
    room_id: str
    map_from_scanner: Matrix
    map_from_base: Matrix
    odom_from_base: Matrix
    points: int
    receipt: ScanReceipt
    alignment: Alignment
    registration: Registration
    residual: float | None = None
    odom_frame: str = ""
    movement: float | None = None

    @property
    def moved_m(self) -> float:
        """How far the building's pose graph has moved the scan from where it was registered, metres."""
        return difference(self.registration.map_from_scanner, self.map_from_scanner)[0]

    def adjusted(self, map_from_scanner: Matrix, residual: float | None) -> "ScanRecord":
        """The scan elsewhere, and the base under it as it stood to the scanner."""
        correction = map_from_scanner @ inverse(self.map_from_scanner)
        map_from_base = planar(*to_planar(correction @ self.map_from_base))
        return replace(self, map_from_scanner=map_from_scanner, map_from_base=map_from_base, residual=residual)

    @property
    def base_pose(self) -> PlanarPose:
        return to_planar(self.map_from_base)


@dataclass(frozen=True)
class Labelled:
    """The labels of a room, and the scan after which it got them; one that only told the place may be newer."""

    scan_id: str
    counts: LabelCounts


@dataclass(frozen=True)
class Cycle:
    """One cycle of a room: the scan, the labels after it, and what was decided."""

    scan_id: str
    counts: LabelCounts
    decision: StopDecision


@dataclass(frozen=True)
class Target:
    """A place to drive to, and what for."""

    goal_id: str
    x: float
    y: float
    yaw: float | None
    purpose: str


@dataclass(frozen=True)
class Avoided:
    """A view given up until a time (mission seconds), because the way to it was blocked."""

    x: float
    y: float
    until: float


@dataclass(frozen=True)
class Survey:
    """All of it. Every change gives a new value; leaves write it back to the blackboard."""

    building: Building = field(default_factory=Building)
    scans: tuple[ScanRecord, ...] = ()
    set_aside: tuple[CurrentScan, ...] = ()
    shapes: Mapping[str, RoomShape] = field(default_factory=dict)
    cycles: Mapping[str, tuple[Cycle, ...]] = field(default_factory=dict)
    suspects: tuple[Door, ...] = ()
    looked_at: tuple[Door, ...] = ()
    track: tuple[PlanarPose, ...] = ()
    driven: float = 0.0
    map_id: str | None = None
    scans_ordered: int = 0
    goals_given: int = 0
    questions_asked: int = 0
    loops_closed: int = 0
    """Loops that all poses were last adjusted to."""
    stranded: Failure | None = None
    """Why the robot did not come home when the work was done."""

    @property
    def position(self) -> tuple[float, float]:
        """Where the base stands, x and y; the origin before the first scan."""
        return self.track[-1][:2] if self.track else (0.0, 0.0)

    def cycle_number(self, room_id: str, scan_id: str | None = None) -> int:
        """The cycle ``t`` of a room that a scan belongs to, the newest one if not named; counts from one."""
        newest = self.scans[-1].scan_id if self.scans else None
        return 1 + sum(cycle.scan_id != (scan_id or newest) for cycle in self.cycles.get(room_id, ()))

    def scans_near(self, room_id: str) -> tuple[ScanRecord, ...]:
        """Scans of a room and of the rooms that a door joins it with: those that can have seen into it."""
        rooms = {room_id, *self.building.neighbours(room_id)}
        return tuple(scan for scan in self.scans if scan.room_id in rooms)

    def room_scans(self, room_id: str) -> tuple[ScanRecord, ...]:
        return tuple(scan for scan in self.scans if scan.room_id == room_id)

    @property
    def loops(self) -> int:
        """Independent loops of rooms and doors: doors between known rooms beyond those that first led to each."""
        joined = sum(None not in edge.rooms for edge in self.building.doors)
        return max(0, joined - max(0, len(self.building.rooms) - 1))

    def adjusted(self, poses: Mapping[str, Matrix], residuals: Mapping[str, float]) -> "Survey":
        """All scans where the building's pose graph has them."""
        scans = tuple(scan.adjusted(poses[scan.scan_id], residuals.get(scan.scan_id)) for scan in self.scans)
        return replace(self, scans=scans)

    def with_scan(self, scan: ScanRecord) -> "Survey":
        """A registered scan more; the base is known to stand there now."""
        return replace(
            self,
            scans=(*self.scans, scan),
            track=(*self.track, scan.base_pose),
            driven=0.0,
        )

    def with_earlier_scan(self, scan: ScanRecord) -> "Survey":
        """A scan that was set aside and found its place: before the newest, at which the base still stands."""
        return replace(self, scans=(*self.scans[:-1], scan, *self.scans[-1:]))

    def with_movement(self, share: float) -> "Survey":
        """It is known how much of the newest scan was not there before."""
        *rest, newest = self.scans
        return replace(self, scans=(*rest, replace(newest, movement=share)))

    def with_shape(self, room_id: str, shape: RoomShape) -> "Survey":
        return replace(self, shapes={**self.shapes, room_id: shape})

    def with_drive(self, track: tuple[PlanarPose, ...], distance: float) -> "Survey":
        return replace(self, track=(*self.track, *track), driven=self.driven + distance)

    def next_goal(self) -> tuple["Survey", str]:
        """A new goal's name, never given before."""
        number = self.goals_given + 1
        return replace(self, goals_given=number), f"G{number:03d}"

    def knows_place(self, base: BaseState) -> bool:
        """Whether odometry leads on from the last registered scan; before the first there is nothing to lead from."""
        return not self.scans or self.scans[-1].odom_frame == base.odom_frame

    def believed_pose(self, base: BaseState) -> Matrix | None:
        """``map_from_base`` as well as it is known; None before the first scan."""
        if not self.scans:
            return None
        if base.map_from_base is not None:
            return base.map_from_base
        reckoned = self.reckoned_pose(base)
        return planar(*self.track[-1]) if reckoned is None else reckoned

    def reckoned_pose(self, base: BaseState) -> Matrix | None:
        """``map_from_base`` by odometry alone, from the last scan on; None where that does not lead to here."""
        if not self.scans or not self.knows_place(base):
            return None
        last = self.scans[-1]
        return last.map_from_base @ inverse(last.odom_from_base) @ base.odom_from_base
