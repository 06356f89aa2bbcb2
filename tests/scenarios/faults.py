"""Faults by name, each from an instant on and for a while or for good, drawn from a seed; on the virtual clock.

``WAYS`` is how an operation of scanner, base or perception goes wrong, ``EVENTS`` what happens around the robot.
"""

import random
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from perception.failure import Failure
from tests.scenarios.play import OWNER, Play
from tests.scenarios.scripted import HANG, Way

SCANNER = ("take", "fetch")
BASE = ("drive", "stop", "acquire")
PERCEPTION = (
    "validate_scan", "align_scan", "anchor_scan", "register_scan", "register_globally", "optimise_poses",
    "find_movement", "segment_room", "build_map", "label_space", "choose_view", "find_doors",
)  # fmt: skip
OPERATIONS = (*SCANNER, *BASE, *PERCEPTION)

_SPOILS = {
    "garbage": "SCAN_FOREIGN", "wrong units": "SCAN_UNITS", "truncated": "SCAN_TRUNCATED", "NaN": "SCAN_NOT_FINITE",
    "empty": "SCAN_EMPTY",
}  # fmt: skip
"""What validation finds of a cloud that is wrong in such a way."""
_GARBAGE = ("nonsense", 42, None, [], {"a": 1}, object(), -1.0)


# --- values gone wrong ----------------------------------------------------------------------------------------------


def with_numbers(value: Any, change: Callable[[Any], Any]) -> Any:
    """The same value with every real number in it changed."""
    if isinstance(value, bool | int | str) or value is None:
        return value
    if isinstance(value, float):
        return change(value)
    if isinstance(value, np.ndarray):
        return change(value) if value.dtype.kind == "f" else value
    return _rebuilt(value, lambda part: with_numbers(part, change))


def shortened(value: Any, keep: Callable[[int], int]) -> Any:
    """The same value with every list in it cut; a whole number is a list of so many."""
    if isinstance(value, bool | str | float) or value is None:
        return value
    if isinstance(value, int):
        return keep(value)
    if isinstance(value, np.ndarray):
        return value if value.shape == (4, 4) else value[: keep(len(value))]
    if isinstance(value, tuple | list):
        return value[: keep(len(value))]
    return _rebuilt(value, lambda part: shortened(part, keep))


def _rebuilt(value: Any, change: Callable[[Any], Any]) -> Any:
    if isinstance(value, tuple | list):
        return type(value)(change(item) for item in value)
    if isinstance(value, Mapping):
        return {name: change(item) for name, item in value.items()}
    if is_dataclass(value) and not isinstance(value, type | Failure):
        return replace(value, **{field.name: change(getattr(value, field.name)) for field in fields(value)})
    return value


# --- ways of an operation -------------------------------------------------------------------------------------------


def _failing(operation: str) -> Callable[[Any], object]:
    code = "PERC_DIED" if operation in PERCEPTION else "AGENT_UNREACHABLE"
    return lambda _: Failure(code, "nobody answers")


def _twisted(name: str, operation: str, play: Play, chance: random.Random) -> Way:
    """A right value made wrong; of a scan, its cloud."""

    def spoil(act: Callable[[], Any]) -> object:
        receipt = act()
        play.perception.spoiled[receipt.scan_id] = _SPOILS[name]
        return receipt

    garbage = chance.choice(_GARBAGE)
    makers: dict[str, Callable[[Any], object]] = {
        "garbage": lambda _: garbage,
        "wrong units": lambda value: with_numbers(value, lambda number: number * 1000.0),
        "NaN": lambda value: with_numbers(value, lambda number: number * float("nan")),
        "truncated": lambda value: shortened(value, lambda length: length // 2),
        "empty": lambda value: shortened(value, lambda length: 0),
    }
    return Way(spoil) if operation == "take" else Way(lambda act: makers[name](act()))


def _rebooting(operation: str, play: Play) -> Way:
    def base(act: Callable[[], object]) -> object:
        play.base.reboot()
        if operation == "drive":
            return Failure("NAV_INTERRUPTED", "the base began anew on its way", {"track": [], "distance": 0.0})
        return Failure("AGENT_RESTARTED", "the base's agent restarted")

    if operation in BASE:
        return Way(base)
    code = "PERC_DIED" if operation in PERCEPTION else "DEVICE_FORGOT"
    return Way(lambda _: Failure(code, "it began anew"))


WAYS: dict[str, Callable[[str, Play, random.Random], object]] = {
    "off": lambda operation, play, chance: Way(_failing(operation)),
    "intermittent": lambda operation, play, chance: Way(_failing(operation)),
    "unheard of": lambda operation, play, chance: Way(lambda _: Failure("UNHEARD_OF", "no recovery knows this")),
    "stuck": lambda operation, play, chance: HANG,
    "slow": lambda operation, play, chance: Way(seconds=lambda seconds: 8 * seconds),
    "delayed": lambda operation, play, chance: Way(seconds=lambda seconds: seconds + 200.0),
    "reboot": lambda operation, play, chance: _rebooting(operation, play),
    **{name: partial(_twisted, name) for name in _SPOILS},
}
"""By name; each makes what the script tells of the calls that it befalls."""


def ways_of(operation: str) -> list[str]:
    """The names of the ways that an operation may go wrong; stages are handed metres by validation, or nothing."""
    return [way for way in WAYS if way != "wrong units" or operation not in PERCEPTION]


def befall(play: Play, operation: str, way: str, first: int, calls: int, chance: random.Random) -> None:
    """From the ``first`` call of an operation on, so many of them go wrong; every second one if intermittent."""
    numbers: Iterable[int] = range(first, first + calls, 2 if way == "intermittent" else 1)
    play.script.answer(operation, WAYS[way](operation, play, chance), numbers)


# --- what happens around the robot ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Event:
    """Something that begins at a tick and is over at another."""

    name: str
    begin: Callable[[Play], None]
    end: Callable[[Play], None]
    first: int
    last: int

    def at(self, play: Play, ticks: int) -> None:
        if ticks == self.first:
            self.begin(play)
        if ticks == self.last:
            self.end(play)


Happening = tuple[Callable[[Play], None], Callable[[Play], None]]


def _set(owner: Callable[[Play], Any], name: str, bad: Any, good: Any) -> Happening:
    return (lambda play: setattr(owner(play), name, bad)), (lambda play: setattr(owner(play), name, good))


def _in_the_way(play: Play, chance: random.Random) -> Happening:
    place = chance.choice(play.site.views(chance.choice(list(play.site.rooms))))
    return (lambda play: play.base.occupied.add(place)), (lambda play: play.base.occupied.discard(place))


def _door(play: Play, chance: random.Random) -> Happening:
    name = chance.choice(list(play.site.passages))
    return (lambda play: play.base.closed.add(name)), (lambda play: play.base.closed.discard(name))


def _slip(play: Play, chance: random.Random) -> Happening:
    x, y, yaw = chance.uniform(-0.4, 0.4), chance.uniform(-0.4, 0.4), chance.uniform(-0.2, 0.2)
    return (lambda play: play.base.slip(x, y, yaw)), _nothing


def _silence(play: Play, chance: random.Random) -> Happening:
    def begin(play: Play) -> None:
        play.base.silent_since = play.script.clock.now()

    return begin, lambda play: setattr(play.base, "silent_since", None)


def _pause(play: Play, chance: random.Random) -> Happening:
    return (lambda play: play.word.pause()), (lambda play: play.word.resume())


def _nothing(play: Play) -> None:
    """Nothing has to be undone."""


def _base(play: Play) -> Any:
    return play.base


EVENTS: dict[str, Callable[[Play, random.Random], Happening]] = {
    "person": _in_the_way,
    "cart": _in_the_way,
    "door closes": _door,
    "slip": _slip,
    "base off": _silence,
    "base reboot": lambda play, chance: ((lambda play: play.base.reboot()), _nothing),
    "base taken": lambda play, chance: _set(_base, "owner", "somebody else", OWNER),
    "emergency stop": lambda play, chance: _set(_base, "emergency_stop", True, False),
    "battery low": lambda play, chance: _set(_base, "battery", 0.2, 0.95),
    "battery critical": lambda play, chance: _set(_base, "battery", 0.05, 0.95),
    "disk nearly full": lambda play, chance: _set(lambda play: play.floor, "free", 0.1, 100.0),
    "pause": _pause,
    "abort": lambda play, chance: ((lambda play: play.word.abort()), _nothing),
}
"""By name; each makes how it begins and how it ends."""
