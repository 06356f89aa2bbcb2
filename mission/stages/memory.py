"""A memory that forgets: values by key, the most recently used ones, within so many bytes."""

from collections import OrderedDict
from collections.abc import Callable, Hashable
from dataclasses import fields, is_dataclass
from typing import Any, Generic, TypeVar

import numpy as np

T = TypeVar("T")


class Memory(Generic[T]):
    """Keeps what was asked for last and makes the rest again; the newest value stays however large it is.

    Args:
        limit: bytes of the arrays in all values together.
    """

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._values: OrderedDict[Hashable, tuple[T, int]] = OrderedDict()
        self.bytes = 0

    def get(self, key: Hashable, make: Callable[[], T]) -> T:
        """The value of a key, made if it is not there. What ``make`` raises is passed on, and nothing is kept."""
        if key not in self._values:
            value = make()
            self._values[key] = (value, bytes_of(value))
            self.bytes += self._values[key][1]
        self._values.move_to_end(key)
        while self.bytes > self._limit and len(self._values) > 1:
            self.bytes -= self._values.popitem(last=False)[1][1]
        return self._values[key][0]

    def __len__(self) -> int:
        return len(self._values)


def bytes_of(value: Any) -> int:
    """Bytes of all arrays in an array or a dataclass of them."""
    if isinstance(value, np.ndarray):
        return int(value.nbytes)
    if is_dataclass(value):
        return sum(bytes_of(getattr(value, field.name)) for field in fields(value))
    return 0
