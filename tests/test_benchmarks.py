"""Each benchmark of ``make campaign`` ends with 1 when its bar is broken: here each bar is broken once."""

import re
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks import campaign, dead_man, deaths, degenerate, fuzz, guards, memory, pauses, tick
from benchmarks.pauses import Operator, Round
from tests.drivers.dead_man import Halt
from tests.scenarios.deaths import Undisturbed, When

ROOT = Path(__file__).parents[1]
Patch = pytest.MonkeyPatch

QUICK, SLOW = np.full(200, 0.004), np.full(200, 0.021)
GOOD_ROW = {
    "outcome": "complete",
    "rooms_reachable": 6,
    "rooms_finished": 6,
    "collisions": 0,
    "pose_error_max_m": 0.008,
    "pose_error_max_deg": 0.02,
}
GOOD_ROUND = Round(True, 0.12, 0.2, "held", "drive to the view")


def ticks(patch: Patch, thinking: Any = QUICK, all_else: Any = QUICK) -> int:
    kinds = {"thinking": thinking, "all else": all_else}
    rows = [tick.Row(name, seconds, seconds / 2, seconds / 2, seconds) for name, seconds in kinds.items()]
    patch.setattr(tick, "measure", lambda *_: rows)
    return tick.main()


def dead_men(patch: Patch, halts: dict[str, float] | None = None, killed: float = 0.46, obeyed: int = 0) -> int:
    @contextmanager
    def no_bench(_: Path) -> Iterator[None]:
        yield

    late = halts or {}
    patch.setattr(dead_man, "bench", no_bench)
    patch.setattr(dead_man, "halts_by", lambda fault, *_: [Halt(late.get(fault, 0.46), 0.0)])
    patch.setattr(dead_man, "halts_by_kill", lambda *_: [Halt(killed, 0.0)])
    patch.setattr(dead_man, "obeyed_after_takeover", lambda *_: obeyed)
    return dead_man.main()


def frames(patch: Patch, bar: int = fuzz.MEMORY_BAR) -> int:
    patch.setattr(sys, "argv", ["fuzz", "--frames", "50"])
    patch.setattr(fuzz, "MEMORY_BAR", bar)
    patch.setattr(fuzz, "fuzz_connections", lambda *_: True)
    return fuzz.main()


def connections(patch: Patch, bad_one: bool | None = None) -> int:
    patch.setattr(fuzz, "fuzz_frames", lambda *_: True)
    patch.setattr(fuzz, "fuzz_connections", lambda _seed, _count, _folder, guarded: guarded is not bad_one)
    return fuzz.main()


def guarded(patch: Patch, by: str = "a test") -> int:
    patch.setattr(guards, "copied", lambda folder: ROOT)
    patch.setattr(guards, "removed", lambda *_: by)
    with pytest.raises(SystemExit) as ended:
        guards.main()
    return int(ended.value.code or 0)


def pausing(patch: Patch, *rounds: Round, acks: list[float] | None = None) -> int:
    operator = Operator(Path())
    operator.waits = [0.01] if acks is None else acks
    patch.setattr(pauses.subprocess, "Popen", _NoMission)
    patch.setattr(pauses, "_pause_often", lambda *_: pauses.verdict(list(rounds or [GOOD_ROUND]), operator))
    return pauses.main()


class _NoMission:
    def __init__(self, *_: object, **__: object) -> None:
        """Nothing is started."""

    def __enter__(self) -> "_NoMission":
        return self

    def __exit__(self, *exception: object) -> None:
        """Nothing runs."""

    def terminate(self) -> None:
        """Nothing runs."""


def flown(patch: Patch, tmp: Path, **changes: object) -> int:
    patch.setattr(sys, "argv", ["campaign", "--seeds", "1", "--out", str(tmp)])
    patch.setattr(campaign, "fly", lambda *_: GOOD_ROW | changes)
    return campaign.main()


def placed(patch: Patch, verdict: str = "right") -> int:
    case = SimpleNamespace(kind="hall", verdict=verdict, seed=0, method="icp", error_m=0.1, error_rad=0.1, reasons=())
    patch.setattr(degenerate, "outcomes", lambda _: [case])
    return degenerate.main()


def grown(patch: Patch, peak: float = 900.0, last: float = 1.0) -> int:
    cycles = [memory.Cycle(number, {"all": last if number > 6 else 1.0}, peak, peak) for number in range(1, 13)]
    patch.setattr(memory, "rows", lambda _: cycles)
    return memory.main()


def resumed(patch: Patch, how: str = "") -> int:
    patch.setattr(deaths, "ProcessPoolExecutor", lambda *_: ThreadPoolExecutor(1))
    patch.setattr(deaths, "whole", lambda: Undisturbed(["write a", "fsync a"], {}))
    patch.setattr(deaths, "died", lambda clean, point: how if point == (When.AMID, 1) else "")
    return deaths.main()


def late(**changes: object) -> Round:
    return Round(**(vars(GOOD_ROUND) | changes))


BROKEN: dict[str, Callable[[Patch, Path], int]] = {
    "a tick of 21 ms while it thinks": lambda patch, _: ticks(patch, thinking=SLOW),
    "no tick to judge by": lambda patch, _: ticks(patch, thinking=np.empty(0)),
    "wheels that turn for 0.52 s after a cut": lambda patch, _: dead_men(patch, {"link cut": 0.52}),
    "wheels that turn for 0.52 s after a kill": lambda patch, _: dead_men(patch, killed=0.52),
    "an old order obeyed": lambda patch, _: dead_men(patch, obeyed=1),
    "frames that cost memory": lambda patch, _: frames(patch, bar=-1_000_000_000),
    "plain connections that cost something": lambda patch, _: connections(patch, bad_one=False),
    "connections with keys that cost something": lambda patch, _: connections(patch, bad_one=True),
    "a guard that nobody misses": lambda patch, _: guarded(patch, by=""),
    "a pause that takes 0.51 s to rest": lambda patch, _: pausing(patch, GOOD_ROUND, late(rest_s=0.51)),
    "a pause that never comes to rest": lambda patch, _: pausing(patch, late(rested=False)),
    "a base that is let go and stands": lambda patch, _: pausing(patch, late(on_s=1.1)),
    "words that are heard after 0.21 s": lambda patch, _: pausing(patch, acks=[0.01] * 50 + [0.21] * 2),
    "no word at all": lambda patch, _: pausing(patch, acks=[]),
    "a mission without a report": lambda patch, tmp: flown(patch, tmp, outcome="exit 1", rooms_finished=0),
    "a room that was left out": lambda patch, tmp: flown(patch, tmp, rooms_finished=5),
    "a collision": lambda patch, tmp: flown(patch, tmp, collisions=1),
    "a pose that is off": lambda patch, tmp: flown(patch, tmp, pose_error_max_m=0.011),
    "a pose that is no number": lambda patch, tmp: flown(patch, tmp, pose_error_max_deg=float("nan")),
    "a scan in the wrong place": lambda patch, _: placed(patch, "wrong"),
    "a worker of 1.6 GB": lambda patch, _: grown(patch, peak=1600.0),
    "a mission that a death changed": lambda patch, _: resumed(patch, "goals begun"),
    "a cycle that grows": lambda patch, _: grown(patch, last=1.3),
}
KEPT: dict[str, Callable[[Patch, Path], int]] = {
    "tick": lambda patch, _: ticks(patch, all_else=SLOW),
    "dead_man": lambda patch, _: dead_men(patch),
    "fuzz, frames": lambda patch, _: frames(patch),
    "fuzz, connections": lambda patch, _: connections(patch),
    "guards": lambda patch, _: guarded(patch),
    "pauses": lambda patch, _: pausing(patch, GOOD_ROUND, late(activity="idle", on_s=5.0)),
    "campaign": flown,
    "degenerate": lambda patch, _: placed(patch, "REG_DEGENERATE"),
    "deaths": lambda patch, _: resumed(patch),
    "memory": lambda patch, _: grown(patch),
}


@pytest.fixture(autouse=True)
def no_arguments(monkeypatch: Patch) -> None:
    monkeypatch.setattr(sys, "argv", ["benchmark"])


@pytest.mark.parametrize("bar", BROKEN)
def test_a_bar_that_is_broken_ends_with_one(bar: str, monkeypatch: Patch, tmp_path: Path) -> None:
    assert BROKEN[bar](monkeypatch, tmp_path) == 1


@pytest.mark.parametrize("benchmark", KEPT)
def test_bars_that_are_kept_end_with_zero(benchmark: str, monkeypatch: Patch, tmp_path: Path) -> None:
    assert KEPT[benchmark](monkeypatch, tmp_path) == 0


def in_the_campaign() -> list[str]:
    recipe = (ROOT / "Makefile").read_text(encoding="utf-8").partition("\ncampaign:")[2].partition("\n\n")[0]
    return re.findall(r"-m (benchmarks\.\w+)", recipe)


def test_whatever_keeps_a_promise_is_in_the_campaign_and_says_how_it_ended() -> None:
    promises = {
        "fuzz",
        "tick",
        "pauses",
        "dead_man",
        "faults",
        "deaths",
        "disk",
        "guards",
        "chaos",
        "kills",
        "campaign",
    }
    assert {f"benchmarks.{name}" for name in promises} <= set(in_the_campaign())
    for name in in_the_campaign():
        source = Path(str(import_module(name).__file__)).read_text(encoding="utf-8")
        assert "sys.exit(main())" in source or "raise SystemExit(1 if" in source, name
