"""Knowing where the base stands before it moves, after a break in its odometry too."""

from py_trees.behaviour import Behaviour
from py_trees.decorators import SuccessIsFailure

from behaviours.asking import Ask
from behaviours.conditions import FailureIs, PlaceIsKnown, RoomIsOpen
from behaviours.homecoming import Stranded
from behaviours.mapping import RegisterGlobally
from behaviours.recover import Recover
from behaviours.rooms import GiveUpRoom, RefuseDoors
from behaviours.safety import EndMission
from behaviours.settings import Settings
from trees.compose import first_that_works, if_possible, steps
from trees.recovery import HELP_WITH
from trees.scanning import scan_here


def located(settings: Settings) -> Behaviour:
    """Succeeds at once while odometry leads on from the last scan; else a scan tells where the base stands.

    Where that fails and nobody helps, nothing may move any more: the mission ends on the spot, and this fails.
    """
    return first_that_works("place", PlaceIsKnown("odometry unbroken?"), find_place(settings), end_on_the_spot())


def find_place(settings: Settings) -> Behaviour:
    return Recover(
        "find the place",
        primary=steps("look around", scan_here(settings), RegisterGlobally("find the place by features")),
        recovery=steps(
            "ask for a place",
            FailureIs("can a person help?", *HELP_WITH),
            Ask(
                "ask where it stands",
                "The robot has lost its place; it was near {place}",
                "Push it back there, or to where an earlier scan was taken.",
                otherwise="end",
            ),
        ),
        attempts=settings.operator.rounds,
    )


def end_on_the_spot() -> Behaviour:
    room_stays_partial = steps("leave the room", RoomIsOpen("room open?"), GiveUpRoom("the place is not known"))
    return SuccessIsFailure(
        "nowhere to go",
        steps(
            "end here",
            if_possible("its room", room_stays_partial),
            RefuseDoors("no door can be reached"),
            Stranded("say why it stays there"),
            EndMission("end on the spot", "finished"),
        ),
    )
