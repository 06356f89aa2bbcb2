"""Every blackboard key, in one place. The blackboard carries ids, poses and figures, never a cloud."""

from enum import StrEnum


class Key(StrEnum):
    """Names on the blackboard, with the type that stands there."""

    BASE = "base"
    """:class:`drivers.interfaces.BaseState` | None, newest telemetry, written every tick."""
    COMMAND = "command"
    """str, what the operator wants: ``run`` or ``abort``."""
    FAILURE = "failure"
    """:class:`perception.failure.Failure` | None, the newest one; recoveries are chosen by its code."""
    OUTCOME = "outcome"
    """str | None, how the mission ended; None while it runs."""
    SURVEY = "survey"
    """:class:`behaviours.survey.Survey`, all that is known of the building so far."""
    SCAN = "scan"
    """:class:`behaviours.survey.CurrentScan` | None, the scan of this cycle on its way to a pose."""
    ROOM = "room"
    """str, id of the room being scanned."""
    COUNTS = "counts"
    """:class:`perception.findings.LabelCounts` | None, the room's voxels by label after this cycle's scan."""
    DOOR = "door"
    """str | None, id of the door being passed."""
    TARGET = "target"
    """:class:`behaviours.survey.Target` | None, where the base is to go next."""
    VIEW = "view"
    """:class:`perception.findings.ViewChoice` | None, the newest choice of views."""
    AVOID = "avoid"
    """tuple of :class:`behaviours.survey.Avoided`, views given up for a while."""
