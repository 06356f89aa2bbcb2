"""The simulated base's battery."""

import pytest

from drivers.simulated.battery import Battery


def test_it_lasts_a_working_day_away_from_the_charger() -> None:
    battery = Battery(1.0, (0.0, 0.0))
    for _ in range(4 * 60):
        battery.step(60.0, (5.0, 0.0), moving=False)
    assert battery.charge == pytest.approx(0.5)
    for _ in range(5 * 60):
        battery.step(60.0, (5.0, 0.0), moving=True)
    assert battery.charge == 0.0


def test_it_charges_at_the_start_and_only_at_rest() -> None:
    battery = Battery(0.2, (1.0, 2.0))
    battery.step(60.0, (1.3, 2.0), moving=True)
    assert battery.charge < 0.2
    for _ in range(60):
        battery.step(60.0, (1.3, 2.0), moving=False)
    assert battery.charge == 1.0
