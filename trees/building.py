"""The whole mission: senses, safety, and room after room until no door is left."""

from py_trees.behaviour import Behaviour

from behaviours.driving import DriveToTarget, TargetStart
from behaviours.recover import Recover
from behaviours.rooms import ChooseDoor
from behaviours.safety import EndMission, SenseBase
from behaviours.settings import Settings
from trees import recovery
from trees.compose import at_every_tick, if_possible, most_important, steps, until_failure
from trees.room import room
from trees.safety import safety


def create_root(settings: Settings | None = None) -> Behaviour:
    """The mission's tree. It needs no robot to be made or drawn; ``setup(services=...)`` hands it one."""
    settings = settings or Settings()
    return at_every_tick(
        "mission",
        SenseBase("sense the base"),
        most_important("what matters most", safety(), building(settings)),
    )


def building(settings: Settings) -> Behaviour:
    """Rooms in the order of the paper: one is finished, then the robot goes under the door to the next."""
    home = [if_possible("home", go_home())] if settings.building.return_to_start else []
    return steps(
        "building",
        until_failure("every room", steps("room and door", room(settings), next_door(settings))),
        *home,
        EndMission("end the mission", "finished"),
    )


def next_door(settings: Settings) -> Behaviour:
    """The robot stands under an unexplored open door; fails when none is left that can be passed."""
    return Recover(
        "next door",
        primary=steps("go under a door", ChooseDoor("choose a door"), DriveToTarget("drive under the door")),
        recovery=recovery.another_door(),
        attempts=2 * settings.building.max_rooms,
    )


def go_home() -> Behaviour:
    return steps("return to the start", TargetStart("pick the start"), DriveToTarget("drive to the start"))
