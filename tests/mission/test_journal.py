"""The event log: one JSON object a line, in order, readable at any time."""

import errno
import json
import os
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.simulated.clock import VirtualClock
from mission.journal import JsonLines, plain, read_events
from perception.failure import FailureError


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "events.jsonl"


@pytest.fixture
def journal(path: Path) -> Iterator[JsonLines]:
    journal = JsonLines(path, VirtualClock())
    yield journal
    journal.close()


def test_events_are_in_order_with_mission_time_and_utc(path: Path) -> None:
    clock = VirtualClock()
    journal = JsonLines(path, clock)
    journal.record("first", scan_id="S01")
    clock.sleep(1.23456)
    journal.record("second")
    journal.close()
    first, second = read_events(path)
    assert (first["t"], first["kind"], first["scan_id"]) == (0.0, "first", "S01")
    assert (second["t"], second["kind"]) == (1.235, "second")
    assert first["utc"].endswith("Z")


def test_an_event_can_be_read_before_the_journal_is_closed(path: Path, journal: JsonLines) -> None:
    journal.record("now")
    assert [event["kind"] for event in read_events(path)] == ["now"]


def test_figures_of_arrays_are_plain_numbers(path: Path, journal: JsonLines) -> None:
    journal.record(
        "registered",
        pose=np.eye(2),
        rmse=np.float32(0.5),
        count=np.int64(3),
        sure=np.bool_(True),
        codes={"A"},
        file=Path("scans/S01.scan"),
    )
    (event,) = read_events(path)
    assert event["pose"] == [[1, 0], [0, 1]]
    assert (event["rmse"], event["count"], event["sure"]) == (0.5, 3, True)
    assert (event["codes"], event["file"]) == (["A"], "scans/S01.scan")


def test_a_figure_that_has_no_place_in_the_log_leaves_no_half_of_a_line(path: Path, journal: JsonLines) -> None:
    with pytest.raises(TypeError, match="of type object has no place"):
        journal.record("bad", thing=object())
    journal.record("good")
    assert [event["kind"] for event in read_events(path)] == ["good"]


def test_a_journal_is_continued_and_never_overwritten(path: Path) -> None:
    for kind in ("before", "after"):
        journal = JsonLines(path, VirtualClock())
        journal.record(kind)
        journal.close()
    assert [event["kind"] for event in read_events(path)] == ["before", "after"]


def test_a_line_that_was_cut_off_is_left_out(path: Path, journal: JsonLines) -> None:
    journal.record("whole")
    with path.open("a") as stream:
        stream.write('{"t": 1.0, "kind": "cut o')
    assert [event["kind"] for event in read_events(path)] == ["whole"]


def test_no_journal_is_no_events(tmp_path: Path) -> None:
    assert read_events(tmp_path / "absent.jsonl") == []


def test_who_watches_sees_each_event(path: Path) -> None:
    seen: list[dict[str, Any]] = []
    journal = JsonLines(path, VirtualClock(), watch=seen.append)
    journal.record("one", figure=1)
    journal.close()
    assert seen == read_events(path)


def test_threads_do_not_mix_their_lines(path: Path, journal: JsonLines) -> None:
    def write(name: str) -> None:
        for number in range(100):
            journal.record(name, number=number, filling="x" * 200)

    threads = [threading.Thread(target=write, args=(name,)) for name in "abcd"]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    events = read_events(path)
    assert len(events) == 400
    for name in "abcd":
        assert [event["number"] for event in events if event["kind"] == name] == list(range(100))


def test_plain_takes_what_json_takes_not() -> None:
    assert json.dumps({"a": (1, 2)}, default=plain) == '{"a": [1, 2]}'
    with pytest.raises(TypeError):
        plain(object())


def test_half_a_line_that_a_full_disk_took_is_taken_back_and_written_whole_later(
    path: Path, journal: JsonLines, monkeypatch: pytest.MonkeyPatch
) -> None:
    write, full = os.write, [False]

    def writes(handle: int, data: memoryview) -> int:
        if full[0] and len(data) < 20:
            raise OSError(errno.ENOSPC, "No space left on device")
        return write(handle, data[:-10] if full[0] else data)

    monkeypatch.setattr(os, "write", writes)
    journal.record("before")
    full[0] = True
    journal.record("during", filling="x" * 100)
    assert [event["kind"] for event in read_events(path)] == ["before"]
    assert path.read_bytes().endswith(b"\n")
    full[0] = False
    journal.record("after")
    assert [event["kind"] for event in read_events(path)] == ["before", "during", "after"]


def test_a_line_that_a_power_cut_broke_off_does_not_swallow_the_next(path: Path) -> None:
    path.write_text('{"t": 0.0, "kind": "whole"}\n{"t": 1.0, "kind": "cut o')
    journal = JsonLines(path, VirtualClock())
    journal.record("next")
    journal.close()
    assert [event["kind"] for event in read_events(path)] == ["whole", "next"]


def test_a_log_that_cannot_be_opened_is_refused_by_name(tmp_path: Path) -> None:
    with pytest.raises(FailureError, match="IO_ERROR"):
        JsonLines(tmp_path / "nowhere" / "events.jsonl", VirtualClock())
