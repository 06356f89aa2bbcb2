"""The operator's fence, where the mission's map has it."""

from behaviours.settings import Settings
from behaviours.survey import Survey
from perception import building as plan
from perception import fence
from perception.building import Building
from perception.findings import Polygon

_BEYOND = 0.8
"""Metres past a door at which the next room surely is."""


def fence_of(survey: Survey, settings: Settings) -> Polygon | None:
    """The fence in the map frame; None without one, or before there is a map to have it in."""
    corners = settings.building.fence
    return fence.in_map(corners, survey.scans[0].map_from_base) if corners and survey.scans else None


def within(building: Building, boundary: Polygon | None) -> Building:
    """The building, its doors that lead out of the fence forbidden."""
    if boundary is None:
        return building
    for edge in building.doors:
        if edge.state == "unexplored" and not plan.contains(boundary, plan.beyond(edge.door, _BEYOND)):
            building = building.forbid(edge.id, "GEOFENCE")
    return building
