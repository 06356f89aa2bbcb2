"""How a mission stands, in words and figures: what every control command answers with."""

from dataclasses import dataclass
from typing import Any

from mission.control import Status
from mission.phase import Phase, State
from mission.store import RunFolder, read_mapping

_TAKEN_UP = ("aborted", "safety_stop", "fault")
"""Outcomes after which a mission may go on."""


@dataclass(frozen=True)
class Standing:
    """The same twice: for people and, JSON-ready, for programs."""

    words: str
    figures: dict[str, Any]


def standing_of(status: Status) -> Standing:
    """Of a mission that answers."""
    figures = status.figures
    lines = ["; ".join(filter(None, (_ordered(status), _phase(figures))))]
    if "tick" in figures:
        where = f"{figures['room']}, " if figures["room"] else ""
        lines.append(f"{where}{figures['scans']} scans; {figures['doing']}: {figures['note']}")
    for question in status.questions:
        options = " | ".join(f"'{option}'" for option in question["options"])
        left = max(0.0, question["deadline"] - figures.get("mission_s", 0.0))
        lines.append(f"{question['question_id']}: {question['text']}")
        lines.append(f"  answer {options}; '{question['default']}' in {left:.0f} s")
    return Standing("\n".join(lines), figures | {"command": status.command, "questions": status.questions})


def standing_of_ended(folder: RunFolder) -> Standing:
    """Of a mission that nobody runs: what its state file says.

    Raises:
        FailureError: ``RUN_UNREADABLE`` where there is none.
    """
    state = read_mapping(folder.state)
    figures = {key: state.get(key, "") for key in ("phase", "code", "message", "outcome", "started", "ended")}
    figures["scans"] = len(state.get("scans", ()))
    lines = [_phase(figures), f"{figures['scans']} scans"]
    if not figures["outcome"]:
        lines[0] = f"was {lines[0]} when its executive died"
    rooms = [room for room in state.get("rooms", ()) if room.get("status") != "complete"]
    lines += [f"{room['id']} {room.get('status')}: {room.get('reason_ended') or 'not ended'}" for room in rooms]
    if not figures["outcome"] or figures["outcome"] in _TAKEN_UP:
        lines.append(f"`mission resume {folder.path}` takes it up")
    return Standing("\n".join(lines), figures)


def _ordered(status: Status) -> str:
    """What the operator has ordered, while the mission is on its way there."""
    paused = status.figures.get("phase") == Phase.PAUSED
    ways = {"abort": "aborting", "pause": "" if paused else "pausing", "run": "going on" if paused else ""}
    return ways.get(status.command, "")


def _phase(figures: dict[str, Any]) -> str:
    phase = figures.get("phase") or Phase.PREFLIGHT
    return str(State(Phase(phase), figures.get("code", ""), figures.get("message", "")))
