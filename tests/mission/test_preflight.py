"""Go or no-go: every reason at once."""

import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from behaviours.settings import BatterySettings, DrivingSettings, ScanningSettings, Settings
from drivers.interfaces import BaseInfo, ScannerInfo
from drivers.wire.endpoints import Endpoints
from mission import preflight
from mission.config import SiteConfig
from mission.preflight import NoGoError, UnreachableError, inspect, lease
from perception.failure import Failure
from tests.behaviours.bench import HandJob, standing
from tests.mission.test_operator import Notes

SCANNER, BASE = ScannerInfo("vz-400", "S1", 1), BaseInfo("guardian", "B1", 1, (0.9, 0.6))


def site(settings: Settings | None = None, serial: str = "") -> SiteConfig:
    here = Endpoints("ipc:///nowhere", "ipc:///nowhere", "ipc:///nowhere", serial=serial)
    return SiteConfig(site="lab", scanner=here, base=Endpoints("ipc:///nowhere"), settings=settings or Settings())


def against(config: SiteConfig, state: Any = None, base: Any = BASE) -> list[str]:
    findings = inspect(config, SCANNER, base, state or standing(), Path())
    return [finding.what for finding in findings if not finding.good]


def test_nothing_speaks_against_a_mission_where_all_is_well() -> None:
    assert against(site()) == []


@pytest.mark.parametrize(
    ("settings", "what"),
    [
        (Settings(battery=BatterySettings(low=0.9)), ["settings.battery"]),
        (Settings(driving=DrivingSettings(path_clearance_m=0.29)), ["settings.driving.path_clearance_m"]),
        (Settings(driving=DrivingSettings(goal_clearance_m=0.53)), ["settings.driving.goal_clearance_m"]),
        (Settings(scanning=ScanningSettings(step_deg=0.01)), ["settings.scanning.step_deg", "disk for the scans"]),
    ],
)
def test_settings_that_do_not_fit_are_named(settings: Settings, what: list[str]) -> None:
    assert against(site(settings), standing(battery=1.0)) == what


@pytest.mark.parametrize(
    ("telemetry", "what"),
    [({"battery": 0.2}, "battery"), ({"emergency_stop": True}, "emergency stop"), ({"moving": True}, "at rest")],
)
def test_a_base_that_is_not_fit_is_named(telemetry: dict[str, Any], what: str) -> None:
    assert against(site(), standing(**telemetry)) == [what]


def test_another_scanner_than_the_sites_is_refused() -> None:
    assert against(site(serial="S1")) == []
    assert against(site(serial="S2")) == ["scanner"]


def test_a_base_with_an_owner_is_not_free() -> None:
    assert [finding.good for finding in lease(standing(owner="bob"))] == [False]
    assert [finding.good for finding in lease(standing())] == [True]


def test_a_disk_without_room_for_the_planned_scans_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=1.1e9))
    assert against(site()) == ["disk for the scans"]
    assert against(site(replace(Settings(), scanning=ScanningSettings(planned=1)))) == []


def done(value: object) -> HandJob:
    job = HandJob()
    job.done(value)
    return job


def failed(code: str) -> HandJob:
    job = HandJob()
    job.failed(code)
    return job


def look(scanner: HandJob, base: HandJob, state: object = None, config: SiteConfig | None = None) -> Notes:
    notes = Notes()
    devices = SimpleNamespace(info=lambda: scanner), SimpleNamespace(info=lambda: base, state=lambda: state)
    preflight.preflight(config or site(), *devices, notes, Path())  # type: ignore[arg-type]
    return notes


def test_both_agents_are_on_record_before_anything_moves() -> None:
    events = [event for event in look(done(SCANNER), done(BASE), standing()) if event["kind"] == "agent"]
    assert [(event["name"], event["model"], event["serial"]) for event in events] == [
        ("scanner", "vz-400", "S1"),
        ("base", "guardian", "B1"),
    ]


def test_every_reason_against_a_start_is_told_at_once() -> None:
    config = site(Settings(battery=BatterySettings(low=0.9, charged=0.95)), serial="S9")
    with pytest.raises(NoGoError, match=r"(?s)scanner: .*S9.*battery: 80%.*emergency stop: pressed") as refused:
        look(done(SCANNER), done(BASE), standing(battery=0.8, emergency_stop=True), config)
    assert not isinstance(refused.value, UnreachableError)


def test_everybody_who_does_not_answer_is_named() -> None:
    with pytest.raises(UnreachableError, match=r"scanner: AGENT_UNREACHABLE.*; base: PROTOCOL_MISMATCH"):
        look(failed("AGENT_UNREACHABLE"), failed("PROTOCOL_MISMATCH"), standing())


def test_a_base_that_answers_but_tells_nothing_is_unreachable(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(preflight.meet, "__defaults__", (0.1,))
    with pytest.raises(UnreachableError, match="base: BASE_LOST: no telemetry"):
        look(done(SCANNER), done(BASE), None)


def test_two_silent_agents_are_both_asked_before_either_is_waited_for() -> None:
    asked: list[str] = []

    class Silent(HandJob):
        def poll(self) -> Any:
            assert asked == ["scanner", "base"]
            return super().poll()

    def ask(name: str) -> Silent:
        asked.append(name)
        return Silent()

    scanner = SimpleNamespace(info=lambda: ask("scanner"))
    base = SimpleNamespace(info=lambda: ask("base"), state=lambda: None)
    found = preflight.meet(scanner, base, 0.05)  # type: ignore[arg-type]
    assert all(isinstance(answer, Failure) for answer in found)
