"""The one place where sockets are made, so that their limits, and who may connect, are decided in one place.

A socket belongs to the thread that uses it. There is no REQ among them: one lost reply makes it useless for ever.

What only this machine can reach may be plain; its user may do everything. Whatever else is bound or connected must
speak CURVE: both ends prove that they hold the key they are known by, and nobody between them reads or changes a byte.
"""

from collections.abc import Callable
from functools import cached_property

import zmq

from drivers.messages import MAX_MESSAGE
from drivers.wire.endpoints import is_local
from drivers.wire.keys import Keyring, fingerprint
from drivers.wire.roles import Gate
from drivers.wire.zap import DOMAIN, Authenticator
from perception.failure import FailureError

_LIMITS = {
    zmq.LINGER: 0,
    zmq.MAXMSGSIZE: MAX_MESSAGE,
    zmq.SNDHWM: 64,
    zmq.RCVHWM: 64,
    zmq.HANDSHAKE_IVL: 2000,
    zmq.BACKLOG: 32,
    # Of the link only: libzmq answers these even while the process behind it is stuck.
    zmq.HEARTBEAT_IVL: 1000,
    zmq.HEARTBEAT_TIMEOUT: 3000,
    zmq.RECONNECT_IVL: 50,
    zmq.RECONNECT_IVL_MAX: 1000,
    zmq.CONNECT_TIMEOUT: 2000,
}


class Sockets:
    """Makes the sockets of one agent, or of the clients of one agent.

    Args:
        keyring: with it whatever is bound speaks CURVE, on loopback too, and lets in only whom the keyring knows.
        server_key: public key of the agent that is connected to, which then must prove to hold it; needs the keyring.
    """

    def __init__(self, keyring: Keyring | None = None, server_key: str = "") -> None:
        self._keyring = keyring
        self._server_key = server_key
        self._authenticator: Authenticator | None = None

    @property
    def public_key(self) -> str:
        """The key that a client must know of what is bound here; empty for plain sockets."""
        return "" if self._keyring is None else self._keyring.own.public

    @property
    def gate(self) -> Gate | None:
        """Who may ask what on the sockets that are bound here; None for plain sockets."""
        return None if self._keyring is None else Gate(self._keyring.role_of)

    @property
    def advice(self) -> str:
        """What to look at when the other side does not answer."""
        if not (self._keyring and self._server_key):
            return ""
        ours, theirs = fingerprint(self.public_key), fingerprint(self._server_key)
        return f"; is this computer ({ours}) paired there, and is the agent's key {theirs}?"

    def router(self, endpoint: str) -> tuple[zmq.Socket, str]:
        """A bound ROUTER and the address it got. Raises as :meth:`publisher`."""
        socket = self._bound(zmq.ROUTER)
        socket.setsockopt(zmq.ROUTER_MANDATORY, 1)
        return socket, self._bind(socket, endpoint)

    def publisher(self, endpoint: str) -> tuple[zmq.Socket, str]:
        """A bound PUB and the address it got.

        Raises:
            FailureError: ``ENDPOINT_NEEDS_KEYS`` or ``ENDPOINT_UNAVAILABLE``; or what is wrong with the keys.
        """
        socket = self._bound(zmq.PUB)
        return socket, self._bind(socket, endpoint)

    def dealer(self, endpoint: str) -> zmq.Socket:
        """A DEALER that connects when it can. Raises as :meth:`publisher`, which includes what is no address."""
        return self._connect(self._connecting(zmq.DEALER), endpoint)

    def subscriber(self, endpoint: str) -> zmq.Socket:
        """A SUB that keeps only the newest frame. Raises as :meth:`dealer`."""
        socket = self._connecting(zmq.SUB)
        socket.setsockopt(zmq.CONFLATE, 1)  # before connect, or it does nothing
        socket.setsockopt(zmq.SUBSCRIBE, b"")
        return self._connect(socket, endpoint)

    def watch(self, died: Callable[[], None]) -> None:
        """Call ``died`` if the thread that judges handshakes ends by itself. Nobody gets in after that anyway."""
        if self._authenticator is not None:
            self._authenticator.mourn(died)

    def close(self) -> None:
        """Let nobody in any more; only when all that was bound here is closed. Harmless when closed."""
        if self._authenticator is not None:
            self._authenticator.close()
            self._authenticator = None
            self._guarded_context.destroy(linger=0)

    @cached_property
    def _guarded_context(self) -> zmq.Context:
        # Of its own, because a context has one authenticator for all its sockets.
        return zmq.Context()

    def _bound(self, kind: int) -> zmq.Socket:
        if self._keyring is None:
            return _make(zmq.Context.instance(), kind)
        own, keyring = self._keyring.own, self._keyring
        if self._authenticator is None:  # before anything is bound that it has to guard
            judge = _make(self._guarded_context, zmq.ROUTER)
            self._authenticator = Authenticator(judge, lambda key: keyring.role_of(key) is not None)
        socket = _make(self._guarded_context, kind)
        socket.setsockopt(zmq.ZAP_DOMAIN, DOMAIN)
        socket.setsockopt(zmq.CURVE_SECRETKEY, own.secret)
        socket.setsockopt(zmq.CURVE_SERVER, 1)
        return socket

    def _connecting(self, kind: int) -> zmq.Socket:
        socket = _make(zmq.Context.instance(), kind)
        if self._keyring is not None and self._server_key:
            own = self._keyring.own
            socket.setsockopt(zmq.CURVE_SERVERKEY, bytes.fromhex(self._server_key))
            socket.setsockopt(zmq.CURVE_PUBLICKEY, bytes.fromhex(own.public))
            socket.setsockopt(zmq.CURVE_SECRETKEY, own.secret)
        return socket

    def _bind(self, socket: zmq.Socket, endpoint: str) -> str:
        _require_guarded(
            socket, endpoint, "give the agent a folder of keys (--keys DIR) and pair those who may come in"
        )
        try:
            socket.bind(endpoint)
        except zmq.ZMQError as error:
            socket.close()
            raise FailureError(
                "ENDPOINT_UNAVAILABLE", f"cannot listen on {endpoint}: {error.strerror}", endpoint=endpoint
            ) from error
        found = socket.get_string(zmq.LAST_ENDPOINT).rstrip("\0")
        _require_guarded(socket, found, f"{endpoint} is not this machine's alone")  # a name may mean anything
        return found

    def _connect(self, socket: zmq.Socket, endpoint: str) -> zmq.Socket:
        _require_guarded(
            socket, endpoint, "set server_key to what `mission keys` prints on the agent's computer, and pair this one"
        )
        try:
            socket.connect(endpoint)
        except zmq.ZMQError as error:
            socket.close()
            raise FailureError(
                "ENDPOINT_UNAVAILABLE", f"cannot connect to {endpoint}: {error.strerror}", endpoint=endpoint
            ) from error
        return socket


def _make(context: zmq.Context, kind: int) -> zmq.Socket:
    socket: zmq.Socket = context.socket(kind)
    for option, value in _LIMITS.items():
        socket.setsockopt(option, value)
    return socket


def _require_guarded(socket: zmq.Socket, endpoint: str, remedy: str) -> None:
    """The last look before a socket meets the world; closes one that others could reach unproved."""
    if socket.getsockopt(zmq.MECHANISM) == zmq.CURVE or is_local(endpoint):
        return
    socket.close()
    raise FailureError(
        "ENDPOINT_NEEDS_KEYS",
        f"{endpoint} is open to other machines, and without keys anybody could command the robot: {remedy}",
        endpoint=endpoint,
    )
