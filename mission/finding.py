"""What was looked at before a mission, and what was found."""

from dataclasses import dataclass


@dataclass(frozen=True)
class Finding:
    """One thing looked at: whether it is good, and what was found, with what to do about it.

    Args:
        doubtful: good enough to start with, but somebody should know.
    """

    what: str
    good: bool
    found: str
    doubtful: bool = False

    @property
    def mark(self) -> str:
        """One word for a list."""
        if not self.good:
            return "FAIL"
        return "warn" if self.doubtful else "ok"
