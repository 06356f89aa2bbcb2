"""Progress while a mission runs: the room, the cycle, the active branch of the tree, λ and μ."""

import time
from typing import Any

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from mission.executive import Executive, active_branch
from mission.phase import Phase, State


class Display:
    """Called after each tick; on a terminal a live panel, elsewhere one line for each thing that happened."""

    REFRESH_S = 0.5

    def __init__(self, console: Console) -> None:
        self._console = console
        self._live: Live | None = None
        self._next = 0.0
        self._told: dict[str, Any] = {}

    @classmethod
    def for_terminal(cls, quiet: bool) -> "Display | None":
        return None if quiet else cls(Console(stderr=True, highlight=False))

    def __call__(self, executive: Executive, newest: dict[str, Any]) -> None:
        ended = executive.root.status.value != "RUNNING"
        if self._console.is_terminal:
            self._show(executive, newest, ended)
        else:
            self._tell(newest)

    def _show(self, executive: Executive, newest: dict[str, Any], ended: bool) -> None:
        if time.monotonic() < self._next and not ended:
            return
        self._next = time.monotonic() + self.REFRESH_S
        if self._live is None:
            self._live = Live(console=self._console, auto_refresh=False, transient=True)
            self._live.start()
        self._live.update(panel(executive, newest), refresh=True)
        if ended:
            self._live.stop()

    def _tell(self, newest: dict[str, Any]) -> None:
        for kind in (
            "doubts",
            "phase",
            "asked",
            "answered",
            "room_started",
            "registered",
            "assessed",
            "drive",
            "doors",
            "room_ended",
            "failure",
        ):
            event = newest.get(kind)
            if event is not None and event is not self._told.get(kind):
                self._told[kind] = event
                self._console.print(f"{event['t']:8.1f}  {line_of(event)}", soft_wrap=True)


def panel(executive: Executive, newest: dict[str, Any]) -> Group:
    """The live panel: rooms so far, and what the tree is doing."""
    survey = executive.survey
    rooms = Table("room", "scans", "seen", "λ", "μ", "status", box=None, pad_edge=False)
    for room in survey.building.rooms:
        cycles = survey.cycles.get(room.id, ())
        last = cycles[-1] if cycles else None
        figures = ("–", "–", "–")
        if last is not None:
            seen = last.counts.seen / max(last.counts.total, 1)
            decision = last.decision
            figures = (f"{seen:.0%}", f"{decision.growing_rate:.3f}", f"{decision.occluded_decrease_rate:.3f}")
        rooms.add_row(room.id, str(len(survey.room_scans(room.id))), *figures, room.reason or room.status)
    branch = active_branch(executive.root)
    words = " › ".join(node.name for node in branch[2:])
    feedback = branch[-1].feedback_message if branch else ""
    trouble = newest.get("failure")
    return Group(
        rooms,
        Text(str(executive.course.state), style="bold"),
        Text(f"{words}  {feedback}", style="cyan"),
        Text(f"last trouble: {trouble['code']} {trouble['message']}" if trouble else "", style="yellow"),
    )


def line_of(event: dict[str, Any]) -> str:
    """One event in plain words."""
    match event["kind"]:
        case "doubts":
            return f"started all the same: {event['words']}"
        case "phase":
            return str(State(Phase(event["after"]), event["code"], event["message"]))
        case "asked":
            options = " or ".join(f"'{option}'" for option in event["options"])
            return f"{event['question_id']}: {event['text']} {options}: `mission answer RUN {event['question_id']} ...`"
        case "answered":
            return f"{event['question_id']}: '{event['answer']}', by {event['by']}"
        case "room_started":
            return f"room {event['room_id']} begins"
        case "registered":
            figures = f"overlap {event['overlap']:.0%}, rmse {event['rmse'] * 1000:.1f} mm"
            return f"{event['scan_id']} placed by {event['method']}: {figures}"
        case "assessed":
            rates = f"λ {event['growing_rate']:.3f}, μ {event['occluded_decrease_rate']:.3f}"
            seen = event["occupied"] + event["empty"]
            share = seen / max(seen + event["occluded"], 1)
            return f"{event['room_id']} {event['scan_id']}: {share:.0%} seen, {rates} {event['reason']}"
        case "drive":
            return f"drive to {event['purpose']}: {event['result']}, {event['distance']:.1f} m"
        case "doors":
            return f"{event['room_id']}: {len(event['found'])} open doors"
        case "room_ended":
            return f"room {event['room_id']} ended: {event['reason']}"
        case "failure":
            return f"{event['code']}: {event['message']}"
        case other:
            return str(other)
