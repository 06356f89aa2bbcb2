"""Who may ask what of an agent: one table, and the gate that looks it up for every message."""

from collections.abc import Callable, Mapping
from enum import StrEnum

from drivers import messages
from perception.failure import Failure


class Role(StrEnum):
    """What somebody is let in for."""

    OBSERVER = "observer"
    """Looks on: identities, progress, telemetry."""
    OPERATOR = "operator"
    """Looks on, reads scans, and may bring things to a stop."""
    EXECUTIVE = "executive"
    """Runs missions."""


_ALL = frozenset(Role)
_HANDS = frozenset({Role.OPERATOR, Role.EXECUTIVE})
_MISSION = frozenset({Role.EXECUTIVE})

PERMITTED: Mapping[type[messages.Body], frozenset[Role]] = {
    messages.Identify: _ALL,
    messages.SelfTest: _ALL,
    messages.ScanStatus: _ALL,
    messages.DriveStatus: _ALL,
    messages.Open: _HANDS,
    messages.Read: _HANDS,
    messages.Stop: _HANDS,
    messages.Abort: _HANDS,
    messages.Take: _MISSION,
    messages.Release: _MISSION,
    messages.AcquireLease: _MISSION,
    messages.ReleaseLease: _MISSION,
    messages.Beat: _MISSION,
    messages.Drive: _MISSION,
}
"""The roles that may ask for each operation. What does not stand here nobody may."""


class Gate:
    """Decides from the key that the sender of a message has proved to hold.

    Args:
        role_of: the role of a key, None for a stranger; asked for every message, so that a key that was revoked is
            refused from its next message on.
    """

    def __init__(self, role_of: Callable[[str], Role | None]) -> None:
        self._role_of = role_of

    def refusal(self, key: str | None, operation: type[messages.Body]) -> Failure | None:
        """Why this operation is refused to the key; None when it is permitted."""
        role = None if key is None else self._role_of(key)
        if role is not None and role in PERMITTED.get(operation, ()):
            return None
        who = "a stranger" if role is None else f"an {role}"
        return Failure("NOT_ALLOWED", f"{who} may not {operation.__name__}", {"operation": operation.__name__})
