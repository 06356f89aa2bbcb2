"""What the clients of both agents have in common: whom they ask, how patiently, and for which mission."""

from drivers.jobs import Progress
from drivers.wire.client import Link, Patience
from drivers.wire.endpoints import Endpoints
from drivers.wire.sockets import Sockets


class AgentClient:
    """The executive's side of one agent; each job has a thread and a socket of its own.

    Args:
        endpoints: of the agent.
        patience: how long a silent agent is asked again before ``AGENT_UNREACHABLE``.
        mission: whose scans and goals those are that are asked for; the agent has those of others too.
    """

    def __init__(
        self,
        endpoints: Endpoints,
        patience: Patience | None = None,
        sockets: Sockets | None = None,
        mission: str = "",
    ) -> None:
        self._endpoints = endpoints
        self._patience = patience or Patience()
        self._sockets = sockets or Sockets()
        self._mission = mission
        self._begin()

    def _begin(self) -> None:
        """What a client does besides, as soon as it knows whom it asks."""

    def _control(self, progress: Progress, patience: Patience | None = None) -> Link:
        return Link(self._sockets, self._endpoints.control, patience or self._patience, progress)
