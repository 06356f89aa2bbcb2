"""Whether a result can be believed as far as its numbers go; whoever made it, nothing else here looks at it again."""

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass

import numpy as np


def unsound(value: object) -> str:
    """The name of the first pose, outline or track in a result that holds what is no number; empty where all is well.

    A single figure may be no number, which says that it is not known.
    """
    if is_dataclass(value) and not isinstance(value, type):
        parts = ((field.name, getattr(value, field.name)) for field in fields(value))
        return next((name for name, part in parts if not _is_finite(part) or unsound(part)), "")
    return "" if _is_finite(value) else type(value).__name__


def _is_finite(value: object) -> bool:
    if isinstance(value, np.ndarray):
        return value.dtype.kind != "f" or bool(np.isfinite(value).all())
    if isinstance(value, Mapping):
        return all(_is_finite(part) for part in value.values())
    if isinstance(value, tuple | list):
        return all(math.isfinite(part) if isinstance(part, float) else _is_finite(part) for part in value)
    return True
