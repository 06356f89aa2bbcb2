"""Outcomes of jobs as JSON and back: the known value types and nothing else, so that reading one runs no code of it."""

import base64
from collections.abc import Iterable
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np

from drivers import interfaces
from mission import summaries
from perception import failure, findings

_KINDS: dict[str, type] = {
    kind.__name__: kind
    for module in (failure, findings, interfaces, summaries)
    for kind in vars(module).values()
    if isinstance(kind, type) and is_dataclass(kind)
}
"""Every frozen dataclass that a driver or a stage may return, by its name."""

_TYPE, _ARRAY, _TUPLE, _PATH = "$type", "$array", "$tuple", "$path"


class UnknownValueError(TypeError):
    """A value of a type that has no place in the ledger, or JSON that is no value."""


def to_json(value: Any) -> Any:
    """Plain JSON values for ``value``; floats and arrays keep every bit.

    Raises:
        UnknownValueError: for a type that :func:`from_json` could not bring back.
    """
    if value is None or isinstance(value, str | bool | int | float):
        return value
    if isinstance(value, np.generic):
        return value.item()
    if isinstance(value, np.ndarray):
        data = base64.b64encode(np.ascontiguousarray(value).tobytes()).decode("ascii")
        return {_ARRAY: [value.dtype.str, list(value.shape), data]}
    if isinstance(value, Path):
        return {_PATH: str(value)}
    if isinstance(value, tuple):
        return {_TUPLE: [to_json(item) for item in value]}
    if isinstance(value, list):
        return [to_json(item) for item in value]
    if isinstance(value, dict) or hasattr(value, "items"):
        return {_key(key): to_json(item) for key, item in value.items()}
    kind: type = type(value)
    if _KINDS.get(kind.__name__) is kind:
        return {_TYPE: kind.__name__} | {field.name: to_json(getattr(value, field.name)) for field in fields(kind)}
    raise UnknownValueError(f"a {kind.__name__} has no place in the ledger")


def from_json(data: Any) -> Any:
    """The value that :func:`to_json` was given.

    Raises:
        UnknownValueError: for what is no such JSON.
    """
    if isinstance(data, list):
        return [from_json(item) for item in data]
    if not isinstance(data, dict):
        return data
    try:
        if _ARRAY in data:
            kind, shape, text = data[_ARRAY]
            return _array(kind, shape, text)
        if _TUPLE in data:
            return tuple(from_json(item) for item in data[_TUPLE])
        if _PATH in data:
            return Path(data[_PATH])
        values = {key: from_json(item) for key, item in data.items() if key != _TYPE}
        return _KINDS[data[_TYPE]](**values) if _TYPE in data else values
    except (KeyError, TypeError, ValueError) as error:
        raise UnknownValueError(f"no value of this mission: {error!r}") from error


def _array(kind: str, shape: Iterable[int], text: str) -> np.ndarray:
    dtype = np.dtype(kind)
    if dtype.hasobject:
        raise ValueError("an array of objects")
    return np.frombuffer(base64.b64decode(text, validate=True), dtype).reshape(tuple(shape)).copy()


def _key(key: Any) -> str:
    if not isinstance(key, str) or key.startswith("$"):
        raise UnknownValueError(f"a key must be a plain string, not {key!r}")
    return key
