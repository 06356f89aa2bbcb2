"""What fsck says, to whom, and with which exit code; damage of every kind is in ``tests/scenarios/test_damage.py``."""

import errno
import json
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from drivers.simulated.clock import VirtualClock
from drivers.wire.endpoints import Endpoints
from mission import cli
from mission.chronicle import Chronicle
from mission.config import SiteConfig, dump_config
from mission.control import CONTROL_FILE
from mission.fsck import check
from mission.ledger import Ledger
from mission.store import RunFolder, write_arrays
from perception.failure import FailureError
from tests.behaviours.bench import HandJob

ROOT = Path(__file__).parents[2]
STARTED = '{"kind": "mission_started"}'


@pytest.fixture
def run(tmp_path: Path) -> RunFolder:
    """A mission that drove once and scanned nothing."""
    folder = RunFolder.at(tmp_path / "run")
    ledger = Ledger(folder.ledger)
    ledger.append([STARTED])
    ledger.end(ledger.begin("drive", "G001", "null", 0.0), "done", "1", 9.0)
    ledger.close()
    folder.events.write_text(f"{STARTED}\n{ordered(1, 'drive', 'G001')}\n")
    config = SiteConfig(
        site="kept", scanner=Endpoints("ipc://s", bulk="ipc://s"), base=Endpoints("ipc://b", telemetry="ipc://b")
    )
    folder.config.write_text(dump_config(config))
    return folder


def ordered(job: int, what: str, name: str) -> str:
    return json.dumps({"kind": "ordered", "job": job, "what": what, "name": name})


def fsck(run: RunFolder, *options: str) -> Result:
    return CliRunner().invoke(cli.app, ["fsck", str(run.path), *options])


@contextmanager
def running(run: RunFolder) -> Iterator[int]:
    """Another process has the mission; its number."""
    code = (
        "import sys; from pathlib import Path; from mission.ledger import Ledger\n"
        "ledger = Ledger(Path(sys.argv[1]))\n"
        "ledger.begin('take', 'S01', 'null', 9.0)\n"
        "print('up', flush=True); sys.stdin.read()"
    )
    command = [sys.executable, "-c", code, str(run.ledger)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=ROOT) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == b"up\n"
        yield process.pid


def test_a_clean_folder_is_said_to_be_and_nothing_is_to_be_done(run: RunFolder) -> None:
    result = fsck(run)
    assert (result.exit_code, result.stdout) == (0, "0 scans and 0 other files looked at\nclean\n")
    assert json.loads(fsck(run, "--json").stdout)["next"] == ""


def test_a_mission_that_runs_is_not_judged(run: RunFolder) -> None:
    with running(run) as process:
        result = fsck(run)
        assert result.exit_code == 2
        assert f"it is running: process {process}" in result.stderr
        with pytest.raises(FailureError, match="LEDGER_IN_USE"):
            check(run)
    assert check(run).exit_code == 0


def test_the_copy_of_a_mission_that_runs_is_judged_although_it_says_who_ran_it(run: RunFolder, tmp_path: Path) -> None:
    copy = RunFolder(tmp_path / "backup")
    with running(run) as process:
        (run.path / CONTROL_FILE).write_text(json.dumps({"endpoint": "ipc://x", "pid": process}))
        shutil.copytree(run.path, copy.path)
        assert check(copy).exit_code == 0
    log = copy.path / "mission.db-wal"
    assert log.stat().st_size > 0


def test_what_is_lost_is_named_with_what_to_do(run: RunFolder) -> None:
    run.config.write_text("site: [")
    result = fsck(run)
    assert result.exit_code == 3
    assert f"LOST  {run.config}: not YAML" in result.stdout
    assert "next: restore these files from a backup" in result.stdout
    run.config.unlink()
    assert "No such file" in check(run).lost[0]
    run.ledger.write_bytes(b"")
    told = json.loads(fsck(run, "--json").stdout)
    assert (told["unusable"], told["next"][:24]) == (
        [f"{run.ledger}: expected the mission's ledger, found an empty file"], "restore the whole folder",
    )  # fmt: skip
    assert run.ledger.stat().st_size == 0


def test_a_ledger_without_a_record_is_no_mission(run: RunFolder) -> None:
    run.ledger.unlink()
    Ledger(run.ledger).close()
    (words,) = check(run).unusable
    assert "expected the records of a mission, found none" in words


def test_a_ledger_of_another_format_is_refused_by_both_names(run: RunFolder) -> None:
    ledger = Ledger(run.ledger)
    ledger._db.execute("UPDATE about SET value = '1'")
    ledger.close()
    assert check(run).unusable == (f"{run.ledger}: expected format 2, found 1",)


def test_a_header_that_denies_the_write_ahead_log_is_damage(run: RunFolder) -> None:
    """The next to open it would throw away what is in there."""
    content = bytearray(run.ledger.read_bytes())
    assert content[18:20] == b"\2\2"
    content[18:20] = b"\1\1"
    run.ledger.write_bytes(content)
    (words,) = check(run).unusable
    assert "expected a write-ahead log, found the mode 'delete'" in words


@pytest.mark.parametrize(
    ("acts", "code", "words"),
    [
        ([(1, "drive", "G001")], 0, ""),
        ([], 0, ""),  # a power cut took the end of the log
        ([(1, "drive", "G001"), (4, "take", "S01")], 1, "expected job 4, take S01, as in the event log, found 1 jobs"),
        ([(1, "drive", "G007")], 3, "expected job 1 to be drive G001, as in the ledger, found drive G007"),
    ],
)
def test_every_act_of_the_log_is_in_a_ledger_that_has_its_end(
    acts: list[tuple[int, str, str]], code: int, words: str, run: RunFolder
) -> None:
    run.events.write_text("".join(f"{line}\n" for line in (STARTED, *(ordered(*act) for act in acts))) + '{"kind": "no')
    found = check(run)
    assert found.exit_code == code
    assert any(words in said for said in (*found.unusable, *found.log)) or not words


@pytest.mark.parametrize(
    "line", [b"\xff\xfe", b"null", b"{", b'{"kind": "ordered"}', b'{"kind": "ordered", "job": "x"}']
)
def test_a_line_of_the_log_that_is_no_event_is_said_and_does_not_keep_a_mission_from_going_on(
    line: bytes, run: RunFolder
) -> None:
    run.events.write_bytes(STARTED.encode() + b"\n" + line + b"\n")
    found = check(run)
    assert (found.exit_code, found.lost) == (3, ())
    assert "expected an event in line 2" in found.log[0]
    assert "`mission resume` can go on" in found.next_step


@pytest.mark.parametrize("name", ["rehearsal.json", "world.npz"])
def test_a_rehearsal_without_its_building_is_lossy(name: str, run: RunFolder) -> None:
    run.simulation.mkdir()
    run.rehearsal.write_text("{}")
    write_arrays(run.world, walls=[1.0])
    assert check(run).exit_code == 0
    file = run.simulation / name
    for content in (b"{", b"PK\x03\x04 and no more"):
        file.write_bytes(content)
        assert str(file) in check(run).lost[0]
    file.unlink()
    assert str(file) in check(run).lost[0]


@pytest.mark.parametrize("outcome", ["7", '{"$type": "Unheard"}', "{"])
def test_a_receipt_that_is_none_is_no_traceback(outcome: str, run: RunFolder) -> None:
    ledger = Ledger(run.ledger)
    ledger.end(ledger.begin("take", "S01", "null", 10.0), "done", outcome, 11.0)
    ledger.close()
    (words,) = check(run).unusable
    assert "expected the receipt of S01" in words


def test_no_room_for_a_copy_is_nothing_that_the_folder_is_blamed_for(run: RunFolder) -> None:
    with pytest.MonkeyPatch.context() as patch, pytest.raises(FailureError, match="DISK_FULL"):
        patch.setattr(shutil, "copyfile", lambda *_: (_ for _ in ()).throw(OSError(errno.ENOSPC, "No space left")))
        check(run)


class Witness(list[tuple[str, int]]):
    """A journal that looks at what is on the disk when it is told of an act."""

    def __init__(self, ledger: Ledger) -> None:
        super().__init__()
        self._ledger = ledger

    def record(self, kind: str, /, **figures: object) -> None:
        self.append((f"{kind} {figures['what']} {figures['name']}", len(self._ledger.jobs())))


def test_an_act_is_told_to_the_log_after_it_is_written_down_and_before_it_is_ordered(run: RunFolder) -> None:
    ledger = Ledger(RunFolder.at(run.path / "another").ledger)
    witness = Witness(ledger)
    chronicle = Chronicle(ledger, VirtualClock())
    chronicle.witnessed_by(witness)

    def order() -> HandJob:
        witness.append(("begins", 0))
        return HandJob()

    chronicle.begin("align_scan", "S01", order)
    chronicle.begin("take", "S01", order, acts=True)
    assert witness == [("begins", 0), ("ordered take S01", 2), ("begins", 0)]
