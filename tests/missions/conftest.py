"""Missions that several tests look at, and one that only waits."""

from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor

import pytest

from tests.missions.flights import ENOUGH, TWO_ROOMS, Flight, landed, mission, simulate, write_site_of_nobody


@pytest.fixture(scope="session", autouse=True)
def unanswered(tmp_path_factory: pytest.TempPathFactory) -> Iterator["Future[Flight]"]:
    """``mission run`` at a site without agents. It does nothing but wait, so the others fly meanwhile."""
    folder = tmp_path_factory.mktemp("unanswered")
    site = write_site_of_nobody(folder)
    with ThreadPoolExecutor(1) as pool:
        yield pool.submit(lambda: landed(mission("run", site, f"--out={folder / 'runs'}", "--json"), folder))


@pytest.fixture(scope="session")
def flown(tmp_path_factory: pytest.TempPathFactory) -> Flight:
    """Two rooms and the door between them, scanned without a hand."""
    folder = tmp_path_factory.mktemp("flown")
    return landed(simulate(TWO_ROOMS, folder, f"--set={ENOUGH}"), folder)
