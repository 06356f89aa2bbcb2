"""What is said to, and by, any agent."""

import math
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta

from drivers.messages.envelope import Body, Finite, Fraction, Name, Query, Wire
from drivers.poses import TOLERANCE, rigid
from perception import transforms
from perception.failure import Failure, FailureError
from perception.transforms import Matrix


class Pose(Wire, frozen=True):
    """A rigid transform: translation in metres and unit quaternion x, y, z, w (REP-103)."""

    translation: tuple[Finite, Finite, Finite]
    rotation: tuple[Finite, Finite, Finite, Finite]

    def __post_init__(self) -> None:
        norm = math.hypot(*self.rotation)
        if abs(norm - 1.0) > TOLERANCE:
            raise ValueError(f"the norm of a rotation must be 1, not {norm:g}")

    @classmethod
    def of(cls, matrix: Matrix) -> "Pose":
        """Raises ``BAD_TRANSFORM`` unless the matrix is a rigid transform."""
        try:
            x, y, z = (float(value) for value in rigid(matrix)[:3, 3])
        except ValueError as error:
            raise FailureError("BAD_TRANSFORM", str(error)) from error
        return cls((x, y, z), transforms.to_quaternion(matrix))

    def matrix(self) -> Matrix:
        return transforms.from_quaternion(self.rotation, self.translation)


class Identify(Query, frozen=True):
    """Who answers? ``ScannerIdentity`` or ``BaseIdentity``."""


class Ok(Body, frozen=True):
    """Done as asked."""


class Pending(Body, frozen=True):
    """Under way."""

    fraction: Fraction | None = None
    note: Name = ""


class Unknown(Body, frozen=True):
    """Never heard of it; an agent that restarted says so of what it was doing."""


class Stale(Body, frozen=True):
    """A command was refused: another boot is meant, or it came too late. Its sender may stamp it anew."""


class Problem(Body, frozen=True):
    """A :class:`~perception.failure.Failure` on the wire."""

    code: Name
    message: Annotated[str, Meta(max_length=4096)]
    evidence: dict[str, Any] = msgspec.field(default_factory=dict)

    @classmethod
    def of(cls, failure: Failure) -> "Problem":
        evidence = msgspec.to_builtins(dict(failure.evidence), enc_hook=_plain, str_keys=True)
        return cls(failure.code[:256], failure.message[:4096], evidence)

    def error(self) -> FailureError:
        error = FailureError(self.code, self.message)
        # Set whole: evidence may have keys that the constructor takes for its own arguments.
        error.failure = Failure(self.code, self.message, self.evidence)
        return error


def _plain(value: Any) -> Any:
    return value.tolist() if isinstance(value, np.ndarray | np.generic) else str(value)
