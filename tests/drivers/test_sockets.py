"""Where a socket may be bound or connected to, and how it is guarded there."""

import pytest
import zmq

from drivers.messages import MAX_MESSAGE
from drivers.wire.endpoints import is_local
from drivers.wire.keys import Keyring
from drivers.wire.sockets import Sockets
from perception.failure import FailureError
from tests.drivers.wire_fakes import ANY_PORT

REMOTE = ["tcp://192.0.2.1:5601", "tcp://robot.example:5601", "tcp://0.0.0.0:5601", "tcp://*:5601", "tcp://eth0:5601"]
TRICKS = ["tcp://192.0.2.1:1;127.0.0.1:5601", "tcp://127.0.0.1:0;192.0.2.1:5601", "tcp://localhost.example:5601"]
TRICKS += ["tcp://127.0.0.1.example:1", "udp://127.0.0.1:5601", "vmci://127.0.0.1:5601", "127.0.0.1:5601", "tcp://", ""]


@pytest.mark.parametrize("endpoint", [*REMOTE, *TRICKS])
def test_what_others_may_reach_is_not_local(endpoint):
    assert not is_local(endpoint)


@pytest.mark.parametrize("endpoint", ["tcp://127.0.0.1:1", "tcp://[::1]:1", "tcp://localhost:1", "ipc:///tmp/x"])
def test_what_only_this_machine_reaches_is_local(endpoint):
    assert is_local(endpoint)


@pytest.mark.parametrize("make", ["router", "publisher", "dealer", "subscriber"])
@pytest.mark.parametrize("endpoint", [*REMOTE, *TRICKS])
def test_plain_sockets_stay_on_this_machine(make, endpoint):
    with pytest.raises(FailureError, match=r"ENDPOINT_NEEDS_KEYS.*(--keys|server_key)"):
        getattr(Sockets(), make)(endpoint)


@pytest.mark.parametrize("make", ["dealer", "subscriber"])
def test_keys_alone_are_not_enough_to_connect_the_agents_must_be_known(make, tmp_path):
    with pytest.raises(FailureError, match="ENDPOINT_NEEDS_KEYS"):
        getattr(Sockets(Keyring(tmp_path)), make)(REMOTE[0])


def test_a_name_that_turns_out_to_be_open_to_others_is_not_kept(monkeypatch):
    monkeypatch.setattr("drivers.wire.sockets.is_local", lambda endpoint: "0.0.0.0" not in endpoint)
    with pytest.raises(FailureError, match="ENDPOINT_NEEDS_KEYS"):
        Sockets().router("tcp://*:*")


def test_with_keys_every_socket_proves_who_is_at_its_ends(tmp_path):
    agent = Sockets(Keyring(tmp_path / "agent"))
    made = [agent.router(ANY_PORT)[0], agent.publisher(ANY_PORT)[0]]
    client = Sockets(Keyring(tmp_path / "client"), agent.public_key)
    made += [client.dealer(REMOTE[0]), client.subscriber(REMOTE[0])]
    assert [socket.getsockopt(zmq.MECHANISM) for socket in made] == [zmq.CURVE] * 4
    assert [socket.getsockopt(zmq.CURVE_SERVER) for socket in made] == [1, 1, 0, 0]
    for socket in made:
        assert socket.getsockopt(zmq.MAXMSGSIZE) == MAX_MESSAGE
        assert socket.getsockopt(zmq.HANDSHAKE_IVL) == 2000
        socket.close()
    agent.close()
    agent.close()


def test_exposed_keys_are_not_used_to_listen(tmp_path):
    Keyring(tmp_path / "keys").own  # noqa: B018 - made by being asked for
    (tmp_path / "keys").chmod(0o755)
    with pytest.raises(FailureError, match="KEYS_EXPOSED"):
        Sockets(Keyring(tmp_path / "keys")).router(ANY_PORT)
