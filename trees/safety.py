"""What stands above the work at every tick: the robot's health and the operator's word."""

from py_trees.behaviour import Behaviour

from behaviours.conditions import Condition
from behaviours.safety import AbortOrdered, BaseIsLost, EmergencyStopped, EndMission
from trees.compose import most_important, steps


def safety() -> Behaviour:
    """Fails, and so lets the work go on, while there is nothing to stop for."""
    return most_important(
        "safety",
        _ends_it("emergency stop", EmergencyStopped("hardware stop pressed?"), "safety_stop"),
        _ends_it("base lost", BaseIsLost("base silent?"), "safety_stop"),
        _ends_it("abort", AbortOrdered("abort ordered?"), "aborted"),
    )


def _ends_it(name: str, condition: Condition, outcome: str) -> Behaviour:
    return steps(name, condition, EndMission(f"end the mission: {outcome}", outcome))
