"""Progress: a line for each thing that happened, and the panel of a terminal."""

import io
from dataclasses import replace
from typing import Any

import pytest
from py_trees.behaviours import Running
from py_trees.blackboard import Blackboard
from py_trees.composites import Sequence
from rich.console import Console

from behaviours.keys import Key
from behaviours.survey import Cycle, Survey
from mission.clock import MissionClock
from mission.display import Display, line_of, panel
from mission.executive import Executive
from perception.findings import LabelCounts
from perception.stopping import StopDecision
from tests.behaviours.bench import Bench, scan

DECISION = StopDecision(True, "lambda_mu", 0.031, 0.017, 0.004)


@pytest.fixture
def executive() -> Executive:
    """In the middle of a mission: one room done, the next one's leaf running."""
    leaf = Running("take the scan")
    root = Sequence("mission", memory=True, children=[Sequence("work", memory=True, children=[leaf])])
    executive = Executive(root, Bench().services, MissionClock())
    survey = Survey()
    building, first = survey.building.add_room((0.0, 0.0))
    building = building.end_room(first, "complete", "lambda_mu")
    building, _ = building.add_room((5.0, 0.0))
    cycle = Cycle("S01", LabelCounts(100, 700, 200), DECISION)
    survey = replace(survey, building=building, cycles={first: (cycle,)}).with_scan(scan("S01", room_id=first))
    Blackboard.set(Key.SURVEY, survey)
    root.tick_once()
    leaf.feedback_message = "12 s"
    return executive


def shown(executive: Executive, newest: dict[str, Any]) -> str:
    console = Console(file=io.StringIO(), width=160)
    console.print(panel(executive, newest))
    return console.file.getvalue()  # type: ignore[attr-defined]


def test_the_panel_shows_rooms_with_their_figures_and_the_active_branch(executive: Executive) -> None:
    text = shown(executive, {})
    done, begun = (line.split() for line in text.splitlines() if line.startswith("R"))
    assert done == ["R1", "1", "80%", "0.031", "0.017", "lambda_mu"]
    assert begun[:5] == ["R2", "0", "–", "–", "–"]
    assert "take the scan  12 s" in text
    assert "PREFLIGHT" in text


def test_the_panel_shows_the_last_trouble(executive: Executive) -> None:
    trouble = {"code": "NAV_BLOCKED", "message": "a cart stands in the way"}
    assert "last trouble: NAV_BLOCKED a cart stands in the way" in shown(executive, {"failure": trouble})
    assert "last trouble" not in shown(executive, {})


def test_without_a_terminal_each_event_is_told_once(executive: Executive) -> None:
    stream = io.StringIO()
    display = Display(Console(file=stream, force_terminal=False, width=120))
    begins = {"t": 1.0, "kind": "room_started", "room_id": "R1"}
    newest = {"room_started": begins, "node": {"t": 1.0, "kind": "node"}}
    for _ in range(3):
        display(executive, newest)
    display(executive, newest | {"room_started": {**begins, "t": 9.0, "room_id": "R2"}})
    assert stream.getvalue().splitlines() == ["     1.0  room R1 begins", "     9.0  room R2 begins"]


def test_a_terminal_gets_a_panel_that_goes_when_the_mission_ends(executive: Executive) -> None:
    stream = io.StringIO()
    display = Display(Console(file=stream, force_terminal=True, width=120))
    display(executive, {})
    assert "take the scan" in stream.getvalue()
    executive.root.stop()
    display(executive, {})
    assert stream.getvalue().endswith("\x1b[?25h") or "\x1b[?25h" in stream.getvalue(), "the cursor is shown again"


def test_whoever_wants_json_gets_no_display() -> None:
    assert Display.for_terminal(quiet=True) is None
    assert Display.for_terminal(quiet=False) is not None


@pytest.mark.parametrize(
    ("event", "line"),
    [
        ({"kind": "registered", "scan_id": "S02", "method": "icp", "overlap": 0.712, "rmse": 0.0031},
         "S02 placed by icp: overlap 71%, rmse 3.1 mm"),
        ({"kind": "assessed", "room_id": "R1", "scan_id": "S02", "occupied": 10, "empty": 80, "occluded": 10,
          "growing_rate": 0.5, "occluded_decrease_rate": 0.25, "reason": ""},
         "R1 S02: 90% seen, λ 0.500, μ 0.250 "),
        ({"kind": "drive", "purpose": "door", "result": "NAV_BLOCKED", "distance": 1.26},
         "drive to door: NAV_BLOCKED, 1.3 m"),
        ({"kind": "doors", "room_id": "R1", "found": [{}, {}]}, "R1: 2 open doors"),
        ({"kind": "room_ended", "room_id": "R1", "reason": "no_candidate"}, "room R1 ended: no_candidate"),
        ({"kind": "failure", "code": "ESTOP", "message": "pressed"}, "ESTOP: pressed"),
        ({"kind": "phase", "after": "hold", "code": "ESTOP", "message": "release it"}, "HOLD(ESTOP): release it"),
        ({"kind": "asked", "question_id": "Q001", "text": "Again?", "options": ["again", "go on"]},
         "Q001: Again? 'again' or 'go on': `mission answer RUN Q001 ...`"),
        ({"kind": "answered", "question_id": "Q001", "answer": "go on", "by": "default"},
         "Q001: 'go on', by default"),
        ({"kind": "something new"}, "something new"),
    ],
)  # fmt: skip
def test_events_in_plain_words(event: dict[str, Any], line: str) -> None:
    assert line_of(event) == line


def test_an_empty_room_has_no_share_that_divides_by_nothing() -> None:
    nothing = {"occupied": 0, "empty": 0, "occluded": 0, "growing_rate": 0.0, "occluded_decrease_rate": 0.0}
    assert "0% seen" in line_of({"kind": "assessed", "room_id": "R1", "scan_id": "S01", "reason": "", **nothing})
