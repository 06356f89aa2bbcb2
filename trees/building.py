"""The whole mission: senses, safety, and room after room until no door is left."""

import math

from py_trees.behaviour import Behaviour

from behaviours.adjusting import OptimisePoses
from behaviours.asking import Ask
from behaviours.conditions import MapFrameIsMade
from behaviours.freeze import Freeze
from behaviours.homecoming import Stranded
from behaviours.recover import Recover
from behaviours.rooms import ChooseDoor, DoorsWereRefused, TryDoorsAgain
from behaviours.safety import EndMission, SenseBase
from behaviours.settings import Settings
from trees import recovery
from trees.compose import at_every_tick, first_that_works, if_possible, most_important, steps, until_failure
from trees.errands import drive, go_home
from trees.room import room
from trees.safety import abort, watch


def create_root(settings: Settings | None = None) -> Behaviour:
    """The mission's tree. It needs no robot to be made or drawn; ``setup(services=...)`` hands it one.

    An abort stops the work; whatever the watch waits for only freezes it.
    """
    settings = settings or Settings()
    return at_every_tick(
        "mission",
        SenseBase("sense the base"),
        most_important("what matters most", abort(), Freeze("under watch", watch(), building(settings))),
    )


def building(settings: Settings) -> Behaviour:
    """Rooms in the order of the paper: one is finished, then the robot goes under the door to the next."""
    home = [homewards(settings)] if settings.building.return_to_start else []
    return steps(
        "building",
        until_failure("every room", steps("room and door", room(settings), next_door(settings))),
        *home,
        if_possible("last word on the poses", last_word()),
        EndMission("end the mission", "finished"),
    )


def homewards(settings: Settings) -> Behaviour:
    return first_that_works("home", go_home(settings), Stranded("say why not"))


def last_word() -> Behaviour:
    """All poses once more when nobody drives by the maps any longer, and every scan's residual for the report."""
    everything = recovery.written(OptimisePoses("adjust all poses", most_m=math.inf))
    return steps("all poses", MapFrameIsMade("anything registered?"), everything)


def next_door(settings: Settings) -> Behaviour:
    """As :func:`reachable_door`; before the mission ends with closed doors the operator may open them."""
    return Recover(
        "next door",
        primary=reachable_door(settings),
        recovery=steps(
            "ask for open doors",
            DoorsWereRefused("doors left that could not be passed?"),
            Ask("ask about the doors", "No door is left but those that could not be passed", "Open them if you can."),
            TryDoorsAgain("try the doors again"),
        ),
        attempts=settings.operator.rounds,
    )


def reachable_door(settings: Settings) -> Behaviour:
    """The robot stands under an unexplored open door; fails when none is left that can be passed."""
    return Recover(
        "reachable door",
        primary=steps("go under a door", ChooseDoor("choose a door"), drive("drive under the door", settings)),
        recovery=recovery.another_door(),
        attempts=2 * settings.building.max_rooms,
    )
