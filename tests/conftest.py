"""What every test starts from."""

import gc
import signal
from collections.abc import Iterator

import hypothesis
import pytest
from py_trees.blackboard import Blackboard

# A busy machine is no failure: what takes long is measured in benchmarks.
hypothesis.settings.register_profile("any machine", deadline=None)
hypothesis.settings.load_profile("any machine")


def pytest_collection_finish() -> None:
    """What the imports made stays to the end: looking through all of it again and again would take minutes."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(20_000)


def pytest_unconfigure() -> None:
    """Whatever Open3D has made must be gone at the exit, or it makes an error of it."""
    gc.unfreeze()


@pytest.fixture(autouse=True)
def same_signals() -> Iterator[None]:
    """A mission that has ended leaves its process deaf, and whatever that starts; a test's process goes on."""
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    yield
    for number, handler in before.items():
        if signal.getsignal(number) is not handler:
            signal.signal(number, handler)


@pytest.fixture(autouse=True)
def clean_blackboard() -> Iterator[None]:
    """The blackboard is global to the process: no test sees what another one left on it."""
    Blackboard.clear()
    yield
    Blackboard.clear()
