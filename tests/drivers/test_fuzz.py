"""Garbage, in small: no mutated frame and no raw connection does harm. ``benchmarks.fuzz`` is the same at length."""

import gc

import pytest

from drivers.agent import base_agent
from drivers.messages import MAX_MESSAGE
from drivers.wire.keys import Keyring
from drivers.wire.roles import Role
from drivers.wire.sockets import Sockets
from tests.drivers import wire_samples
from tests.drivers.fuzzing import CODECS, HELD, mutated_frames, open_files, read_all_ways, resident, round_trip, storm
from tests.drivers.wire_fakes import ANYWHERE, FakeBase, eventually

MEGABYTE = 1 << 20


def test_good_frames_are_read_by_the_codec_they_are_for():
    assert all(read_all_ways(frame) >= 1 for frame in wire_samples.frames())


def test_mutated_frames_are_read_or_refused_and_cost_no_memory():
    for frame in mutated_frames(1, 3000):
        read_all_ways(frame)
    gc.collect()
    before, taken, asked = resident(), 0, 0
    for frame in mutated_frames(2, 20_000):
        taken += read_all_ways(frame)
        asked += len(CODECS)
    gc.collect()
    assert 0 < taken < asked / 2  # else the mutations are too wild or too tame to find anything
    assert resident() - before < 5 * MEGABYTE


@pytest.mark.parametrize("size", [MAX_MESSAGE - 1, MAX_MESSAGE, MAX_MESSAGE + 1, 4 * MAX_MESSAGE])
@pytest.mark.parametrize("filler", [b"\x91", b"\x81", b"\xc0", b"\xa1", b"\xdd\xff"])
def test_frames_of_any_size_are_refused(size, filler):
    assert read_all_ways(filler * (size // len(filler))) == 0


@pytest.mark.parametrize("guarded", [False, True], ids=["plain", "with keys"])
def test_raw_connections_do_not_keep_a_good_client_waiting_or_files_open(guarded, tmp_path):
    keyring, friend = (Keyring(tmp_path / "agent"), Keyring(tmp_path / "friend")) if guarded else (None, None)
    if keyring is not None and friend is not None:
        keyring.authorise(friend.own.public, Role.OBSERVER, "friend")
    device = FakeBase()
    with base_agent(device, ANYWHERE, keyring) as agent:
        sockets = Sockets(friend, agent.endpoints.server_key)
        with sockets.dealer(agent.endpoints.control) as good:
            round_trip(good)
            files, waits = open_files(), []
            for number in storm(agent.endpoints.control, 5, 200):
                if number % 20 == 19:
                    waits.append(round_trip(good))
                    with sockets.dealer(agent.endpoints.control) as newcomer:
                        round_trip(newcomer)
            assert sorted(waits)[len(waits) // 2] < 0.5
            assert open_files() <= files + 2 * HELD + 20
            eventually(lambda: open_files() <= files + 2)
    assert device.driven == [] and device.asked == []
