"""What an operator may set for a mission; the defaults are the paper's where it names them."""

from dataclasses import dataclass, field
from math import inf
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le, Lt

from perception import fence

# No limit is infinite: everything is waited for until some time.
Positive = Annotated[float, Gt(0), Lt(inf)]
NotNegative = Annotated[float, Ge(0), Lt(inf)]
Share = Annotated[float, Ge(0), Le(1)]
Count = Annotated[int, Ge(1)]


@dataclass(frozen=True)
class ScanningSettings:
    """How scans are taken: beam step in degrees, deadline in seconds, attempts at one spot and spots tried.

    ``fetch_timeout_s`` is for bringing one home; what arrived by then is not sent again.
    ``planned`` is for how many scans there must be room on the disk before the mission starts; with less than
    ``min_free_gb`` it stands still for ``room_s`` seconds at most, until somebody makes room.
    Where more than ``moved_share`` of a scan was not there before it waits for ``calm_s`` and takes another.
    """

    step_deg: Annotated[float, Ge(0.01), Le(5.0)] = 0.2
    timeout_s: Positive = 300.0
    fetch_timeout_s: Positive = 600.0
    attempts: Count = 2
    spots: Count = 2
    planned: Count = 40
    min_free_gb: Positive = 0.5
    room_s: Positive = 3600.0
    moved_share: Share = 0.01
    calm_s: NotNegative = 30.0


@dataclass(frozen=True)
class RegistrationSettings:
    """How far the base's pose estimate is trusted: standing error, and growth per metre driven."""

    guess_error_m: NotNegative = 0.15
    guess_error_deg: NotNegative = 3.0
    guess_error_m_per_m: NotNegative = 0.04
    guess_error_deg_per_m: NotNegative = 0.8
    global_search_m: Positive = 3.0


@dataclass(frozen=True)
class RoomSettings:
    """When a room is complete (paper section 5), and how its space is labelled (section 4).

    ``predicted_rate`` ends a room without a confirming scan once no view promises more than that share of V_s.
    """

    growing_rate: Share = 0.04
    occluded_decrease_rate: Share = 0.05
    predicted_rate: Share = 0.008
    max_scans: Count = 12
    voxel_m: Annotated[float, Ge(0.02), Le(0.5)] = 0.10
    labeller: Literal["range", "paper"] = "range"
    candidate_rule: Literal["graded", "paper"] = "graded"
    gain: Literal["all", "surface"] = "all"


@dataclass(frozen=True)
class DrivingSettings:
    """Bounds of driving: deadline of one drive, views tried before the room is given up, how long one is avoided.

    ``look_m`` is the distance from which an opening that may be a door is looked at once more.
    """

    timeout_s: Positive = 900.0
    view_attempts: Count = 5
    avoid_radius_m: NotNegative = 0.5
    avoid_s: NotNegative = 600.0
    path_clearance_m: NotNegative = 0.36
    goal_clearance_m: NotNegative = 0.58
    look_m: Positive = 0.95


@dataclass(frozen=True)
class BuildingSettings:
    """Bounds of the whole mission.

    A base that is silent for ``base_lost_s`` (seconds of the wall) holds the mission for ``base_return_s`` at most, a
    pressed emergency stop for ``release_s``.
    ``fence`` is a polygon that the robot's middle does not leave: metres ahead of and to the left of where it stands
    when the mission begins. Without corners there is none.
    """

    max_rooms: Count = 100
    return_to_start: bool = True
    base_lost_s: Positive = 3.0
    base_return_s: Positive = 60.0
    release_s: Positive = 600.0
    fence: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        if self.fence:
            fence.check(self.fence)


@dataclass(frozen=True)
class BatterySettings:
    """Charge, as a share: below ``low`` the robot goes home after the scan, below ``critical`` it stands still.

    It goes on at ``charged``; ``charging_s`` is how long that may take.
    """

    low: Share = 0.25
    critical: Share = 0.1
    charged: Share = 0.8
    charging_s: Positive = 4 * 3600.0


@dataclass(frozen=True)
class OperatorSettings:
    """Whether the operator is asked where the robot is at its wits' end, how long an answer is waited for, how often.

    Where ``ask`` is false, and after ``patience_s`` without an answer, each question's default is taken.
    """

    ask: bool = True
    patience_s: Positive = 120.0
    rounds: Count = 3


@dataclass(frozen=True)
class WorkerSettings:
    """How much memory the perception worker may have, in gigabytes.

    Above ``memory_high_gb`` another process takes its place when its stage has ended; above ``memory_cap_gb`` it is
    killed at once, and its stage done again.
    """

    memory_high_gb: Positive = 6.0
    memory_cap_gb: Positive = 12.0

    def __post_init__(self) -> None:
        if self.memory_cap_gb < self.memory_high_gb:
            raise ValueError("memory_cap_gb must not be less than memory_high_gb")


@dataclass(frozen=True)
class Settings:
    """All of them."""

    scanning: ScanningSettings = field(default_factory=ScanningSettings)
    registration: RegistrationSettings = field(default_factory=RegistrationSettings)
    room: RoomSettings = field(default_factory=RoomSettings)
    driving: DrivingSettings = field(default_factory=DrivingSettings)
    building: BuildingSettings = field(default_factory=BuildingSettings)
    battery: BatterySettings = field(default_factory=BatterySettings)
    operator: OperatorSettings = field(default_factory=OperatorSettings)
    worker: WorkerSettings = field(default_factory=WorkerSettings)
