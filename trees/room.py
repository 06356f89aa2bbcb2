"""One room: cycles until λ and μ say that enough was seen, then its doors."""

from py_trees.behaviour import Behaviour

from behaviours.conditions import RoomIsEnded, RoomIsOpen
from behaviours.driving import DriveToTarget
from behaviours.rooms import BeginRoom, ChooseSuspect, FindDoors, GiveUpRoom
from behaviours.settings import Settings
from trees.compose import first_that_works, if_possible, steps, until_failure
from trees.cycle import cycle, observation


def room(settings: Settings) -> Behaviour:
    return steps(
        "room",
        BeginRoom("begin the room"),
        first_that_works("scan the room", cycles(settings), GiveUpRoom("give the room up")),
        first_that_works("look for doors", find_doors(settings), GiveUpRoom("its doors are not known")),
    )


def cycles(settings: Settings) -> Behaviour:
    """Cycle after cycle while the room is open; a cycle that fails for good leaves it open."""
    return steps(
        "cycles",
        until_failure("while open", steps("cycle of an open room", cycle(settings), RoomIsOpen("more to see?"))),
        # The loop also ends when a cycle fails; then the room is still open and given up above.
        RoomIsEnded("all seen?"),
    )


def find_doors(settings: Settings) -> Behaviour:
    """The room's doors; an opening that no scan saw well enough is looked at from nearby, once."""
    closer_look = steps(
        "closer look",
        DriveToTarget("drive before the opening"),
        observation(settings),
        FindDoors("find open doors again"),
    )
    return steps(
        "doors",
        FindDoors("find open doors"),
        until_failure(
            "look closer",
            steps("opening", ChooseSuspect("an opening in doubt?"), if_possible("if it can be reached", closer_look)),
        ),
    )
