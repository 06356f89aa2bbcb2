"""What the evaluation counts, and how finely."""

from dataclasses import dataclass


@dataclass(frozen=True)
class EvaluationSettings:
    """Lengths in metres unless the name says otherwise.

    Args:
        cell_m: side of a surface cell.
        min_points: points that a sensed cell holds at least.
        tolerance_m: greatest distance of such a point from the true surface.
        station_step_m: grid of the places from which C* is looked at.
        station_reach_m: how far outside a room its stations may stand.
        incidence_deg: a surface seen flatter than this is not seen.
        door_match_m: a found door and a true one within this distance are the same.
        room_share: share of a true room that a finished room's contour covers at least.
    """

    cell_m: float = 0.10
    min_points: int = 2
    tolerance_m: float = 0.05
    station_step_m: float = 0.20
    station_reach_m: float = 1.5
    incidence_deg: float = 84.0
    door_match_m: float = 0.5
    room_share: float = 0.5
