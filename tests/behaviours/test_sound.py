"""Results whose numbers are none are refused before anybody draws or drives by them."""

from dataclasses import replace

import numpy as np
import pytest

from behaviours.sound import unsound
from drivers.interfaces import DriveReport
from perception.findings import Alignment, PoseAdjustment, RoomShape

NAN = float("nan")
POSE = np.eye(4)
REPORT = DriveReport("G1", POSE, ((0.0, 1.0, 2.0),), 3.0)
SHAPE = RoomShape(np.zeros((4, 2)), 0.0, 3.0, np.zeros((4, 4)))
ADJUSTED = PoseAdjustment({"S01": POSE}, {}, 1, (), 0.0, 0.0, 0.0)


@pytest.mark.parametrize("value", [REPORT, SHAPE, ADJUSTED, None, "S01.scan", 7, [], POSE])
def test_a_result_of_numbers_is_sound(value: object) -> None:
    assert unsound(value) == ""


def test_a_figure_that_is_not_known_is_no_fault() -> None:
    assert unsound(Alignment(POSE, 0.0, 0.0, 1.3, NAN, 0.0, 0.3)) == ""


@pytest.mark.parametrize(
    ("value", "name"),
    [
        (replace(REPORT, map_from_base=POSE * NAN), "map_from_base"),
        (replace(REPORT, track=((0.0, NAN, 1.0),)), "track"),
        (replace(REPORT, track=((0.0, float("inf"), 1.0),)), "track"),
        (replace(SHAPE, contour=np.full((4, 2), NAN)), "contour"),
        (replace(ADJUSTED, poses={"S01": POSE, "S02": POSE * NAN}), "poses"),
        (POSE * NAN, "ndarray"),
    ],
)
def test_what_is_no_number_is_named(value: object, name: str) -> None:
    assert unsound(value) == name
