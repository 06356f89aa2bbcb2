"""A mission with faults drawn from a seed, and one with a single fault that is never over."""

import random
from dataclasses import dataclass

from behaviours.settings import BatterySettings, ScanningSettings, Settings
from tests.scenarios.faults import EVENTS, OPERATIONS, Event, befall, ways_of
from tests.scenarios.play import Play
from tests.scenarios.scripted import EVER, FOR_GOOD
from tests.scenarios.site import Site, row, star, twice_joined

SETTINGS = Settings(ScanningSettings(room_s=900.0), battery=BatterySettings(charging_s=1800.0))
"""Holds that are waited for as long as it takes to tell that they end, and not for hours."""
_MOST_TICKS = 5000
_IN_THE_MIDST = 20
"""A tick in which a mission of two rooms is well under way."""
_OVER_BY_ITSELF = ("person", "pause")
"""Neither stands in the way for ever: the one goes on, the other is the operator's own."""
_FINISHED_AFTER = ([9000, 9200], [9200, 9220], [6000, 8000, 9000, 9200, 9250])


@dataclass(frozen=True)
class Ordeal:
    """What a mission was put through, and what it came to.

    Args:
        faults: each in words.
        seconds: of the mission.
        asked: mission seconds until the operator was asked for the first time; None where nobody was.
    """

    faults: list[str]
    outcome: str
    ticks: int
    seconds: float
    codes: list[str]
    asked: float | None = None

    def __str__(self) -> str:
        return f"{self.outcome} after {self.ticks} ticks, {self.seconds:.0f} s: {'; '.join(self.faults)}"


def by_chance(seed: int) -> Ordeal:
    """A building, an operator and up to five faults, drawn from a seed.

    Raises:
        AssertionError: where a promise was broken; see :mod:`tests.scenarios.monitor`.
    """
    chance = random.Random(seed)
    play = Play(_site(chance), settings=SETTINGS, attended=chance.random() < 0.5, most_ticks=_MOST_TICKS)
    play.perception.seen = list(chance.choice(_FINISHED_AFTER))
    faults, events = [], []
    for _ in range(chance.randint(1, 5)):
        if chance.random() < 0.6:
            faults.append(_spoil_an_operation(play, chance))
        else:
            events.append(_happen(play, chance))
            faults.append(f"{events[-1].name} from tick {events[-1].first} to {events[-1].last}")
    helpful = chance.random()

    def each_tick(play: Play, ticks: int) -> None:
        for event in events:
            event.at(play, ticks)
        for question in play.desk.open:
            if chance.random() < 0.1:
                last = question.options[-1]
                play.desk.answer(question.question_id, question.options[0] if chance.random() < helpful else last)

    play.each_tick = each_tick
    return _fly(play, faults)


def held(operation: str, way: str, attended: bool = False) -> Ordeal:
    """Two rooms, one operation that goes wrong from its first call on, for good, and nobody who answers a question."""
    play = Play(row(2), settings=SETTINGS, attended=attended, most_ticks=_MOST_TICKS)
    befall(play, operation, way, 1, FOR_GOOD, random.Random(operation + way))
    if operation == "register_globally":
        play.script.fail("register_scan", "REG_LOW_OVERLAP", EVER)
    if operation == "acquire":
        play.base.reboot()
    return _fly(play, [f"{operation} {way}"])


def lasting(name: str) -> Ordeal:
    """Two rooms, and something around the robot that is never over, with nobody who answers a question."""
    play = Play(row(2), settings=SETTINGS, attended=True, most_ticks=_MOST_TICKS)
    event = Event(name, *EVENTS[name](play, random.Random(name)), _IN_THE_MIDST, FOR_GOOD)
    play.each_tick = event.at
    return _fly(play, [f"{name} from tick {_IN_THE_MIDST}"])


def _fly(play: Play, faults: list[str]) -> Ordeal:
    try:
        outcome = play.run()
        assert outcome != "fault", str(play.executive.course.state)
    except AssertionError as broken:
        broken.add_note("; ".join(faults))
        raise
    asked = next((event["t"] for event in play.events.of("asked")), None)
    return Ordeal(faults, outcome, play.ticks, play.clock.now(), play.events.codes, asked)


def _site(chance: random.Random) -> Site:
    return chance.choice([lambda: row(chance.randint(2, 5)), star, twice_joined])()


def _spoil_an_operation(play: Play, chance: random.Random) -> str:
    operation = chance.choice(OPERATIONS)
    way = chance.choice(ways_of(operation))
    first, calls = chance.randint(1, 4), chance.choice((1, 1, 2, 3, 8, FOR_GOOD))
    befall(play, operation, way, first, calls, chance)
    return f"{operation} {way} from call {first}, {'for good' if calls == FOR_GOOD else f'{calls} calls'}"


def _happen(play: Play, chance: random.Random) -> Event:
    name = chance.choice(list(EVENTS))
    first = chance.randint(1, 120)
    for_good = chance.random() < 0.2 and name not in _OVER_BY_ITSELF
    return Event(
        name, *EVENTS[name](play, chance), first, FOR_GOOD if for_good else first + chance.choice((1, 3, 10, 40))
    )
