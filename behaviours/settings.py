"""What an operator may set for a mission; the defaults are the paper's where it names them."""

from dataclasses import dataclass, field
from typing import Literal


@dataclass(frozen=True)
class ScanningSettings:
    """How scans are taken: beam step in degrees, deadline in seconds, attempts at one spot and spots tried."""

    step_deg: float = 0.2
    timeout_s: float = 300.0
    attempts: int = 2
    spots: int = 2


@dataclass(frozen=True)
class RegistrationSettings:
    """How far the base's pose estimate is trusted: standing error, and growth per metre driven."""

    guess_error_m: float = 0.15
    guess_error_deg: float = 3.0
    guess_error_m_per_m: float = 0.04
    guess_error_deg_per_m: float = 0.8
    global_search_m: float = 3.0


@dataclass(frozen=True)
class RoomSettings:
    """When a room is complete (paper section 5), and how its space is labelled (section 4).

    ``predicted_rate`` ends a room without a confirming scan once no view promises more than that share of V_s.
    """

    growing_rate: float = 0.04
    occluded_decrease_rate: float = 0.05
    predicted_rate: float = 0.008
    max_scans: int = 12
    voxel_m: float = 0.10
    labeller: Literal["range", "paper"] = "range"
    candidate_rule: Literal["graded", "paper"] = "graded"
    gain: Literal["all", "surface"] = "all"


@dataclass(frozen=True)
class DrivingSettings:
    """Bounds of driving: deadline of one drive, views tried before the room is given up, how long one is avoided.

    ``look_m`` is the distance from which an opening that may be a door is looked at once more.
    """

    timeout_s: float = 900.0
    view_attempts: int = 5
    avoid_radius_m: float = 0.5
    avoid_s: float = 600.0
    path_clearance_m: float = 0.36
    goal_clearance_m: float = 0.58
    look_m: float = 0.95


@dataclass(frozen=True)
class BuildingSettings:
    """Bounds of the whole mission."""

    max_rooms: int = 100
    return_to_start: bool = True
    base_lost_s: float = 10.0


@dataclass(frozen=True)
class Settings:
    """All of them."""

    scanning: ScanningSettings = field(default_factory=ScanningSettings)
    registration: RegistrationSettings = field(default_factory=RegistrationSettings)
    room: RoomSettings = field(default_factory=RoomSettings)
    driving: DrivingSettings = field(default_factory=DrivingSettings)
    building: BuildingSettings = field(default_factory=BuildingSettings)
