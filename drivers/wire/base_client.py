"""A base at the other end of the wire."""

from drivers.interfaces import BaseInfo, BaseState, DriveGoal, DriveReport
from drivers.jobs import BackgroundJob, Job, Progress
from drivers.messages import (
    PROTOCOL,
    BaseIdentity,
    Body,
    Drive,
    DriveDone,
    DriveStatus,
    Goal,
    Identify,
    Ok,
    Pending,
    Stop,
    Unknown,
)
from drivers.wire.client import Link, Patience
from drivers.wire.endpoints import Endpoints
from drivers.wire.sockets import Sockets
from drivers.wire.telemetry import Listener
from perception.failure import FailureError
from perception.transforms import Matrix

POLL_S = 0.05


class BaseClient:
    """:class:`drivers.interfaces.Base` over ZeroMQ; each job has a thread and a socket of its own.

    Args:
        endpoints: ``control`` and ``telemetry`` of the base's agent.
        patience: how long a silent agent is asked again before ``AGENT_UNREACHABLE``.
    """

    def __init__(self, endpoints: Endpoints, patience: Patience | None = None, sockets: Sockets | None = None) -> None:
        self._endpoint = endpoints.control
        self._patience = patience or Patience()
        self._sockets = sockets or Sockets()
        self._listener = Listener(self._sockets.subscriber(endpoints.telemetry))

    def close(self) -> None:
        """Stop listening to the telemetry; jobs under way are not touched."""
        self._listener.close()

    def info(self) -> Job[BaseInfo]:
        """See :meth:`drivers.interfaces.Base.info`."""

        def run(progress: Progress) -> BaseInfo:
            with self._link(progress) as link:
                identity = link.ask(Identify(), BaseIdentity)
            return BaseInfo(identity.model, identity.serial, PROTOCOL, identity.footprint)

        return BackgroundJob(run, "base info")

    def state(self) -> BaseState | None:
        """See :meth:`drivers.interfaces.Base.state`."""
        return self._listener.state()

    def drive(self, goal: DriveGoal) -> Job[DriveReport]:
        """See :meth:`drivers.interfaces.Base.drive`.

        A base that restarted meanwhile is not sent on: it no longer knows where it stands, hence ``NAV_STUCK``.
        """

        def run(progress: Progress) -> DriveReport:
            try:
                with self._link(progress) as link:
                    return self._follow(link, Goal.of(goal), progress)
            except FailureError:
                if progress.cancelled:
                    self._stop(Progress(), goal.goal_id)
                raise

        return BackgroundJob(run, f"drive {goal.goal_id}")

    def stop(self) -> Job[None]:
        """See :meth:`drivers.interfaces.Base.stop`."""
        return BackgroundJob(self._stop, "base stop")

    def _follow(self, link: Link, goal: Goal, progress: Progress) -> DriveReport:
        place: Matrix | None = None
        try:
            status: Body = link.ask(Drive(goal), (Pending, DriveDone), once=True)
        except FailureError as error:
            if error.failure.code == "AGENT_RESTARTED":
                raise _lost(goal, place) from error
            raise
        while isinstance(status, Pending):
            state = self.state()
            if state is not None and state.map_from_base is not None:
                place = state.map_from_base
            progress.report(status.fraction, status.note)
            progress.wait(POLL_S)
            status = link.ask(DriveStatus(goal.goal_id), (Pending, DriveDone, Unknown))
        if isinstance(status, DriveDone):
            return status.value()
        raise _lost(goal, place)

    def _stop(self, progress: Progress, goal_id: str | None = None) -> None:
        with self._link(progress) as link:
            link.ask(Stop(goal_id), Ok)

    def _link(self, progress: Progress) -> Link:
        return Link(self._sockets, self._endpoint, self._patience, progress)


def _lost(goal: Goal, place: Matrix | None) -> FailureError:
    return FailureError(
        "NAV_STUCK",
        f"the base restarted on its way to goal {goal.goal_id}; how far it came is not known",
        goal_id=goal.goal_id,
        track=[],
        map_from_base=None if place is None else place.tolist(),
    )
