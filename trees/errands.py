"""Ways through the building that are not for the next view: drives that survive an interruption, home, the charger."""

from py_trees.behaviour import Behaviour
from py_trees.decorators import SuccessIsFailure

from behaviours.asking import Ask
from behaviours.charging import BatteryIsGood, WaitForCharge
from behaviours.conditions import FailureIs, FailureIsNot
from behaviours.driving import (
    BrokenOffByTouch,
    DriveToTarget,
    RenewGoal,
    TargetHalfWayBack,
    TargetLastScan,
    TargetNearby,
    TargetStart,
)
from behaviours.homecoming import Stranded
from behaviours.mapping import SetScanAside
from behaviours.recover import Recover
from behaviours.rooms import GiveUpRoom
from behaviours.safety import EndMission
from behaviours.settings import Settings
from trees.compose import first_that_works, if_possible, steps
from trees.locating import end_on_the_spot, located
from trees.recovery import ANOTHER_SCAN_MAY_HELP

_ATTEMPTS = 3
_INTERRUPTIONS = 5
"""A base that dies may cost two: the drive that it broke off, and the one ordered before its new process was ours."""


def drive(name: str, settings: Settings) -> Behaviour:
    """A drive to the target, from a place that is known; one that was broken off from outside is ordered anew."""
    return Recover(
        f"{name}, whatever interrupts",
        primary=first_that_works(
            f"{name}, or stop for a touch",
            steps(f"{name}, from a known place", located(settings), DriveToTarget(name)),
            leave_to_move_after_a_touch(),
        ),
        recovery=steps(
            "order it anew",
            FailureIs("broken off from outside?", "ESTOP", "AGENT_UNREACHABLE", "LEASE_", "NAV_INTERRUPTED"),
            RenewGoal("name the goal anew"),
        ),
        attempts=1 + _INTERRUPTIONS,
    )


def leave_to_move_after_a_touch() -> Behaviour:
    """Fails: after a touch the drive is an interrupted one if somebody lets it go on, else the mission ends there."""
    return steps(
        "touched",
        FailureIs("touched something?", "COLLISION"),
        first_that_works(
            "leave to move",
            Ask(
                "ask about the touch",
                "The robot touched something near {place} and has stopped",
                "Go there, look, and clear it away.",
                otherwise="end",
            ),
            end_on_the_spot(),
        ),
        BrokenOffByTouch("the drive was broken off"),
    )


def go_home(settings: Settings) -> Behaviour:
    return steps("return to the start", TargetStart("pick the start"), drive("drive to the start", settings))


def enough_charge(settings: Settings) -> Behaviour:
    """Goes on at once with charge enough; else home to the charger and back. Fails where no way leads back."""
    return first_that_works(
        "enough charge",
        BatteryIsGood("charge for the way home?"),
        steps(
            "charge",
            first_that_works("charged", charged_at_the_start(settings), end_without_charge()),
            TargetLastScan("pick the last scan's place"),
            drive("drive back to work", settings),
        ),
    )


def charged_at_the_start(settings: Settings) -> Behaviour:
    return steps(
        "charged at the start",
        Recover(
            "go to the charger",
            primary=go_home(settings),
            recovery=FailureIs("way home blocked?", "NAV_"),
            attempts=_ATTEMPTS,
        ),
        WaitForCharge("wait for the charge"),
    )


def end_without_charge() -> Behaviour:
    """Fails, for nothing is to be done any more."""
    return SuccessIsFailure(
        "out of charge",
        steps(
            "end at that",
            GiveUpRoom("leave the room at that"),
            if_possible(
                "why it is not there",
                steps("not there", FailureIsNot("at the start?", "BATTERY_LOW"), Stranded("say why not")),
            ),
            EndMission("end without charge", "finished"),
        ),
    )


def move_nearby(settings: Settings) -> Behaviour:
    """A spot where scans keep failing is left by half a metre."""
    return steps(
        "move nearby",
        FailureIs("scan still fails?", *ANOTHER_SCAN_MAY_HELP),
        TargetNearby("pick a spot nearby"),
        drive("drive nearby", settings),
    )


def bridge(settings: Settings) -> Behaviour:
    """A scan without a place waits, and one is taken half-way back, where more of the known is seen."""
    return steps(
        "bridge",
        FailureIs("registration refused?", "REG_"),
        SetScanAside("set the scan aside"),
        TargetHalfWayBack("pick the half-way spot"),
        drive("drive half-way back", settings),
    )
