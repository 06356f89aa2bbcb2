"""A well-formed example of every message, made from its declaration, so that no message is without one."""

from types import UnionType
from typing import Annotated, Any, get_args

import msgspec
from msgspec import inspect

from drivers import messages
from drivers.messages import PROTOCOL, Body, Reply, Request, Telemetry
from drivers.wire.codec import encode

REQUESTS: dict[str, UnionType] = {
    "scanner": messages.ScannerRequest,
    "bulk": messages.BulkRequest,
    "base": messages.BaseRequest,
}
"""The registry: what each endpoint understands."""

_TEXTS = ("S01", "0" * 64, "", "x")


def operations() -> list[type[Body]]:
    """Whatever may be asked of an agent."""
    return sorted({body for union in REQUESTS.values() for body in get_args(union)}, key=lambda body: body.__name__)


def sample(kind: Any) -> Any:
    """An instance of a message type."""
    if kind is messages.Manifest:  # its fields must agree with each other
        return messages.Manifest(10, "0" * 64, 10, [bytes(32)])
    return msgspec.convert(_plain(inspect.type_info(kind)), kind)


def frames() -> list[bytes]:
    """One frame of each request, of each reply, and of the telemetry."""
    requests = [Request(PROTOCOL, "r", sample(body), "boot", 1.0) for body in operations()]
    replies = [Reply(PROTOCOL, "r", sample(body), "boot", 1.0) for body in get_args(messages.AnyReply)]
    telemetry = msgspec.structs.replace(sample(Telemetry), version=PROTOCOL)
    return [encode(message) for message in (*requests, *replies, telemetry)]


def _plain(info: Any) -> Any:
    match info:
        case inspect.StructType(cls=messages.Pose):
            return {"translation": [1.0, 2.0, 3.0], "rotation": [0.0, 0.0, 0.0, 1.0]}
        case inspect.StructType():
            tag = {info.tag_field: info.tag} if info.tag_field else {}
            return tag | {field.encode_name: _plain(field.type) for field in info.fields}
        case inspect.UnionType():
            return _plain(info.types[0])
        case inspect.StrType():
            return next(text for text in _TEXTS if _fits(text, info))
        case inspect.IntType() | inspect.FloatType():
            return info.ge or (info.gt + 0.5 if info.gt is not None else 0)
        case inspect.BytesType():
            return bytes(info.min_length or 0)
        case inspect.BoolType():
            return False
        case inspect.NoneType():
            return None
        case inspect.TupleType():
            return [_plain(item) for item in info.item_types]
        case inspect.ListType():
            return [_plain(info.item_type)]
        case inspect.DictType():
            return {}
    raise TypeError(f"no sample of {info}")


def _fits(text: str, info: inspect.StrType) -> bool:
    meta = msgspec.Meta(pattern=info.pattern, min_length=info.min_length, max_length=info.max_length)
    try:
        msgspec.convert(text, Annotated[str, meta])
    except msgspec.ValidationError:
        return False
    return True
