"""What pydantic found wrong, in the project's words: the key, what was expected there, and what was found."""

import reprlib
from collections.abc import Mapping
from typing import Any

_shown = reprlib.Repr()
_shown.maxstring = _shown.maxother = 200
_shown.maxlevel = 2

_EXPECTED = {
    "missing": "a value",
    "string_type": "text",
    "string_pattern_mismatch": "text of the form {pattern}",
    "float_type": "a number",
    "float_parsing": "a number",
    "finite_number": "a finite number",
    "int_type": "a whole number",
    "int_parsing": "a whole number",
    "int_from_float": "a whole number",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "literal_error": "{expected}",
    "enum": "{expected}",
    "greater_than": "more than {gt:g}",
    "greater_than_equal": "at least {ge:g}",
    "less_than": "less than {lt:g}",
    "less_than_equal": "at most {le:g}",
    "dict_type": "a group of keys",
    "dataclass_type": "a group of keys",
    "model_type": "a group of keys",
    "tuple_type": "a list",
    "list_type": "a list",
    "extra_forbidden": "no key of that name",
    "too_short": "at least {min_length} values",
    "too_long": "at most {max_length} values",
}


def key_of(error: Mapping[str, Any]) -> str:
    """The dotted key that one of ``ValidationError.errors()`` is about."""
    return ".".join(map(str, error["loc"]))


def told(error: Mapping[str, Any]) -> str:
    """One of ``ValidationError.errors()`` as a line: ``key: expected ..., found ...``."""
    kind, context = error["type"], error.get("ctx", {})
    if kind == "value_error":  # a rule of our own, which says what it found
        words = str(context["error"])
    else:
        expected = f"expected {_EXPECTED[kind].format(**context)}" if kind in _EXPECTED else error["msg"]
        found = "nothing" if kind == "missing" else _shown.repr(error.get("input"))
        words = f"{expected}, found {found}"
    return ": ".join(filter(None, [key_of(error), words]))
