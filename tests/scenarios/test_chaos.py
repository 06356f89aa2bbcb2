"""Links that lose, repeat, hold up and swap messages: the mission over them is the one over good links."""

import threading
from pathlib import Path

import numpy as np
import pytest

from drivers.agent import scanner_agent
from drivers.interfaces import ScanReceipt
from drivers.wire.endpoints import Endpoints
from drivers.wire.scanner_client import ScannerClient
from tests.drivers.chaos_link import NONE, ChaosLink, Mischief
from tests.drivers.wire_fakes import ANYWHERE, IMPATIENT, QUICK, SETTINGS, FakeScanner, eventually, failure_of, value_of
from tests.scenarios.wired import Flown, fly

pytestmark = pytest.mark.xdist_group("chaos")
"""Its fixture is a whole mission: one process flies it for all."""

SEED = "0"


@pytest.fixture(scope="module")
def clean(tmp_path_factory: pytest.TempPathFactory) -> Flown:
    return fly(tmp_path_factory.mktemp("clean"))


def test_a_mission_over_bad_links_is_the_mission_over_good_ones(clean: Flown, tmp_path: Path) -> None:
    """Other seeds: ``python -m benchmarks.chaos --missions 1 --seed SEED``."""
    flown = fly(tmp_path, SEED, Mischief())
    assert flown.result == clean.result
    assert flown.twice == []
    assert set(flown.executed) == set(clean.executed)
    assert {"drop", "duplicate", "delay", "reorder", "hold"} <= set(flown.befell)


def test_the_clean_mission_is_a_whole_one(clean: Flown) -> None:
    outcome, survey, goals = clean.result
    assert outcome == "complete"
    assert len(survey["scans"]) == 4
    assert len(goals) == 4
    assert set(clean.befell) == {"pass"}


def test_a_link_that_is_cut_and_comes_back_costs_time_and_nothing_else(tmp_path: Path) -> None:
    device = FakeScanner(duration=0.4)
    with (
        scanner_agent(device, ANYWHERE, tmp_path / "spool") as agent,
        ChaosLink(agent.endpoints.control, "cut", NONE) as control,
        ChaosLink(agent.endpoints.bulk, "cut", NONE) as bulk,
    ):
        scanner = ScannerClient(Endpoints(control.endpoint, bulk=bulk.endpoint), QUICK)
        value_of(scanner.info())
        job = scanner.take("S01", SETTINGS, np.eye(4))
        eventually(lambda: device.started)
        control.cut()
        threading.Timer(0.6, control.heal).start()
        receipt: ScanReceipt = value_of(job)
        bulk.cut()
        threading.Timer(0.6, bulk.heal).start()
        assert value_of(scanner.fetch(receipt, tmp_path / "S01.scan")).exists()
    assert device.started == ["S01"]


def test_a_link_that_stays_cut_is_called_unreachable(tmp_path: Path) -> None:
    with (
        scanner_agent(FakeScanner(), ANYWHERE, tmp_path / "spool") as agent,
        ChaosLink(agent.endpoints.control, "cut", NONE) as control,
    ):
        control.cut()
        scanner = ScannerClient(Endpoints(control.endpoint, bulk=agent.endpoints.bulk), IMPATIENT)
        assert failure_of(scanner.info()).code == "AGENT_UNREACHABLE"
