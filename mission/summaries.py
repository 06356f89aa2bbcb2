"""Small values that stages return and that are no finding of the paper; light enough for the process that ticks."""

from dataclasses import dataclass

from perception.transforms import Matrix


@dataclass(frozen=True)
class ScanSummary:
    """What the tree needs to know of a valid scan."""

    points: int
    dropped: int
    return_share: float
    median_range: float
    base_from_scanner: Matrix


@dataclass(frozen=True)
class MapSummary:
    """The robot map after a scan: its name, and how much of it is free and obstacle, square metres."""

    map_id: str
    free_m2: float
    obstacle_m2: float
