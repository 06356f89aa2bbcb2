"""The one place where frames become messages and messages frames."""

from typing import Any, Generic, TypeVar

import msgspec

from drivers.messages import MAX_MESSAGE, PROTOCOL, Wire
from perception.failure import FailureError

M = TypeVar("M")


class _Peek(msgspec.Struct):
    """What every version of every envelope begins with."""

    version: int = 0
    request_id: str = ""


_peek = msgspec.msgpack.Decoder(_Peek)
_encode = msgspec.msgpack.Encoder().encode


class UndecodableError(ValueError):
    """A frame that is not a message of ours; ``version`` and ``request_id`` are what could be read of it."""

    def __init__(self, reason: str, version: int = 0, request_id: str = "") -> None:
        super().__init__(reason)
        self.version = version
        self.request_id = request_id

    @property
    def foreign(self) -> bool:
        """Whether it may well be a message, but of another version of the protocol."""
        return self.version not in (0, PROTOCOL)


class Codec(Generic[M]):
    """Reads messages of one type: the only place where bytes from outside become objects."""

    def __init__(self, kind: Any) -> None:
        self._decoder: msgspec.msgpack.Decoder[M] = msgspec.msgpack.Decoder(kind)

    def decode(self, frame: bytes) -> M:
        """Raises :class:`UndecodableError`, and nothing else, for whatever is not such a message."""
        version, request_id = 0, ""
        try:
            if len(frame) > MAX_MESSAGE:  # not every transport has a limit of its own
                raise ValueError(f"{len(frame)} bytes are over {MAX_MESSAGE}")
            peek = _peek.decode(frame)
            version, request_id = peek.version, peek.request_id
            if version != PROTOCOL:
                raise ValueError(f"protocol version {version} instead of {PROTOCOL}")
            return self._decoder.decode(frame)
        except (ValueError, RecursionError) as error:  # msgspec's errors and UnicodeDecodeError are ValueErrors
            raise UndecodableError(str(error), version, request_id) from error


def encode(message: Wire) -> bytes:
    """Raises ``MESSAGE_TOO_LARGE`` instead of giving a frame that the other side would hang up on."""
    frame = _encode(message)
    if len(frame) > MAX_MESSAGE:
        raise FailureError(
            "MESSAGE_TOO_LARGE", f"a message of {len(frame)} bytes is over {MAX_MESSAGE}", size=len(frame)
        )
    return frame
