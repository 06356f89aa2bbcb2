"""What is told after each tick, the same to all: state.json, the control socket, the display, the service manager."""

import logging
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from mission.control import Console
from mission.executive import Executive, active_branch
from mission.operator import Desk
from mission.state import describe
from mission.store import RunFolder
from mission.watchdog import ServiceManager
from perception.failure import FailureError

log = logging.getLogger("mission")

Display = Callable[[Executive, dict[str, Any]], None]
"""Shows progress after each tick: the executive, and the newest event of each kind."""


class Bulletin:
    """Tells how the mission stands.

    Args:
        newest: the newest event of each kind, for the display.
        now: mission time.
    """

    def __init__(
        self,
        folder: RunFolder,
        console: Console,
        desk: Desk,
        newest: dict[str, Any],
        now: Callable[[], float],
        display: Display | None,
    ) -> None:
        self._folder = folder
        self._console = console
        self._desk = desk
        self._newest = newest
        self._now = now
        self._display = display
        self._manager = ServiceManager()
        self._behind = False

    def tell(self, executive: Executive, tick: int) -> None:
        """After a tick."""
        if tick == 1:
            self._manager.ready()
        if executive.changed or self._behind:
            self._behind = not self._wrote(self.state(executive))
        self._console.publish(self._figures(executive, tick))
        self._manager.tick(str(executive.course.state))
        if self._display is not None:
            self._display(executive, self._newest)

    def state(self, executive: Executive) -> dict[str, Any]:
        """The survey, the phase and the questions as ``state.json`` holds them."""
        questions = [asdict(question) for question in self._desk.questions]
        return describe(executive.survey) | phase_figures(executive) | {"questions": questions}

    def close(self) -> None:
        self._manager.stopping()

    def _wrote(self, state: dict[str, Any]) -> bool:
        """Whether the disk took the state; the mission goes by its ledger, and waits for this file never."""
        try:
            self._folder.write_state(state)
        except FailureError as error:
            if not self._behind:
                log.warning("state.json is not of this tick: %s", error)
            return False
        return True

    def _figures(self, executive: Executive, tick: int) -> dict[str, Any]:
        survey = executive.survey
        branch = active_branch(executive.root)
        rooms = survey.building.rooms
        return phase_figures(executive) | {
            "tick": tick,
            "mission_s": round(self._now(), 1),
            "room": rooms[-1].id if rooms else "",
            "scans": len(survey.scans),
            "doing": branch[-1].name if branch else "",
            "note": branch[-1].feedback_message if branch else "",
        }


def phase_figures(executive: Executive) -> dict[str, Any]:
    """``phase``, ``code`` and ``message``, wherever a mission's state is told."""
    state = executive.course.state
    return {"phase": state.phase.value, "code": state.code, "message": state.message}
