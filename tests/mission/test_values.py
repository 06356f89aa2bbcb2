"""Outcomes as JSON: what goes in comes out, bit for bit, and nothing else ever does."""

import dataclasses
import inspect
import json
import typing
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from mission.stages import STAGES
from mission.values import _KINDS, UnknownValueError, from_json, to_json
from perception.failure import Failure
from perception.findings import Door, DoorFindings, Registration


def through(value: object) -> object:
    return from_json(json.loads(json.dumps(to_json(value))))


def same(a: object, b: object) -> bool:
    if isinstance(a, np.ndarray):
        return isinstance(b, np.ndarray) and a.dtype == b.dtype and np.array_equal(a, b, equal_nan=True)
    if dataclasses.is_dataclass(a):
        return type(a) is type(b) and all(
            same(getattr(a, f.name), getattr(b, f.name))
            for f in dataclasses.fields(a)  # type: ignore[arg-type]
        )
    if isinstance(a, tuple | list):
        return type(a) is type(b) and len(a) == len(b) and all(map(same, a, b))  # type: ignore[arg-type]
    return a == b and type(a) is type(b)


@given(arrays.arrays(st.sampled_from([np.float64, np.float32, np.uint8, np.int64]), arrays.array_shapes(max_side=4)))
def test_arrays_keep_every_bit(array: np.ndarray) -> None:
    assert same(array, through(array))


@given(
    st.recursive(
        st.none() | st.booleans() | st.floats(allow_nan=False) | st.text(), lambda x: st.lists(x) | st.tuples(x, x)
    )
)
def test_plain_values_keep_their_types(value: object) -> None:
    assert same(value, through(value))


def test_findings_and_failures_come_back_as_they_were() -> None:
    door = Door(1.0, 2.0, (0.0, 1.0), 0.9, 0.85, 2.1, 0.97)
    findings = DoorFindings((door,), ((door, "narrow"),), ())
    found = Registration(np.eye(4), 0.9, float("inf"), 0.8, 0.2, (0.0, 0.0, 1.0), 0.1, 0.02, "icp")
    failure = Failure("NAV_BLOCKED", "a chair", {"track": [(1.0, 2.0, 0.1)], "distance": 1.5, "pose": np.eye(2)})
    assert all(same(value, through(value)) for value in (findings, found, Path("scans/S01.scan")))
    again = through(failure)
    assert isinstance(again, Failure)
    assert (again.code, again.evidence["track"], again.evidence["distance"]) == ("NAV_BLOCKED", [(1.0, 2.0, 0.1)], 1.5)


def test_every_stage_returns_what_the_ledger_can_keep() -> None:
    for name, stage in STAGES.items():
        kind = typing.get_type_hints(stage).get("return", type(None))
        assert kind is type(None) or kind is inspect.Signature.empty or kind in _KINDS.values(), name


@pytest.mark.parametrize("value", [object(), {1: 2}, {"$type": "x"}, np.array([object()])])
def test_what_has_no_place_in_the_ledger_is_refused(value: object) -> None:
    with pytest.raises((UnknownValueError, ValueError)):
        through(value)


@pytest.mark.parametrize(
    "data",
    [
        {"$type": "Popen"},
        {"$type": "Door"},
        {"$array": ["|O", [1], "AAAA"]},
        {"$array": ["<f8", [9], "AAAA"]},
        {"$tuple": 3},
    ],
)
def test_json_that_is_no_value_runs_nothing(data: object) -> None:
    with pytest.raises(UnknownValueError):
        from_json(data)
