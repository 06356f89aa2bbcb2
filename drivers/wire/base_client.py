"""A base at the other end of the wire."""

from dataclasses import replace

import zmq

from drivers.interfaces import BaseInfo, BaseState, DriveGoal, DriveReport, Lease
from drivers.jobs import BackgroundJob, Job, Progress
from drivers.messages import (
    PROTOCOL,
    AcquireLease,
    BaseIdentity,
    Beat,
    Goal,
    LeaseGranted,
    Ok,
    ReleaseLease,
    Request,
    Stop,
)
from drivers.wire.agent_client import AgentClient
from drivers.wire.codec import encode
from drivers.wire.introduction import introduced
from drivers.wire.naming import full_name
from drivers.wire.remote_drive import RemoteDrive
from drivers.wire.telemetry import Listener
from perception.failure import FailureError


class BaseClient(AgentClient):
    """:class:`drivers.interfaces.Base` over ZeroMQ, by ``control`` and ``telemetry`` of the base's agent.

    The beats have a socket of their own, which belongs to the one thread that calls :meth:`beat` and :meth:`close`.
    """

    def _begin(self) -> None:
        self._listener = Listener(self._sockets.subscriber(self._endpoints.telemetry))
        self._lease: Lease | None = None
        self._beats: zmq.Socket | None = None

    def close(self) -> None:
        """Stop listening to the telemetry, and beating; jobs under way are not touched."""
        self._listener.close()
        if self._beats is not None:
            self._beats.close()

    def info(self) -> Job[BaseInfo]:
        """See :meth:`drivers.interfaces.Base.info`."""

        def run(progress: Progress) -> BaseInfo:
            with self._control(progress) as link:
                identity, clock = introduced(link, BaseIdentity)
            return BaseInfo(identity.model, identity.serial, PROTOCOL, identity.footprint, clock)

        return BackgroundJob(run, "base info")

    def state(self) -> BaseState | None:
        """See :meth:`drivers.interfaces.Base.state`."""
        return self._listener.state()

    def acquire(self, owner: str) -> Job[Lease]:
        """See :meth:`drivers.interfaces.Base.acquire`."""

        def run(progress: Progress) -> Lease:
            with self._control(progress) as link:
                granted = link.ask(AcquireLease(owner), LeaseGranted)
            self._lease = Lease(*granted.lease, granted.owner)
            return self._lease

        return BackgroundJob(run, "base acquire")

    def beat(self, tick: int, may_move: bool) -> None:
        """See :meth:`drivers.interfaces.Base.beat`; what cannot be sent at once is not sent."""
        lease, nonce = self._lease, self._listener.nonce
        if lease is None or nonce is None:
            return
        if self._beats is None:
            self._beats = self._sockets.dealer(self._endpoints.control)
        frame = encode(Request(PROTOCOL, f"beat {tick}", Beat(lease.number, nonce, tick, may_move)))
        try:
            self._beats.send(frame, zmq.NOBLOCK)
            while True:  # what it replies is of no interest: telemetry tells who owns the base
                self._beats.recv(zmq.NOBLOCK)
        except zmq.Again:
            return

    def release(self) -> Job[None]:
        """See :meth:`drivers.interfaces.Base.release`."""
        lease, self._lease = self._lease, None

        def run(progress: Progress) -> None:
            if lease is not None:
                with self._control(progress) as link:
                    link.ask(ReleaseLease(lease.number), Ok)

        return BackgroundJob(run, "base release")

    def drive(self, goal: DriveGoal) -> Job[DriveReport]:
        """See :meth:`drivers.interfaces.Base.drive`.

        A base that restarted meanwhile is not sent on: it no longer knows where it stands, hence ``NAV_INTERRUPTED``.
        """
        lease = self._lease

        def run(progress: Progress) -> DriveReport:
            if lease is None:
                raise FailureError("LEASE_LOST", "the base was never acquired", goal_id=goal.goal_id, owner="")
            order = Goal.of(replace(goal, goal_id=full_name(self._mission, goal.goal_id)))
            try:
                with self._control(progress) as link:
                    drive = RemoteDrive(link, self._listener, order, lease, self._patience)
                    return replace(drive.follow(progress), goal_id=goal.goal_id)
            except FailureError:
                if progress.cancelled:
                    self._stop(Progress(), order.goal_id)
                raise

        return BackgroundJob(run, f"drive {goal.goal_id}")

    def stop(self) -> Job[None]:
        """See :meth:`drivers.interfaces.Base.stop`."""
        return BackgroundJob(self._stop, "base stop")

    def _stop(self, progress: Progress, goal_id: str | None = None) -> None:
        with self._control(progress) as link:
            link.ask(Stop(goal_id), Ok)
