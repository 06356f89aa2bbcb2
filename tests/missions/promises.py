"""What every mission must have kept, whatever befell it: judged by the simulator's log and by its own."""

from collections import Counter
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from drivers.simulated.truth_log import read_truth
from mission.journal import read_events

_MOVED_IN_A_SCAN = ("SCAN_MOVED", "SCAN_REJECTED")
Event = Mapping[str, Any]


def broken_in(folder: Path) -> list[str]:
    """Promises broken by the missions below a folder, in words; nothing where nothing was simulated."""
    found = []
    for log in sorted(folder.rglob("truth.jsonl")):
        found += broken_by_devices(read_truth(log.parent))
    for log in sorted(folder.rglob("events.jsonl")):
        found += broken_by_executive(read_events(log))
    return found


def broken_by_devices(truth: Iterable[Event]) -> list[str]:
    """What the simulator saw that must not be: twice, in motion, on the way, or against something."""
    events = list(truth)
    scans = Counter(str(event["scan_id"]) for event in events if event["event"] == "scan")
    goals = Counter(str(event["goal_id"]) for event in events if event["event"] == "drive_begun")
    found = [f"scan {name} was taken {count} times" for name, count in scans.items() if count > 1]
    found += [f"goal {name} was begun {count} times" for name, count in goals.items() if count > 1]
    return found + moved_amiss(events)


def moved_amiss(truth: Iterable[Event]) -> list[str]:
    """Whoever died on the way: no scan in motion, none on the way to a goal, no collision."""
    events = list(truth)
    found = [f"scan {event['scan_id']} was taken in motion" for event in events if event.get("moving")]
    found += [f"the base ran into something at {event['pose']}" for event in events if event["event"] == "collision"]
    return found + _scanned_on_the_way(events)


def _scanned_on_the_way(events: list[Event]) -> list[str]:
    """A drive whose end is never told was cut short by the death of its base, which stands since."""
    ends = {event["goal_id"]: number for number, event in enumerate(events) if event["event"] == "drive"}
    drives = [
        (number, ends[event["goal_id"]], event["goal_id"])
        for number, event in enumerate(events)
        if event["event"] == "drive_begun" and event["goal_id"] in ends
    ]
    return [
        f"scan {event['scan_id']} was taken on the way to {goal}"
        for number, event in enumerate(events)
        if event["event"] == "scan"
        for begun, ended, goal in drives
        if begun < number < ended
    ]


def broken_by_executive(events: Iterable[Event]) -> list[str]:
    """What the mission says of itself that must not be."""
    rows = list(events)
    registered = Counter(row["scan_id"] for row in rows if row["kind"] == "registered")
    found = [f"scan {name} has {count} poses in the log" for name, count in registered.items() if count > 1]
    codes = [row["code"] for row in rows if row["kind"] == "failure"]
    found += [f"the base moved in a scan: {code}" for code in codes if code in _MOVED_IN_A_SCAN]
    return found + [f"the program is wrong: {code}" for code in codes if code == "TICK_EXCEPTION"]
