"""The one typed error that every floor speaks: a code to act on, words for the operator, figures as evidence."""

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Failure:
    """Why something did not succeed.

    Args:
        code: stable upper-case name such as ``REG_DEGENERATE``; recoveries are chosen by it.
        message: one plain sentence with numbers and units.
        evidence: the figures behind the message, JSON-ready.
    """

    code: str
    message: str
    evidence: Mapping[str, object] = field(default_factory=dict)

    def __str__(self) -> str:
        return f"{self.code}: {self.message}"


class FailureError(Exception):
    """Raised where a stage or a driver cannot deliver; carries the :class:`Failure`."""

    def __init__(self, code: str, message: str, **evidence: object) -> None:
        super().__init__(code, message, evidence)
        self.failure = Failure(code, message, evidence)

    def __str__(self) -> str:
        return str(self.failure)

    def __reduce__(self) -> tuple[object, ...]:
        # Exceptions with keyword-only state lose it when a worker process pickles them.
        return (_rebuild, (self.failure.code, self.failure.message, dict(self.failure.evidence)))


def _rebuild(code: str, message: str, evidence: dict[str, object]) -> FailureError:
    return FailureError(code, message, **evidence)
