"""A base behind the wire: goals by name, each driven at most once, and a stop that always gets through."""

import threading
from collections.abc import Callable

from drivers.devices import BaseDevice
from drivers.interfaces import DriveReport
from drivers.jobs import Progress
from drivers.messages import (
    BaseIdentity,
    BaseRequest,
    Body,
    Drive,
    DriveDone,
    DriveStatus,
    Goal,
    Identify,
    Ok,
    Stop,
    Unknown,
)
from drivers.wire.follow import Errands, follow, tell
from perception.failure import FailureError


class BaseService:
    """Answers what a base is asked on its control endpoint."""

    def __init__(self, device: BaseDevice) -> None:
        self._device = device
        self._errands = Errands()
        self._starting = threading.Lock()
        self._newest: str | None = None

    def control(self, request: BaseRequest) -> Body:
        """Reply to a request."""
        match request:
            case Identify():
                info = self._device.info()
                length, width = info.footprint
                return BaseIdentity(info.model, info.serial, (float(length), float(width)))
            case Drive(goal):
                return self._drive(goal)
            case DriveStatus(goal_id):
                return self._status(goal_id)
            case Stop(goal_id):
                return self._stop(goal_id)

    def close(self) -> None:
        """Stand still."""
        self._errands.cancel_all()
        self._device.stop()

    def _drive(self, goal: Goal) -> Body:
        if self._errands.get(goal.goal_id) is None:
            if self._newest is not None:
                self._errands.cancel(self._newest)
            self._newest = goal.goal_id
            self._errands.begin(goal.goal_id, self._driving(goal))
        return self._status(goal.goal_id)

    def _status(self, goal_id: str) -> Body:
        job = self._errands.get(goal_id)
        return Unknown() if job is None else tell(job.poll(), DriveDone.of)

    def _stop(self, goal_id: str | None) -> Body:
        if goal_id is not None and self._errands.get(goal_id) is None:
            # It overtook its drive, which may still come and must not start then.
            self._errands.begin(goal_id, _never_started)
            return Ok()
        stopped = goal_id or self._newest
        if stopped is not None:
            self._errands.cancel(stopped)
        if stopped == self._newest:
            self._device.stop()
        return Ok()

    def _driving(self, goal: Goal) -> Callable[[Progress], DriveReport]:
        def run(progress: Progress) -> DriveReport:
            # One start at a time, and none after its stop: the device may think for a while before it moves.
            with self._starting:
                progress.wait(0.0)
                self._device.start_drive(goal.value())
                if progress.cancelled:
                    self._device.stop()
            return follow(lambda: self._device.drive_status(goal.goal_id), progress, f"goal {goal.goal_id}")

        return run


def _never_started(progress: Progress) -> DriveReport:
    raise FailureError("CANCELLED", "the goal was stopped before it was given")
