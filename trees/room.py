"""One room: cycles until λ and μ say that enough was seen, then its doors."""

from py_trees.behaviour import Behaviour

from behaviours.adjusting import MAPS_BEAR_M, OptimisePoses
from behaviours.asking import Ask
from behaviours.conditions import FailureIs, LoopIsClosed, RoomIsEnded, RoomIsOpen
from behaviours.recover import Recover
from behaviours.rooms import BeginRoom, ChooseSuspect, FindDoors, GiveUpRoom
from behaviours.settings import Settings
from trees import recovery
from trees.compose import first_that_works, if_possible, steps, until_failure
from trees.cycle import cycle, observation
from trees.errands import drive


def room(settings: Settings) -> Behaviour:
    return steps(
        "room",
        BeginRoom("begin the room"),
        first_that_works("scan the room", persistent_cycles(settings), GiveUpRoom("give the room up")),
        first_that_works("look for doors", find_doors(settings), GiveUpRoom("its doors are not known")),
        if_possible("loop", close_loop()),
    )


def persistent_cycles(settings: Settings) -> Behaviour:
    """As :func:`cycles`; before a room is given up the operator may put right what is in the way."""
    return Recover(
        "cycles or help",
        primary=cycles(settings),
        recovery=steps(
            "ask for help",
            FailureIs("can a person help?", *recovery.HELP_WITH),
            Ask("ask about the room", "Room {room} cannot be finished", "Put right what you can, at the robot too."),
        ),
        attempts=settings.operator.rounds,
    )


def cycles(settings: Settings) -> Behaviour:
    """Cycle after cycle while the room is open; a cycle that fails for good leaves it open."""
    return steps(
        "cycles",
        until_failure("while open", steps("cycle of an open room", cycle(settings), RoomIsOpen("more to see?"))),
        # The loop also ends when a cycle fails; then the room is still open and given up above.
        RoomIsEnded("all seen?"),
    )


def close_loop() -> Behaviour:
    """Where a door leads back to known rooms, the poses on the way round must meet."""
    return steps(
        "close the loop", LoopIsClosed("loop closed?"), recovery.written(OptimisePoses("adjust the poses", MAPS_BEAR_M))
    )


def find_doors(settings: Settings) -> Behaviour:
    """The room's doors; an opening that no scan saw well enough is looked at from nearby, once."""
    closer_look = steps(
        "closer look",
        drive("drive before the opening", settings),
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
