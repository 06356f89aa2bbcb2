"""The ledger: what it says is on the disk is, in order, unchanged, and one process's alone."""

import json
import os
import sqlite3
import subprocess
import sys
from collections.abc import Callable
from contextlib import closing
from pathlib import Path

import pytest

from drivers.jobs import Done, Failed, Outcome, Running
from drivers.simulated.clock import VirtualClock
from mission.chronicle import Chronicle
from mission.ledger import Ledger
from mission.records import KeptFile
from perception.failure import FailureError
from tests.behaviours.bench import HandJob

ROOT = Path(__file__).parents[2]


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "mission.db"


def test_a_job_is_known_from_before_it_was_begun_to_its_outcome(path: Path) -> None:
    ledger = Ledger(path)
    first = ledger.begin("take", "S01", "null", 1.5)
    ledger.begin("drive", "G001", "null", 50.0)
    ledger.end(first, "done", "1", 40.0)
    ledger.close()
    taken, drive = Ledger(path).jobs()
    assert (taken.kind, taken.name, taken.begun, taken.ended, taken.how, taken.outcome) == (
        "take", "S01", 1.5, 40.0, "done", "1",
    )  # fmt: skip
    assert (drive.ended, drive.how, drive.outcome) == (None, None, None)


def test_a_job_ends_once(path: Path) -> None:
    ledger = Ledger(path)
    seq = ledger.begin("take", "S01", "null", 0.0)
    ledger.end(seq, "done", "1", 1.0)
    ledger.end(seq, "failed", "2", 2.0)
    assert [(row.how, row.outcome) for row in ledger.jobs()] == [("done", "1")]


def test_mission_time_goes_on_from_the_last_thing_known(path: Path) -> None:
    ledger = Ledger(path)
    assert ledger.newest_time() == 0.0
    ledger.end(ledger.begin("take", "S01", "null", 5.0), "done", "1", 45.0)
    ledger.begin("fetch", "S01", "null", 46.0)
    assert ledger.newest_time() == 46.0


def test_events_come_back_in_order(path: Path) -> None:
    ledger = Ledger(path)
    ledger.append([json.dumps({"n": n}) for n in range(3)])
    ledger.append([json.dumps({"n": 3})])
    assert [event["n"] for event in ledger.events()] == [0, 1, 2, 3]


def records_of_every_sort(path: Path) -> None:
    ledger = Ledger(path)
    ledger.append(['{"n": 1}'])
    job = ledger.begin("build_map", "S01 R1 1", "null", 1.0, acts=False)
    ledger.keep(job, [KeptFile("maps/map.npz", 3, "0" * 64)])
    ledger.end(job, "done", "1", 2.0)
    assert ledger.files() == {"maps/map.npz": (job, KeptFile("maps/map.npz", 3, "0" * 64))}
    ledger.append(['{"n": 2}'])
    assert ledger.damage() == []
    ledger.close()


@pytest.mark.parametrize("record", [1, 2, 3, 4])
@pytest.mark.parametrize(
    "forgery",
    [
        "UPDATE record SET body = body || ' ' WHERE seq = {0}",
        "UPDATE record SET sort = 'other' WHERE seq = {0}",
        "UPDATE record SET job = 9 WHERE seq = {0}",
        "UPDATE record SET hash = hash || 'a' WHERE seq = {0}",
        "DELETE FROM record WHERE seq = {0}",
        "DELETE FROM record WHERE seq = {0}; UPDATE record SET seq = seq - 1 WHERE seq > {0}",
        "UPDATE record SET seq = seq + 10 WHERE seq >= {0};"
        " INSERT INTO record SELECT {0}, sort, job, body, hash FROM record WHERE seq = {0} + 10;"
        " UPDATE record SET seq = seq - 9 WHERE seq >= {0} + 10",
    ],
    ids=["body", "sort", "job", "hash", "taken out", "taken out and closed up", "put in"],
)
def test_a_record_that_was_altered_taken_out_or_put_in_is_found(path: Path, record: int, forgery: str) -> None:
    records_of_every_sort(path)
    with sqlite3.connect(path) as forger:
        forger.executescript(forgery.format(record))
    forger.close()
    (words,) = Ledger(path).damage()
    assert words.endswith("is not what was written")


def test_a_mission_keeps_its_first_name_over_all_its_lives(path: Path) -> None:
    for proposed in ("first", "second"):
        with closing(Ledger(path)) as ledger:
            assert ledger.name(proposed) == "first"
            assert ledger.damage() == []
    with sqlite3.connect(path) as forger:
        forger.execute("UPDATE record SET body = 'second' WHERE sort = 'name'")
    forger.close()
    with closing(Ledger(path)) as ledger:
        assert ledger.damage() == ["record 1 is not what was written"]


def test_a_chain_goes_on_in_the_next_process_and_after_a_write_that_failed(path: Path) -> None:
    records_of_every_sort(path)
    ledger = Ledger(path)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mission.ledger.BEGIN", object())  # what no database takes
        with pytest.raises(sqlite3.Error):
            ledger.begin("take", "S02", "null", 0.0)
    assert ledger.begin("take", "S02", "null", 0.0) == 2
    assert ledger.damage() == []


def test_a_ledger_of_another_format_is_refused_by_both_names(path: Path) -> None:
    with sqlite3.connect(path) as older:
        older.execute("CREATE TABLE about (name TEXT PRIMARY KEY, value TEXT NOT NULL)")
        older.execute("INSERT INTO about VALUES ('format', '1')")
    older.close()
    with pytest.raises(FailureError, match=r"LEDGER_BAD.*expected format 2, found 1"):
        Ledger(path)


def test_a_second_process_is_turned_away_at_once(path: Path) -> None:
    ledger = Ledger(path)
    ledger.begin("take", "S01", "null", 0.0)
    again = "from pathlib import Path; import sys; from mission.ledger import Ledger; Ledger(Path(sys.argv[1]))"
    second = subprocess.run(
        [sys.executable, "-c", again, str(path)], capture_output=True, text=True, check=False, cwd=ROOT
    )
    assert "LEDGER_IN_USE" in second.stderr
    ledger.close()
    assert len(Ledger(path).jobs()) == 1


@pytest.mark.parametrize(
    "content", [b"this is no database, but long enough to look like a file of one" * 40, b"SQLite"]
)
def test_what_is_no_ledger_is_refused(path: Path, content: bytes) -> None:
    path.write_bytes(content)
    with pytest.raises(FailureError, match="LEDGER_BAD"):
        Ledger(path)


def test_a_full_disk_leaves_no_half_of_a_transaction_and_takes_it_when_there_is_room(path: Path) -> None:
    ledger = Ledger(path)
    (pages,) = ledger._db.execute("PRAGMA page_count").fetchone()
    ledger._db.execute(f"PRAGMA max_page_count = {pages + 2}")
    events = [json.dumps({"n": n, "filling": "x" * 3000}) for n in range(20)]
    with pytest.raises(FailureError, match="DISK_FULL"):
        ledger.append(events)
    assert list(ledger.events()) == []
    ledger._db.execute("PRAGMA max_page_count = 100000")
    ledger.append(events)
    assert [event["n"] for event in ledger.events()] == list(range(20))
    assert ledger.damage() == []


def test_a_disk_that_takes_nothing_is_an_error_that_stays(path: Path) -> None:
    ledger = Ledger(path)
    ledger._db.execute("PRAGMA query_only = ON")
    with pytest.raises(FailureError, match="IO_ERROR"):
        ledger.begin("take", "S01", "null", 0.0)


def test_whatever_instant_its_process_is_killed_at_every_promise_was_kept(path: Path) -> None:
    """The child says each job's number after the ledger took it; all that it said is there, and nothing is broken."""
    child = (
        "import sys; from pathlib import Path; from mission.ledger import Ledger\n"
        "ledger = Ledger(Path(sys.argv[1]))\n"
        "while True: print(ledger.begin('take', 'S', 'null', 0.0), flush=True)"
    )
    promised = 0
    for said in (1, 7, 20):
        with subprocess.Popen([sys.executable, "-c", child, str(path)], stdout=subprocess.PIPE, cwd=ROOT) as process:
            assert process.stdout is not None
            for _ in range(said):
                promised = int(process.stdout.readline())
            os.kill(process.pid, 9)
        ledger = Ledger(path)
        assert [row.seq for row in ledger.jobs()][:promised] == list(range(1, promised + 1))
        assert ledger.damage() == []
        ledger.close()


def told(path: Path, kind: str, name: str) -> Outcome[object]:
    """The outcome of the last job of a ledger, as the tree of a resumed mission hears it."""
    chronicle = Chronicle(Ledger(path), VirtualClock())
    job = chronicle.begin(kind, name, lambda: pytest.fail("it acted before it might"))
    assert isinstance(job.poll(), Running), "it is told after the tick in which it was begun"
    return job.poll()


def test_a_drive_that_an_abort_gave_up_is_not_driven_again(path: Path) -> None:
    """The base keeps refusing a goal that it was told to drop, so the tree must look for another way."""
    ledger = Ledger(path)
    ledger.end(ledger.begin("drive", "G001", "null", 1.0), "cancelled", "null", 9.0)
    ledger.close()
    chronicle = Chronicle(Ledger(path), VirtualClock())
    job = chronicle.begin("drive", "G001", lambda: pytest.fail("it was driven again"))
    assert isinstance(job.poll(), Running), "how far it came is seen when there is leave to act"
    chronicle.release()
    outcome = job.poll()
    assert isinstance(outcome, Failed)
    assert outcome.failure.code == "NAV_INTERRUPTED"
    assert [(row.how, row.name) for row in chronicle._ledger.jobs()] == [("failed", "G001")]


def test_a_scan_that_an_abort_gave_up_is_ordered_again_by_its_name(path: Path) -> None:
    ledger = Ledger(path)
    ledger.end(ledger.begin("take", "S01", "null", 1.0), "cancelled", "null", 9.0)
    ledger.close()
    assert isinstance(told(path, "take", "S01"), Running)


def test_nobody_acts_whom_a_full_disk_keeps_from_writing_it_down(path: Path) -> None:
    ledger, acts = Ledger(path), []
    (pages,) = ledger._db.execute("PRAGMA page_count").fetchone()
    ledger._db.execute(f"PRAGMA max_page_count = {pages}")

    def act() -> HandJob:
        acts.append("act")
        job = HandJob()
        job.done("scan")
        return job

    chronicle = Chronicle(ledger, VirtualClock())
    filling = ["x" * 5000]
    with pytest.raises(FailureError, match="DISK_FULL"):
        ledger.append(filling)
    job = chronicle.begin("take", "S" * 5000, act)
    assert (isinstance(job.poll(), Running), acts) == (True, [])
    ledger._db.execute("PRAGMA max_page_count = 100000")
    assert job.poll() == Done("scan")
    assert acts == ["act"]
    assert [row.how for row in ledger.jobs()] == ["done"]


def test_a_ledger_that_the_disk_refused_once_is_not_written_to_any_more(path: Path) -> None:
    """Nobody knows what the disk has of it; a row that came after a lost one would tell another mission."""
    ledger = Ledger(path)
    ledger._db.execute("PRAGMA query_only = ON")
    with pytest.raises(FailureError, match="IO_ERROR"):
        ledger.begin("take", "S01", "null", 0.0)
    ledger._db.execute("PRAGMA query_only = OFF")
    with pytest.raises(FailureError, match="IO_ERROR"):
        ledger.begin("take", "S02", "null", 0.0)
    assert ledger.jobs() == []


def test_what_was_given_up_on_a_full_disk_is_written_before_anything_else(path: Path) -> None:
    ledger = Ledger(path)
    chronicle = Chronicle(ledger, VirtualClock())
    job = chronicle.begin("drive", "G001", HandJob)
    full = pytest.MonkeyPatch()
    full.setattr(ledger, "end", lambda *_: (_ for _ in ()).throw(FailureError("DISK_FULL", "full")))
    job.cancel()
    assert ledger.jobs()[0].how is None
    full.undo()
    chronicle.begin("drive", "G002", HandJob)
    assert [(row.name, row.how) for row in ledger.jobs()] == [("G001", "cancelled"), ("G002", None)]


class Broken(HandJob):
    """Raises when it is asked."""

    def poll(self) -> Outcome[object]:
        raise RuntimeError("the driver broke")


def raises() -> HandJob:
    raise RuntimeError("it could not be begun")


def of_no_known_kind() -> HandJob:
    job = HandJob()
    job.done(object())
    return job


@pytest.mark.parametrize("start", [Broken, raises, of_no_known_kind])
def test_a_driver_that_breaks_has_failed_now_and_when_it_is_told_again(
    path: Path, start: Callable[[], HandJob]
) -> None:
    ledger = Ledger(path)
    outcome = Chronicle(ledger, VirtualClock()).begin("fetch", "S01", start).poll()
    ledger.close()
    assert isinstance(outcome, Failed)
    assert outcome.failure.code == "DRIVER_EXCEPTION"
    (row,) = Ledger(path).jobs()
    assert row.how == "failed"


@pytest.mark.parametrize(("words", "code"), [("disk I/O error", "IO_ERROR"), ("database or disk is full", "DISK_FULL")])
def test_a_ledger_that_could_not_be_opened_keeps_nobody_out(path: Path, words: str, code: str) -> None:
    with pytest.MonkeyPatch().context() as patch, pytest.raises(FailureError, match=code) as refused:
        patch.setattr(Ledger, "_open", lambda self: (_ for _ in ()).throw(sqlite3.OperationalError(words)))
        Ledger(path)
    assert refused.value.failure.evidence["path"] == str(path)
    Ledger(path).close()
