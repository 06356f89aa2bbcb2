"""Go or no-go: every reason at once."""

import shutil
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from behaviours.settings import BatterySettings, DrivingSettings, ScanningSettings, Settings
from drivers.interfaces import BaseInfo, ClockOffset, ScannerInfo, SelfTest
from drivers.wire.endpoints import Endpoints
from mission import preflight
from mission.config import SiteConfig
from mission.display import line_of
from mission.finding import Finding
from mission.preflight import Answers, NoGoError, UnreachableError, inspect, lease
from perception.failure import Failure
from tests.behaviours.bench import HandJob, standing
from tests.mission.test_operator import Notes

SCANNER, BASE = ScannerInfo("vz-400", "S1", 1), BaseInfo("guardian", "B1", 1, (0.9, 0.6))
FIT = SelfTest((), {"temperature_c": 31.0})


def site(settings: Settings | None = None, serial: str = "") -> SiteConfig:
    here = Endpoints("ipc:///nowhere", "ipc:///nowhere", "ipc:///nowhere", serial=serial)
    return SiteConfig(site="lab", scanner=here, base=replace(here, serial=""), settings=settings or Settings())


def findings(config: SiteConfig, **answers: Any) -> list[Finding]:
    """What is found where the agents answer so, and as all is well where nothing is said."""
    return inspect(
        config, Answers(**{"scanner": SCANNER, "base": BASE, "state": standing(), "self_test": FIT} | answers), Path()
    )


def against(config: SiteConfig, **answers: Any) -> list[str]:
    return [finding.what for finding in findings(config, **answers) if not finding.good]


def test_nothing_speaks_against_a_mission_where_all_is_well() -> None:
    assert against(site()) == []
    assert not any(finding.doubtful for finding in findings(site()))


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
    assert against(site(settings), state=standing(battery=1.0)) == what


@pytest.mark.parametrize(
    ("telemetry", "what"),
    [({"battery": 0.2}, "battery"), ({"emergency_stop": True}, "emergency stop"), ({"moving": True}, "at rest")],
)
def test_a_base_that_is_not_fit_is_named(telemetry: dict[str, Any], what: str) -> None:
    assert against(site(), state=standing(**telemetry)) == [what]


@pytest.mark.parametrize(
    ("battery", "taken", "what"), [(0.2, None, ["battery"]), (0.2, 3, []), (0.09, 3, ["battery"]), (0.2, 0, [])]
)
def test_a_mission_that_is_taken_up_needs_charge_for_the_way_home_only(
    battery: float, taken: int | None, what: list[str]
) -> None:
    met = Answers(SCANNER, BASE, standing(battery=battery), FIT)
    assert [finding.what for finding in inspect(site(), met, Path(), taken) if not finding.good] == what


def test_there_must_be_room_for_the_scans_that_are_still_to_be_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    met = Answers(SCANNER, BASE, standing(), FIT)

    def words(taken: int | None, config: SiteConfig) -> str:
        return next(finding.found for finding in inspect(config, met, Path(), taken) if "disk" in finding.what)

    assert words(None, site()).endswith("for 40 scans")
    assert words(30, site()).endswith("for 10 scans")
    assert words(99, site()).endswith("for 1 scans")
    monkeypatch.setattr(shutil, "disk_usage", lambda _: SimpleNamespace(free=20e9))
    greedy = site(Settings(scanning=ScanningSettings(planned=1, min_free_gb=20.0)))
    assert against(greedy) == ["disk for the scans"], "it would hold with its first tick"


def test_another_scanner_than_the_sites_is_refused() -> None:
    assert against(site(serial="S1")) == []
    assert against(site(serial="S2")) == ["scanner"]


@pytest.mark.parametrize(
    ("offset", "good", "doubtful"),
    [
        (ClockOffset(0.09, 0.001), True, False),
        (ClockOffset(-0.5, 0.01), True, True),
        (ClockOffset(1.1, 0.01), False, True),
        (ClockOffset(-3600.0, 0.01), False, True),
        (ClockOffset(1.1, 0.2), True, True),
        (ClockOffset(3.0, 3.0), True, False),
    ],
)
@pytest.mark.parametrize("name", ["scanner", "base"])
def test_a_clock_is_judged_by_what_is_certain_of_its_offset(
    name: str, offset: ClockOffset, good: bool, doubtful: bool
) -> None:
    agent = {"scanner": replace(SCANNER, clock=offset), "base": replace(BASE, clock=offset)}[name]
    (found,) = [finding for finding in findings(site(), **{name: agent}) if finding.what == f"{name}'s clock"]
    assert (found.good, found.doubtful) == (good, doubtful)
    assert ("chrony" in found.found) == doubtful


def test_a_scanner_that_is_not_fit_is_named_with_every_complaint_and_its_figures() -> None:
    unfit = SelfTest(("the mirror does not reach its speed", "too hot"), {"temperature_c": 71.5})
    (found,) = [finding for finding in findings(site(), self_test=unfit) if not finding.good]
    assert found.what == "scanner's self-test"
    for words in ("the mirror does not reach its speed", "too hot", "temperature_c 71.5", "look again"):
        assert words in found.found


def test_a_scanner_that_cannot_tell_is_not_fit() -> None:
    assert against(site(), self_test=Failure("AGENT_EXCEPTION", "no monitor")) == ["scanner's self-test"]
    silent = Failure("AGENT_UNREACHABLE", "no answer")
    assert against(site(), scanner=silent, self_test=silent) == ["scanner"]


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


def look(
    scanner: HandJob,
    base: HandJob,
    state: object = None,
    config: SiteConfig | None = None,
    self_test: SelfTest = FIT,
) -> Notes:
    notes = Notes()
    tested = done(self_test)
    devices = (
        SimpleNamespace(info=lambda: scanner, self_test=lambda: tested),
        SimpleNamespace(info=lambda: base, state=lambda: state),
    )
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
    reasons = r"(?s)scanner: .*S9.*scanner's self-test: too hot.*battery: 80%.*emergency stop: pressed"
    with pytest.raises(NoGoError, match=reasons) as refused:
        look(done(SCANNER), done(BASE), standing(battery=0.8, emergency_stop=True), config, SelfTest(("too hot",)))
    assert not isinstance(refused.value, UnreachableError)


def test_a_doubt_does_not_keep_a_mission_from_starting_but_is_told() -> None:
    late = replace(SCANNER, clock=ClockOffset(-0.4, 0.001))
    (doubts,) = [event for event in look(done(late), done(BASE), standing()) if event["kind"] == "doubts"]
    assert "scanner's clock: -0.400 s" in doubts["words"]
    assert "chrony" in line_of(doubts)


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
            assert asked == ["scanner", "base", "self-test"]
            return super().poll()

    def ask(name: str) -> Silent:
        asked.append(name)
        return Silent()

    scanner = SimpleNamespace(info=lambda: ask("scanner"), self_test=lambda: ask("self-test"))
    base = SimpleNamespace(info=lambda: ask("base"), state=lambda: None)
    found = preflight.meet(scanner, base, 0.05)  # type: ignore[arg-type]
    assert all(isinstance(answer, Failure) for answer in vars(found).values())
