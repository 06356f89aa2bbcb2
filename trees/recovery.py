"""Recovery branches, each bounded and each chosen by the code of the failure it can help with."""

from py_trees.behaviour import Behaviour

from behaviours.conditions import FailureIs, FailureIsNot
from behaviours.recover import Recover
from behaviours.rooms import DeferDoor
from behaviours.viewing import AvoidView
from behaviours.waiting import LetTheWatchLook
from trees.compose import steps

ANOTHER_SCAN_MAY_HELP = ("SCAN_", "ALIGN_", "XFER_BROKEN")
HELP_WITH = (
    "REG_", "SCAN_", "ALIGN_", "XFER_", "NAV_", "AGENT_", "PERC_", "DISK_FULL", "IO_ERROR", "SPOOL_FAILED",
    "DEVICE_FORGOT", "DRIVER_EXCEPTION", "RESULT_NOT_FINITE", "ESTOP", "LEAF_EXCEPTION",
    "RUN_LOSSY",
)  # fmt: skip
"""Codes of what a person at the robot may be able to put right."""
_ATTEMPTS = 3


def fetched(fetch: Behaviour) -> Behaviour:
    """The scanner keeps a scan until it has come home: whatever cut the transfer, the same one is fetched again."""
    return _again_after(fetch, "not come home?", "XFER_", "DISK_FULL", "AGENT_UNREACHABLE")


def written(stage: Behaviour) -> Behaviour:
    """A stage whose file the disk did not take is done again, when the watch has seen to it that there is room."""
    return _again_after(stage, "not written?", "DISK_FULL", "IO_ERROR")


def _again_after(work: Behaviour, question: str, *codes: str) -> Behaviour:
    return Recover(
        f"{work.name}, in the end",
        primary=work,
        recovery=steps(f"{work.name} again", FailureIs(question, *codes), LetTheWatchLook("let the watch look")),
        attempts=_ATTEMPTS,
    )


def again_if_the_scan_failed() -> Behaviour:
    """A scan that failed by itself may be taken again from the same spot."""
    return FailureIs("scan failed?", *ANOTHER_SCAN_MAY_HELP)


def next_best_instead() -> Behaviour:
    """A view that cannot be reached gives way to the next best one."""
    return steps("next best instead", FailureIs("way blocked?", "NAV_"), AvoidView("avoid this view"))


def another_door() -> Behaviour:
    """A door that was not reached, whatever the reason, is left for later."""
    return steps(
        "another door",
        FailureIsNot("a door left?", "NO_DOOR_LEFT", "MAX_ROOMS"),
        DeferDoor("leave this door for later"),
    )
