"""What an operator may set for a mission; the defaults are the paper's where it names them."""

from dataclasses import dataclass, field
from typing import Annotated, Literal

from annotated_types import Ge, Gt, Le

Positive = Annotated[float, Gt(0)]
NotNegative = Annotated[float, Ge(0)]
Share = Annotated[float, Ge(0), Le(1)]
Count = Annotated[int, Ge(1)]


@dataclass(frozen=True)
class ScanningSettings:
    """How scans are taken: beam step in degrees, deadline in seconds, attempts at one spot and spots tried."""

    step_deg: Annotated[float, Ge(0.01), Le(5.0)] = 0.2
    timeout_s: Positive = 300.0
    attempts: Count = 2
    spots: Count = 2


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
    """Bounds of the whole mission."""

    max_rooms: Count = 100
    return_to_start: bool = True
    base_lost_s: Positive = 10.0


@dataclass(frozen=True)
class Settings:
    """All of them."""

    scanning: ScanningSettings = field(default_factory=ScanningSettings)
    registration: RegistrationSettings = field(default_factory=RegistrationSettings)
    room: RoomSettings = field(default_factory=RoomSettings)
    driving: DrivingSettings = field(default_factory=DrivingSettings)
    building: BuildingSettings = field(default_factory=BuildingSettings)
