"""Go or no-go: what is looked at before a mission moves anything, and every reason against it at once."""

import math
import shutil
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path

from behaviours.services import Journal
from behaviours.settings import Settings
from drivers.interfaces import Base, BaseInfo, BaseState, ClockOffset, Scanner, ScannerInfo, SelfTest
from drivers.jobs import wait_for
from mission.config import SiteConfig
from mission.finding import Finding
from perception.failure import Failure

PATIENCE_S = 30.0
_BYTES_A_BEAM = 40
"""Of a scan in all its forms: as fetched, voxels and evidence, and in the deliveries."""
_SPARE_BYTES = 1e9
_FIELD_OF_VIEW = math.radians(360) * math.radians(100)
_MOST_BEAMS = 150e6
CLOCK_DOUBT_S, CLOCK_LIMIT_S = 0.1, 1.0
"""Scans carry the time of the scanner's clock, and the three logs are read side by side."""


@dataclass(frozen=True)
class Answers:
    """What each agent said when it was met, or why it said nothing."""

    scanner: ScannerInfo | Failure
    base: BaseInfo | Failure
    state: BaseState | Failure
    self_test: SelfTest | Failure


class NoGoError(Exception):
    """The mission must not start; the message has every reason."""


class UnreachableError(NoGoError):
    """An agent did not answer, or the base is somebody else's."""


def preflight(
    config: SiteConfig, scanner: Scanner, base: Base, journal: Journal, folder: Path, taken: int | None = None
) -> None:
    """Look at everything; put it on record.

    Args:
        taken: scans that a mission has already which is taken up again; None for one that begins.

    Raises:
        UnreachableError: when an agent does not answer.
        NoGoError: when anything else is amiss.
    """
    met = meet(scanner, base)
    needed = (("scanner", met.scanner), ("base", met.base), ("base", met.state))
    silent = [f"{name}: {answer}" for name, answer in needed if isinstance(answer, Failure)]
    if silent:
        raise UnreachableError("; ".join(silent))
    findings = inspect(config, met, folder, taken)
    journal.record("preflight", findings=[asdict(finding) for finding in findings])
    for name, info in (("scanner", met.scanner), ("base", met.base)):
        assert isinstance(info, ScannerInfo | BaseInfo)
        journal.record("agent", name=name, model=info.model, serial=info.serial, protocol=info.protocol)
    doubts = [f"{finding.what}: {finding.found}" for finding in findings if finding.good and finding.doubtful]
    if doubts:
        journal.record("doubts", words="; ".join(doubts))
    against = [f"{finding.what}: {finding.found}" for finding in findings if not finding.good]
    if against:
        raise NoGoError("\n".join(against))


def meet(scanner: Scanner, base: Base, patience_s: float = PATIENCE_S) -> Answers:
    """Who the agents are, the scanner's self-test, and the base's first telemetry."""
    # All are asked before any is waited for: two silent agents cost no more patience than one.
    scanner_says, base_says, test_says = scanner.info(), base.info(), scanner.self_test()
    scanner_is, base_is = wait_for(scanner_says, patience_s), wait_for(base_says, patience_s)
    # Whoever said who it is says the rest at once; of the others nothing more is waited for.
    self_test = wait_for(test_says, 0.0 if isinstance(scanner_is, Failure) else patience_s)
    silent = isinstance(scanner_is, Failure) or isinstance(base_is, Failure)
    return Answers(scanner_is, base_is, _telemetry(base, 0.0 if silent else patience_s), self_test)


def inspect(config: SiteConfig, met: Answers, folder: Path, taken: int | None = None) -> list[Finding]:
    """Everything that speaks for or against a start.

    Args:
        met: as :func:`meet` gives it.
        folder: where the run folder is, or will be.
        taken: see :func:`preflight`. What is under way needs no more charge than it takes to go home for more, and room
            for the rest of its scans.
    """
    battery = config.settings.battery
    return [
        *_agent("scanner", met.scanner, config.scanner.serial),
        *([] if isinstance(met.scanner, Failure) else [_self_test(met.self_test)]),
        *_agent("base", met.base, config.base.serial),
        *_condition(battery.low if taken is None else battery.critical, met.state),
        *_settings(config.settings),
        *([] if isinstance(met.base, Failure) else _clearances(config.settings, met.base)),
        _disk(config.settings, folder, max(1, config.settings.scanning.planned - (taken or 0))),
    ]


def lease(state: BaseState | Failure) -> Iterator[Finding]:
    """Whether the base is free; a mission that starts waits a little for an owner who died, so it asks the base."""
    if not isinstance(state, Failure):
        yield Finding("lease", not state.owner, f"held by {state.owner}" if state.owner else "free")


def _agent(name: str, info: ScannerInfo | BaseInfo | Failure, serial: str) -> Iterator[Finding]:
    if isinstance(info, Failure):
        yield Finding(name, False, str(info))
        return
    expected = serial in ("", info.serial)
    found = f"{info.model} {info.serial}, protocol {info.protocol}"
    yield Finding(name, expected, found if expected else f"{found}; the site's configuration names {serial}")
    yield _clock(name, info.clock)


def _clock(name: str, clock: ClockOffset) -> Finding:
    """What the round trip leaves in doubt is not held against a clock."""
    found = f"{clock.seconds:+.3f} s from this computer's, ± {clock.uncertainty:.3f} s"
    if clock.certain > CLOCK_DOUBT_S:
        found += "; let both computers take their time from one server (chrony)"
    return Finding(f"{name}'s clock", clock.certain <= CLOCK_LIMIT_S, found, doubtful=clock.certain > CLOCK_DOUBT_S)


def _self_test(found: SelfTest | Failure) -> Finding:
    if isinstance(found, Failure):
        return Finding("scanner's self-test", False, str(found))
    figures = ", ".join(f"{name} {value:g}" for name, value in found.figures.items())
    if not found.faults:
        return Finding("scanner's self-test", True, f"passed; {figures}")
    faults = "; ".join(found.faults)
    return Finding(
        "scanner's self-test",
        False,
        f"{faults} ({figures}); mend that at the instrument, or switch it off and on, and look again",
    )


def _condition(needed: float, state: BaseState | Failure) -> Iterator[Finding]:
    if isinstance(state, Failure):
        yield Finding("base telemetry", False, str(state))
        return
    charge = f"{state.battery:.0%}"
    enough = state.battery >= needed
    yield Finding("battery", enough, charge if enough else f"{charge}; charge it to {needed:.0%} at least")
    pressed = state.emergency_stop
    yield Finding("emergency stop", not pressed, "pressed; release it" if pressed else "released")
    yield Finding("at rest", not state.moving, "the wheels turn" if state.moving else "the base stands still")


def _settings(settings: Settings) -> Iterator[Finding]:
    battery = settings.battery
    rising = battery.critical < battery.low < battery.charged
    yield Finding(
        "settings.battery",
        rising,
        f"critical {battery.critical:g}, low {battery.low:g}, charged {battery.charged:g}"
        + ("" if rising else "; each must be less than the next"),
    )
    count = beams(settings)
    possible = count <= _MOST_BEAMS
    yield Finding(
        "settings.scanning.step_deg",
        possible,
        f"{settings.scanning.step_deg:g}°, {count / 1e6:.1f} million beams a scan"
        + ("" if possible else f"; more than {_MOST_BEAMS / 1e6:.0f} million, take a larger step"),
    )


def _clearances(settings: Settings, base: BaseInfo) -> Iterator[Finding]:
    """The base must fit where the settings let it drive, and turn where they let it stand."""
    length, width = base.footprint
    driving = settings.driving
    for name, value, needed in (
        ("path_clearance_m", driving.path_clearance_m, width / 2),
        ("goal_clearance_m", driving.goal_clearance_m, math.hypot(length, width) / 2),
    ):
        fits = value >= needed
        found = f"{value:.2f} m for a base of {length:.2f} x {width:.2f} m"
        yield Finding(f"settings.driving.{name}", fits, found if fits else f"{found}; at least {needed:.2f} m")


def _disk(settings: Settings, folder: Path, scans: int) -> Finding:
    # With less than the second a mission would stand still at once.
    spare = max(_SPARE_BYTES, settings.scanning.min_free_gb * 1e9)
    needed = scans * beams(settings) * _BYTES_A_BEAM + spare
    free = shutil.disk_usage(folder).free
    found = f"{free / 1e9:.1f} GB free, {needed / 1e9:.1f} GB needed for {scans} scans"
    return Finding("disk for the scans", free >= needed, found)


def beams(settings: Settings) -> float:
    """Beams of one scan at most."""
    return _FIELD_OF_VIEW / math.radians(settings.scanning.step_deg) ** 2


def _telemetry(base: Base, patience_s: float) -> BaseState | Failure:
    until = time.monotonic() + patience_s
    while (state := base.state()) is None:
        if time.monotonic() >= until:
            waited = f" within {patience_s:.0f} s" if patience_s else ""
            return Failure("BASE_LOST", f"no telemetry{waited}")
        time.sleep(0.02)
    return state
