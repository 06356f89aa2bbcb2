"""What stands above the work at every tick: the operator's word and the robot's health."""

from py_trees.behaviour import Behaviour

from behaviours.safety import (
    AbortOrdered,
    EndMission,
    Hold,
    HoldForBattery,
    HoldForDisk,
    HoldForEmergencyStop,
    HoldForFence,
    HoldForLease,
    HoldForLostBase,
    HoldForRogueBase,
    Paused,
)
from trees.compose import most_important, steps


def abort() -> Behaviour:
    """Fails, and so lets all else go on, until the operator wants the end."""
    return steps("abort", AbortOrdered("abort ordered?"), EndMission("end the mission: aborted", "aborted"))


def watch() -> Behaviour:
    """Fails while there is nothing to stand still for; runs while there is; ends the mission where that lasts."""
    return most_important(
        "watch",
        _held("emergency stop", HoldForEmergencyStop("hold while stopped")),
        _held("base lost", HoldForLostBase("hold while the base is lost")),
        _held("base not ours", HoldForLease("hold without the lease")),
        _held("base moves by itself", HoldForRogueBase("hold while it moves")),
        _held("out of the fence", HoldForFence("hold outside the fence")),
        _held("disk full", HoldForDisk("hold for room on the disk")),
        _held("battery critical", HoldForBattery("hold for charge")),
        Paused("pause ordered?"),
    )


def _held(name: str, hold: Hold) -> Behaviour:
    return steps(name, hold, EndMission(f"end the mission: {name}", "safety_stop"))
