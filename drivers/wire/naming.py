"""What the agents call scans and goals: they serve one mission after another, and each of those has an S01."""

import secrets

_BETWEEN = "."


def new_mission() -> str:
    """A name for a mission that no other one has."""
    return secrets.token_hex(6)


def full_name(mission: str, name: str) -> str:
    """The name of a mission's scan or goal among those of all missions; as it is where no mission is told."""
    return f"{mission}{_BETWEEN}{name}" if mission else name


def own_name(full: str) -> str:
    """What the mission itself calls the scan or goal that the agents call so."""
    return full.rpartition(_BETWEEN)[2]
