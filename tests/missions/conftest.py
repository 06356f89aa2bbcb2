"""One whole mission, shared by the tests that look at what it left."""

import pytest

from tests.missions.flights import ENOUGH, TWO_ROOMS, Flight, landed, simulate


@pytest.fixture(scope="session")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    """Two rooms and the door between them, scanned without a hand."""
    folder = tmp_path_factory.mktemp("flown")
    return landed(simulate(TWO_ROOMS, folder, f"--set={ENOUGH}"), folder)
