"""Ways through the building that are not for the next view: drives that survive an interruption, home, the charger."""

from py_trees.behaviour import Behaviour

from behaviours.charging import BatteryIsGood, WaitForCharge
from behaviours.conditions import FailureIs
from behaviours.driving import DriveToTarget, RenewGoal, TargetLastScan, TargetStart
from behaviours.recover import Recover
from behaviours.rooms import GiveUpRoom
from behaviours.safety import EndMission
from trees.compose import first_that_works, steps

_ATTEMPTS = 3


def drive(name: str) -> Behaviour:
    """A drive to the target; one that the emergency stop or a lost link broke off is ordered anew."""
    return Recover(
        f"{name}, whatever interrupts",
        primary=DriveToTarget(name),
        recovery=steps(
            "order it anew",
            FailureIs("broken off from outside?", "ESTOP", "AGENT_UNREACHABLE", "LEASE_"),
            RenewGoal("name the goal anew"),
        ),
        attempts=_ATTEMPTS,
    )


def go_home() -> Behaviour:
    return steps("return to the start", TargetStart("pick the start"), drive("drive to the start"))


def enough_charge() -> Behaviour:
    """Goes on at once with charge enough; else home to the charger and back, and where that fails the mission ends."""
    return first_that_works(
        "enough charge",
        BatteryIsGood("charge for the way home?"),
        steps(
            "charge",
            Recover(
                "go to the charger",
                primary=go_home(),
                recovery=FailureIs("way home blocked?", "NAV_"),
                attempts=_ATTEMPTS,
            ),
            WaitForCharge("wait for the charge"),
            TargetLastScan("pick the last scan's place"),
            drive("drive back to work"),
        ),
        steps("out of charge", GiveUpRoom("leave the room at that"), EndMission("end without charge", "finished")),
    )
