"""A scan from where the base stands, without moving it."""

from py_trees.behaviour import Behaviour

from behaviours.recover import Recover
from behaviours.scanning import AlignScan, FetchScan, StandStill, TakeScan, ValidateScan
from behaviours.settings import Settings
from trees.compose import steps
from trees.recovery import again_if_the_scan_failed, fetched


def scan_here(settings: Settings) -> Behaviour:
    """A usable scan, tried again on the spot."""
    return Recover(
        "scan here",
        primary=steps(
            "take a scan",
            StandStill("stand still"),
            TakeScan("take the scan"),
            fetched(FetchScan("fetch the scan")),
            ValidateScan("validate the scan"),
            AlignScan("align with the floor"),
        ),
        recovery=again_if_the_scan_failed(),
        attempts=settings.scanning.attempts,
    )
