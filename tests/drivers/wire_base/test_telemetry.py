"""What a base says by itself: only the newest is known, through restarts and garbage."""

import time

import numpy as np

from drivers.agent import base_agent
from drivers.messages import PROTOCOL, Pose, Telemetry
from drivers.wire.base_client import BaseClient
from drivers.wire.codec import encode
from drivers.wire.sockets import Sockets
from drivers.wire.telemetry import Listener
from perception import transforms
from tests.drivers.wire_fakes import ANY_PORT, ANYWHERE, QUICK, FakeBase, eventually, restarted


def test_the_newest_telemetry_is_known_with_its_age(device, agent, client):
    eventually(lambda: client.state() is not None)
    state = client.state()
    np.testing.assert_allclose(state.odom_from_base, device.pose, atol=1e-12)
    assert (state.map_from_base, state.moving, state.battery, state.activity) == (None, False, 0.75, "idle")
    device.pose = transforms.planar(3.0, 0.0, 0.0)
    eventually(lambda: np.allclose(client.state().odom_from_base, device.pose))
    assert client.state().age < 5.0
    agent.close()
    eventually(lambda: client.state().age >= 0.3)


def test_telemetry_goes_on_after_a_restart_of_the_agent(device, agent, client):
    eventually(lambda: client.state() is not None)
    agent.close()
    second = FakeBase()
    second.in_map = transforms.planar(9.0, 9.0, 0.0)
    with restarted(lambda: base_agent(second, agent.endpoints)):
        eventually(lambda: client.state().map_from_base is not None)


def test_a_device_that_cannot_tell_its_state_once_is_asked_again(device, agent, client):
    telemetry, device.telemetry = device.telemetry, lambda: 1 / 0
    with base_agent(device, ANYWHERE) as second:
        patient = BaseClient(second.endpoints, QUICK)
        time.sleep(0.2)
        assert patient.state() is None
        patient.close()
    device.telemetry = telemetry
    eventually(lambda: client.state() is not None)


def test_old_and_garbled_telemetry_is_ignored():
    heard, frames_heard = [], []

    class NotingListener(Listener):
        def _accept(self, frame: bytes) -> None:
            super()._accept(frame)
            heard.append(self.state().battery)
            frames_heard.append(frame)

    publisher, endpoint = Sockets().publisher(ANY_PORT)
    listener = NotingListener(Sockets().subscriber(endpoint))

    def message(boot: str, sequence: int, battery: float) -> bytes:
        pose = Pose.of(np.eye(4))
        return encode(Telemetry(PROTOCOL, boot, sequence, 1.0, pose, None, False, False, battery, "idle", 7, ""))

    def publish_until(battery: float, frame: bytes) -> None:
        eventually(lambda: publisher.send(frame) or ((s := listener.state()) and s.battery == battery))

    def publish(*frames: bytes, last: float) -> None:
        """Each is said until it has been heard, for the socket keeps only the newest, and may hold that one back."""
        for frame in frames:
            eventually(lambda frame=frame: publisher.send(frame) or frames_heard[-1] == frame)
        assert heard[-1] == last

    with publisher:
        publish_until(0.5, message("a", 7, 0.5))
        bad = (message("a", 6, 0.1), b"\xc1", message("a", 8, 0.1)[:-4])
        publish(*bad, message("a", 8, 0.4), last=0.4)
        publish(message("b", 1, 0.3), last=0.3)
        publish(message("a", 9, 0.2), message("b", 2, 0.6), last=0.6)
        assert 0.1 not in heard, "old or garbled"
        assert 0.2 not in heard, "nobody hears of a process that another has followed"
        assert (listener.state().odom_frame, listener.has_heard("a", 5.0)) == ("b", True)
        assert (listener.has_heard("b", 1.0), listener.has_heard("b", 1.1)) == (True, False)
        listener.close()
