"""Recovery branches, each bounded and each chosen by the code of the failure it can help with."""

from py_trees.behaviour import Behaviour

from behaviours.conditions import FailureIs
from behaviours.driving import TargetHalfWayBack, TargetNearby
from behaviours.mapping import SetScanAside
from behaviours.rooms import DeferDoor
from behaviours.viewing import AvoidView
from trees.compose import steps
from trees.errands import drive


def again_if_the_scan_failed() -> Behaviour:
    """A scan that failed by itself may be taken again from the same spot."""
    return FailureIs("scan failed?", "SCAN_", "ALIGN_", "XFER_", "TIMEOUT")


def move_nearby() -> Behaviour:
    """A spot where scans keep failing is left by half a metre."""
    return steps(
        "move nearby",
        FailureIs("scan still fails?", "SCAN_", "ALIGN_", "XFER_", "TIMEOUT"),
        TargetNearby("pick a spot nearby"),
        drive("drive nearby"),
    )


def bridge() -> Behaviour:
    """A scan without a place waits, and one is taken half-way back, where more of the known is seen."""
    return steps(
        "bridge",
        FailureIs("registration refused?", "REG_"),
        SetScanAside("set the scan aside"),
        TargetHalfWayBack("pick the half-way spot"),
        drive("drive half-way back"),
    )


def next_best_instead() -> Behaviour:
    """A view that cannot be reached gives way to the next best one."""
    return steps("next best instead", FailureIs("way blocked?", "NAV_"), AvoidView("avoid this view"))


def another_door() -> Behaviour:
    """A door that cannot be passed is left for later."""
    return steps("another door", FailureIs("door blocked?", "NAV_"), DeferDoor("leave this door for later"))
