"""What every message has: the envelope it comes in, the kinds of what it carries, and the limits of its fields."""

from typing import Annotated, ClassVar, Generic, TypeVar

import msgspec
from msgspec import Meta

PROTOCOL = 3
MAX_MESSAGE = 2 << 20
"""Bytes of the largest frame; sockets drop a peer that sends more."""
MAX_SCAN = 4 << 30

Name = Annotated[str, Meta(max_length=256)]
Finite = Annotated[float, Meta(ge=-1e9, le=1e9)]
Fraction = Annotated[float, Meta(ge=0.0, le=1.0)]
Count = Annotated[int, Meta(ge=0, le=MAX_SCAN)]
WallClock = Annotated[float, Meta(ge=0.0, le=1e11)]
"""Seconds since 1970, UTC, by the sender's own clock: to be compared, never to be obeyed."""


class Wire(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Anything on the wire: immutable, and nothing in it that is not asked for."""


class Body(Wire, frozen=True, tag_field="type", tag=True):
    """What an envelope carries."""


class Query(Body, frozen=True):
    """Asks, changes nothing."""


class Command(Body, frozen=True):
    """Changes the world, once per request id. ``always`` marks one that is obeyed however old it is."""

    always: ClassVar[bool] = False


B = TypeVar("B")


class Request(Wire, Generic[B], frozen=True):
    """From the executive. ``request_id`` stays the same over retries."""

    version: int
    request_id: Annotated[str, Meta(min_length=1, max_length=64)]
    body: B
    boot: Name | None = None
    valid_until: float | None = None


class Reply(Wire, Generic[B], frozen=True):
    """From the agent process named ``boot``, at ``clock`` seconds of its monotonic clock."""

    version: int
    request_id: str
    body: B
    boot: Name
    clock: float
