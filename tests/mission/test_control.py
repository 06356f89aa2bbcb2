"""The control socket: who reaches it, how fast it answers, and what is told where nobody runs the mission."""

import json
import os
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest
from typer.testing import CliRunner

from drivers.processes import birth_of
from drivers.wire.client import Patience
from mission.cli import app
from mission.control import Abort, AnswerQuestion, AskStatus, Console, Pause, Resume, is_live, order, serving
from mission.operator import Desk, Word
from perception.failure import FailureError
from tests.mission.acknowledged import ACK_S, acknowledged
from tests.mission.test_operator import OPTIONS, desk

FIGURES = {"phase": "running", "code": "", "message": "", "tick": 7, "mission_s": 12.0, "room": "R1", "scans": 2,
           "doing": "take the scan", "note": "40 %"}  # fmt: skip


class Live:
    """A mission's control socket without the mission."""

    def __init__(self) -> None:
        self.word = Word()
        self.desk: Desk = desk()[0]
        self.console = Console(self.word, self.desk)
        self.console.publish(FIGURES)


@pytest.fixture
def live(tmp_path: Path) -> Iterator[Live]:
    mission = Live()
    with serving(mission.console, tmp_path):
        yield mission


def test_each_order_is_obeyed_and_acknowledged(live: Live, tmp_path: Path) -> None:
    assert order(tmp_path, AskStatus()).command == "run"
    assert order(tmp_path, Pause()).command == live.word() == "pause"
    assert order(tmp_path, Resume()).command == live.word() == "run"
    assert order(tmp_path, Abort()).command == live.word() == "abort"
    with pytest.raises(FailureError, match="MISSION_ENDING"):
        order(tmp_path, Resume())


def test_a_question_is_shown_and_answered(live: Live, tmp_path: Path) -> None:
    job = live.desk.ask("Q001", "Again?", OPTIONS, "go on", 120.0)
    (question,) = order(tmp_path, AskStatus()).questions
    assert (question["question_id"], question["options"]) == ("Q001", list(OPTIONS))
    assert order(tmp_path, AnswerQuestion("Q001", "again")).questions == []
    assert job.poll().value == "again"  # type: ignore[union-attr]
    with pytest.raises(FailureError, match="NO_SUCH_QUESTION"):
        order(tmp_path, AnswerQuestion("Q001", "again"))


def test_a_resume_is_also_the_word_that_a_hold_waits_for(live: Live, tmp_path: Path) -> None:
    live.word.pause()
    job = live.desk.ask("ESTOP-1", "Go on?", ("resume", "end"), "end", 120.0)
    order(tmp_path, Resume())
    assert (live.word(), job.poll().value) == ("run", "resume")  # type: ignore[union-attr]


def test_only_this_user_reaches_it_and_nothing_is_left(tmp_path: Path) -> None:
    mission = Live()
    with serving(mission.console, tmp_path):
        address = tmp_path / "control.json"
        endpoint = Path(json.loads(address.read_text())["endpoint"].removeprefix("ipc://"))
        assert stat.S_IMODE(address.stat().st_mode) == 0o600
        assert stat.S_IMODE(endpoint.parent.stat().st_mode) == 0o700
        assert is_live(tmp_path)
    assert not address.exists()
    assert not endpoint.parent.exists()
    assert not is_live(tmp_path)


def test_an_address_left_by_a_killed_executive_is_known_as_such(tmp_path: Path) -> None:
    gone = os.fork()
    if gone == 0:
        os._exit(0)
    os.waitpid(gone, 0)
    left = {"endpoint": "ipc:///nowhere", "pid": gone, "birth": birth_of(os.getpid())}
    (tmp_path / "control.json").write_text(json.dumps(left))
    with pytest.raises(FailureError, match=r"NO_EXECUTIVE.*gone"):
        order(tmp_path, Pause())
    with serving(Live().console, tmp_path):
        assert is_live(tmp_path)


def test_another_process_that_has_its_number_is_not_taken_for_the_executive(tmp_path: Path) -> None:
    """As after a power cut, when the address was left and the numbers are given out anew."""
    address = tmp_path / "control.json"
    left = {"endpoint": "ipc:///nowhere", "pid": os.getpid(), "birth": birth_of(os.getpid()) + "1"}
    address.write_text(json.dumps(left))
    assert not is_live(tmp_path)
    with pytest.raises(FailureError, match=r"NO_EXECUTIVE.*gone"):
        order(tmp_path, Pause())
    address.write_text(json.dumps(left | {"birth": birth_of(os.getpid())}))
    assert is_live(tmp_path)


def test_an_executive_that_lives_but_does_not_answer_is_told_apart_from_one_that_is_gone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("mission.control._PATIENCE", Patience(first=0.05, longest=0.1, total=0.2))
    (tmp_path / "control.json").write_text(
        json.dumps({"endpoint": f"ipc://{tmp_path}/deaf", "pid": os.getpid(), "birth": birth_of(os.getpid())})
    )
    with pytest.raises(FailureError, match="EXECUTIVE_SILENT"):
        order(tmp_path, Pause())


@pytest.mark.parametrize("text", ["", "{", "[]", '{"endpoint": 3}'])
def test_an_address_that_cannot_be_read_is_named(text: str, tmp_path: Path) -> None:
    (tmp_path / "control.json").write_text(text)
    with pytest.raises(FailureError, match="NO_EXECUTIVE"):
        order(tmp_path, Pause())


def test_orders_are_acknowledged_within_200_ms(live: Live, tmp_path: Path) -> None:
    """The 99th percentile over both ways and all sockets being made anew; to a mission: ``benchmarks.pauses``."""
    waits = [acknowledged(tmp_path, Pause()) for _ in range(100)]
    assert sorted(wait.own for wait in waits)[98] < ACK_S


# --- the commands ---------------------------------------------------------------------------------------------------


def call(*arguments: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, [str(argument) for argument in arguments])
    return result.exit_code, result.output


def test_the_commands_say_how_it_stands(live: Live, tmp_path: Path) -> None:
    code, told = call("status", tmp_path)
    assert (code, told.splitlines()) == (0, ["RUNNING", "R1, 2 scans; take the scan: 40 %"])
    live.desk.ask("Q001", "Again?", OPTIONS, "go on", 120.0)
    assert call("pause", tmp_path)[1].splitlines()[0] == "pausing; RUNNING"
    assert "answer 'again' | 'go on'; 'go on' in 108 s" in call("status", tmp_path)[1]
    assert call("answer", tmp_path, "Q001", "again")[0] == 0
    assert json.loads(call("resume", tmp_path, "--json")[1])["command"] == "run"
    assert call("abort", tmp_path)[1].startswith("aborting")


def test_an_order_to_a_paused_mission_is_seen_in_its_answer(live: Live, tmp_path: Path) -> None:
    live.console.publish(FIGURES | {"phase": "paused"})
    assert call("pause", tmp_path)[1].splitlines()[0] == "PAUSED"
    assert call("resume", tmp_path)[1].splitlines()[0] == "going on; PAUSED"
    assert call("abort", tmp_path)[1].splitlines()[0] == "aborting; PAUSED"


@pytest.mark.parametrize("command", [("pause",), ("resume",), ("abort",), ("answer", "Q001", "again")])
def test_a_mission_that_nobody_runs_is_told_so(command: tuple[str, ...], tmp_path: Path) -> None:
    name, *more = command
    code, told = call(name, tmp_path, *more)
    assert code == 2
    assert str(tmp_path) in told


def test_the_status_of_a_mission_that_has_ended_is_how_it_ended(tmp_path: Path) -> None:
    state = {"phase": "done", "code": "", "message": "", "outcome": "complete", "scans": [{}, {}]}
    (tmp_path / "state.json").write_text(json.dumps(state))
    assert call("status", tmp_path) == (0, "DONE\n2 scans\n")
    (tmp_path / "state.json").write_text(json.dumps({"phase": "running", "scans": []}))
    assert "its executive died" in call("status", tmp_path)[1]
    short = {"id": "R1", "status": "partial", "reason_ended": "AGENT_UNREACHABLE"}
    state |= {"phase": "aborted", "outcome": "aborted", "rooms": [short, {"id": "R2", "status": "complete"}]}
    (tmp_path / "state.json").write_text(json.dumps(state))
    told = call("status", tmp_path)[1].splitlines()
    assert told == ["ABORTED", "2 scans", "R1 partial: AGENT_UNREACHABLE", f"`mission resume {tmp_path}` takes it up"]
