"""What every test starts from."""

from collections.abc import Iterator

import pytest
from py_trees.blackboard import Blackboard


@pytest.fixture(autouse=True)
def clean_blackboard() -> Iterator[None]:
    """The blackboard is global to the process: no test sees what another one left on it."""
    Blackboard.clear()
    yield
    Blackboard.clear()
