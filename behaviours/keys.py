"""Every blackboard key, in one place. The blackboard carries ids, poses and figures, never a cloud."""

from enum import StrEnum
from functools import cache

from py_trees.blackboard import Client
from py_trees.common import Access


class Key(StrEnum):
    """Names on the blackboard, with the type that stands there."""

    BASE = "base"
    """:class:`drivers.interfaces.BaseState` | None, newest telemetry, written every tick."""
    COMMAND = "command"
    """str, what the operator wants: ``run``, ``pause`` or ``abort``."""
    FAILURE = "failure"
    """:class:`perception.failure.Failure` | None, the newest one; recoveries are chosen by its code."""
    HOLD = "hold"
    """:class:`perception.failure.Failure` | None, what the robot stands still for; the work is frozen meanwhile."""
    QUESTION = "question"
    """str | None, what the operator is being asked."""
    OUTCOME = "outcome"
    """str | None, how the mission ended; None while it runs."""
    SURVEY = "survey"
    """:class:`behaviours.survey.Survey`, all that is known of the building so far."""
    SCAN = "scan"
    """:class:`behaviours.survey.CurrentScan` | None, the scan of this cycle on its way to a pose."""
    ROOM = "room"
    """str, id of the room being scanned."""
    COUNTS = "counts"
    """:class:`behaviours.survey.Labelled` | None, the room's voxels by label after this cycle's scan."""
    DOOR = "door"
    """str | None, id of the door being passed."""
    TARGET = "target"
    """:class:`behaviours.survey.Target` | None, where the base is to go next."""
    VIEW = "view"
    """:class:`perception.findings.ViewChoice` | None, the newest choice of views."""
    AVOID = "avoid"
    """tuple of :class:`behaviours.survey.Avoided`, views given up for a while."""


@cache
def access_to(who: str, reads: tuple[Key, ...] = (), writes: tuple[Key, ...] = ()) -> Client:
    """The blackboard as all nodes of a class may use it; each may write what failed.

    One client for all of them: what is declared is the class's, and clients are most of what a tree costs to make.
    """
    client = Client(name=who)
    for key in reads:
        client.register_key(key, Access.READ)
    for key in (*writes, Key.FAILURE):
        client.register_key(key, Access.WRITE)
    return client
