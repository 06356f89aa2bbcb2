"""What was looked at before a mission, and what was found."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """One thing looked at: whether it is good, and what was found, with what to do about it."""

    what: str
    good: bool
    found: str
