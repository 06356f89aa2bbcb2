"""A base behind the wire: one owner, goals by name, each driven at most once, and a stop that always gets through."""

import threading
import time
from collections.abc import Callable

from drivers.devices import BaseDevice
from drivers.interfaces import DriveReport
from drivers.jobs import Progress
from drivers.lease import NEVER, LeaseKeeper
from drivers.messages import (
    AcquireLease,
    BaseIdentity,
    BaseRequest,
    Beat,
    Body,
    Drive,
    DriveDone,
    DriveStatus,
    Goal,
    Identify,
    Late,
    LeaseGranted,
    Ok,
    ReleaseLease,
    Stop,
    Unknown,
)
from drivers.wire.follow import Errands, follow, tell
from perception.failure import FailureError


class BaseService:
    """Answers what a base is asked on its control endpoint.

    The device is told how long its wheels may turn whenever that changes, and watches the clock itself: nothing needs
    to happen here for them to come to rest.
    """

    def __init__(self, device: BaseDevice, keeper: LeaseKeeper) -> None:
        self._device = device
        self._keeper = keeper
        self._errands = Errands()
        self._starting = threading.Lock()
        self._newest: str | None = None

    def control(self, request: BaseRequest) -> Body:
        """Reply to a request."""
        match request:
            case Identify():
                info = self._device.info()
                length, width = info.footprint
                return BaseIdentity(info.model, info.serial, (float(length), float(width)), time.time())
            case AcquireLease(owner):
                return self._acquire(owner)
            case ReleaseLease(lease):
                return self._release(lease)
            case Beat():
                return self._beat(request)
            case Drive():
                return self._drive(request)
            case DriveStatus(goal_id):
                return self._status(goal_id)
            case Stop(goal_id):
                return self._stop(goal_id)

    def close(self) -> None:
        """Stand still."""
        self._errands.cancel_all()
        self._device.permit(NEVER)
        self._device.stop()

    def _acquire(self, owner: str) -> Body:
        lease = self._keeper.acquire(owner)
        self._abandon()
        return LeaseGranted(lease.number, lease.owner)

    def _release(self, lease: tuple[int, int]) -> Body:
        if self._keeper.release(lease):
            self._abandon()
        return Ok()

    def _abandon(self) -> None:
        """End whatever the owner before was about to do."""
        self._device.permit(NEVER)
        if self._newest is not None:
            self._stop(self._newest)

    def _beat(self, beat: Beat) -> Body:
        if not self._keeper.beat(beat.lease, beat.nonce, beat.tick, beat.may_move):
            return Late()
        self._device.permit(self._keeper.moves_until)
        return Ok()

    def _drive(self, order: Drive) -> Body:
        goal, lease = order.goal, order.lease
        self._keeper.require(lease)
        if self._errands.get(goal.goal_id) is None:
            if not self._keeper.is_fresh(order.nonce):
                return Late()
            if self._newest is not None:
                self._errands.cancel(self._newest)
            self._newest = goal.goal_id
            self._errands.begin(goal.goal_id, self._driving(goal, lease))
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

    def _driving(self, goal: Goal, lease: tuple[int, int]) -> Callable[[Progress], DriveReport]:
        def run(progress: Progress) -> DriveReport:
            try:
                # One start at a time, and none after its stop: the device may think for a while before it moves.
                with self._starting:
                    progress.wait(0.0)
                    self._device.start_drive(goal.value())
                    if progress.cancelled:
                        self._device.stop()
                return follow(lambda: self._device.drive_status(goal.goal_id), progress, f"goal {goal.goal_id}")
            except FailureError as error:
                if progress.cancelled and not self._keeper.holds(lease):
                    raise self._keeper.lost(error.failure.evidence) from error
                raise

        return run


def _never_started(progress: Progress) -> DriveReport:
    raise FailureError("CANCELLED", "the goal was stopped before it was given")
