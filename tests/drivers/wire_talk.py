"""Talking to a base's agent: by a client that has the lease, and by hand."""

import zmq

from drivers.agent import Agent
from drivers.messages import PROTOCOL, AnyReply, Reply, Request
from drivers.wire.base_client import BaseClient
from drivers.wire.codec import Codec, encode
from drivers.wire.endpoints import Endpoints
from drivers.wire.sockets import Sockets
from drivers.wire.telemetry import Listener
from tests.drivers.wire_fakes import QUICK, eventually, value_of

replies: Codec = Codec(Reply[AnyReply])


def owner(endpoints: Endpoints, mission: str = "") -> BaseClient:
    """A client that has the lease."""
    client = BaseClient(endpoints, QUICK, mission=mission)
    value_of(client.acquire("owner"))
    return client


def heard(agent: Agent) -> int:
    """The nonce of the newest telemetry."""
    listener = Listener(Sockets().subscriber(agent.endpoints.telemetry))
    eventually(lambda: listener.nonce is not None)
    listener.close()
    return listener.nonce


def ask(socket: zmq.Socket, body: object, request_id: str, **stamp: object) -> Reply:
    """One exchange by hand, for what the client would never send."""
    socket.send(encode(Request(PROTOCOL, request_id, body, **stamp)))
    assert socket.poll(20_000), "no reply"
    return replies.decode(socket.recv())
