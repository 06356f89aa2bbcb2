"""A base behind its agent, and a client that owns it."""

import pytest

from drivers.agent import base_agent
from tests.drivers.wire_fakes import ANYWHERE, FakeBase
from tests.drivers.wire_talk import owner


@pytest.fixture
def device() -> FakeBase:
    return FakeBase()


@pytest.fixture
def agent(device):
    with base_agent(device, ANYWHERE) as agent:
        yield agent


@pytest.fixture
def client(agent):
    client = owner(agent.endpoints)
    yield client
    client.close()
