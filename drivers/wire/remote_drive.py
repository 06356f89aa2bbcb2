"""One drive at the other end of the wire, from its order to its end, and what is known of it where nobody tells."""

import time
from dataclasses import replace

from drivers.interfaces import DriveReport, Lease
from drivers.jobs import Progress
from drivers.messages import Body, Drive, DriveDone, DriveStatus, Goal, Late, Pending, Unknown
from drivers.wire.client import Link, Patience
from drivers.wire.telemetry import Listener
from perception import transforms
from perception.failure import FailureError

POLL_S = 0.05


class RemoteDrive:
    """For the thread that follows it.

    Args:
        link: to the base's agent.
        listener: its telemetry.
    """

    def __init__(self, link: Link, listener: Listener, goal: Goal, lease: Lease, patience: Patience) -> None:
        self._link = link
        self._listener = listener
        self._goal = goal
        self._lease = lease
        self._patience = patience
        self._set_out = self._seen = listener.state()

    def follow(self, progress: Progress) -> DriveReport:
        """Give the order and wait for the end.

        When it returns or raises, telemetry is newer than what the base said of the end, if there is any at all:
        whoever looks next where it stands must not be told where it stood.

        Raises:
            FailureError: as :meth:`drivers.interfaces.Base.drive`, with ``track`` and ``distance`` as evidence.
        """
        try:
            status = self._order(progress)
            while isinstance(status, Pending):
                self._look()
                progress.report(status.fraction, status.note)
                progress.wait(POLL_S)
                status = self._link.ask(DriveStatus(self._goal.goal_id), (Pending, DriveDone, Unknown))
        except FailureError as error:
            if not progress.cancelled:
                self._catch_up(progress)
            raise self._explained(error) from error
        self._catch_up(progress)
        if isinstance(status, DriveDone):
            return status.value()
        raise self._explained(self._interrupted())

    def _order(self, progress: Progress) -> Body:
        """Give the order with the newest nonce, anew where it comes too late; the first word of the base on it."""
        give_up = time.monotonic() + self._patience.total
        while time.monotonic() < give_up:
            nonce = self._listener.nonce
            if nonce is not None:
                order = Drive(self._goal, self._lease.number, nonce)
                reply = self._link.ask(order, (Pending, DriveDone, Late), once=True)
                if not isinstance(reply, Late):
                    return reply
            progress.wait(POLL_S)
        raise self._link.unreachable()

    def _catch_up(self, progress: Progress) -> None:
        give_up = time.monotonic() + self._patience.total
        while not self._listener.has_heard(self._link.boot, self._link.clock) and time.monotonic() < give_up:
            progress.wait(POLL_S)

    def _look(self) -> None:
        state = self._listener.state()
        if self._set_out is None:
            self._set_out = state
        if state is not None and self._set_out is not None and state.odom_frame == self._set_out.odom_frame:
            self._seen = state

    def _interrupted(self) -> FailureError:
        return FailureError("NAV_INTERRUPTED", f"the base began anew on its way to goal {self._goal.goal_id}")

    def _explained(self, error: FailureError) -> FailureError:
        """With how far it came, as far as telemetry tells, where the base itself does not say."""
        failure = (self._interrupted() if error.failure.code == "AGENT_RESTARTED" else error).failure
        told = FailureError(failure.code, failure.message)
        known = {} if "track" in failure.evidence else {"goal_id": self._goal.goal_id, **self._way()}
        told.failure = replace(failure, evidence={**known, **failure.evidence})
        return told

    def _way(self) -> dict[str, object]:
        if self._set_out is None or self._seen is None:
            return {"track": [], "distance": 0.0}
        place = self._seen.map_from_base
        metres, _ = transforms.difference(self._set_out.odom_from_base, self._seen.odom_from_base)
        return {"track": [] if place is None else [transforms.to_planar(place)], "distance": metres}
