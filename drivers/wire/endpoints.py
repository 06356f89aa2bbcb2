"""Where the agents are: configuration, so that either may be on its own machine."""

import ipaddress
from dataclasses import dataclass


@dataclass(frozen=True)
class Endpoints:
    """Addresses of one agent, such as ``tcp://127.0.0.1:5601``; an agent may bind port ``*`` and report what it got.

    Args:
        control: requests and replies.
        bulk: scan data (scanner only).
        telemetry: published state (base only).
        server_key: the agent's public key, as ``mission keys`` prints it there; empty for an agent without keys.
        serial: the device's serial number that the site was measured out with; empty for any.
    """

    control: str
    bulk: str = ""
    telemetry: str = ""
    server_key: str = ""
    serial: str = ""

    @property
    def addresses(self) -> tuple[str, ...]:
        """Those that are given."""
        return tuple(filter(None, (self.control, self.bulk, self.telemetry)))


def is_local(endpoint: str) -> bool:
    """Whether only this machine can reach the endpoint."""
    transport, _, address = endpoint.partition("://")
    if transport in ("ipc", "inproc"):
        return True
    host = address.rpartition(":")[0].strip("[]")
    try:
        return transport == "tcp" and ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"
