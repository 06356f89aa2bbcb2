"""A run folder that was damaged anywhere: it is said, in words, or a resumed mission is told what it was told before.

What may be missing without a word is what a power cut may take: records at the ledger's end, after the last act.
"""

import json
import random
import shutil
from collections.abc import Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

from mission.fsck import Verdict, check
from mission.ledger import Ledger
from mission.records import BEGIN
from mission.run import Summary
from mission.store import RunFolder
from tests.scenarios.kept import Kept

pytestmark = pytest.mark.xdist_group("damage")
"""Its fixtures are whole missions: one process flies them for all."""

_ACTS = ("take", "drive")
_DIES_IN_ACT = 3
"""One scan is home by then and its maps are made; the second is under way."""

Record = tuple[int, str, int | None, str]


@dataclass(frozen=True)
class Left:
    """A run folder as a mission left it, and the records of its ledger."""

    folder: Path
    records: list[Record]

    def copy(self, to: Path) -> RunFolder:
        shutil.rmtree(to, ignore_errors=True)
        shutil.copytree(self.folder, to)
        return RunFolder(to)

    @property
    def last_act(self) -> int:
        """The place of the last record that may not be lost."""
        return max(seq for seq, sort, _, body in self.records if sort == BEGIN and json.loads(body)[0] in _ACTS)

    def assert_told_the_same(self, run: RunFolder) -> None:
        """What was called clean tells all there was, but for what a power cut may take of it."""
        found = records_of(run)
        assert found == self.records[: len(found)]
        assert len(found) >= self.last_act


def records_of(run: RunFolder) -> list[Record]:
    """As a mission that is resumed reads them: from the folder itself."""
    with closing(Ledger(run.ledger)) as ledger:
        return list(ledger._db.execute("SELECT seq, sort, job, body FROM record ORDER BY seq"))


def left_by(folder: Path, scratch: Path) -> Left:
    return Left(folder, records_of(Left(folder, []).copy(scratch)))


@pytest.fixture(scope="module")
def ended(tmp_path_factory: pytest.TempPathFactory) -> Left:
    """By a mission that came to its end: all is in ``mission.db``."""
    kept = Kept(tmp_path_factory.mktemp("ended"))
    assert isinstance(kept.fly(), Summary)
    return left_by(kept.run.path, tmp_path_factory.mktemp("scratch") / "run")


@pytest.fixture(scope="module")
def killed(tmp_path_factory: pytest.TempPathFactory) -> Left:
    """By an executive that was killed: all is in the write-ahead log."""
    kept, image = Kept(tmp_path_factory.mktemp("killed")), tmp_path_factory.mktemp("image") / "run"
    end = Ledger.end

    def watched(ledger: Ledger, seq: int, how: str, outcome: str, at: float) -> None:
        acts = [job for job in ledger.jobs() if job.kind in _ACTS]
        if len(acts) == _DIES_IN_ACT and not image.exists():
            shutil.copytree(kept.run.path, image)
        end(ledger, seq, how, outcome, at)

    with patch.object(Ledger, "end", watched):
        kept.fly()
    return left_by(image, tmp_path_factory.mktemp("scratch") / "run")


@pytest.fixture(params=["ended", "killed"])
def left(request: pytest.FixtureRequest) -> Left:
    found: Left = request.getfixturevalue(request.param)
    return found


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_what_a_mission_left_is_clean_and_looking_at_it_changes_nothing(left: Left, tmp_path: Path) -> None:
    run = left.copy(tmp_path / "run")
    before = contents(run.path)
    found = check(run)
    assert found == Verdict(scans=found.scans, files=found.files)
    assert (found.exit_code, found.next_step) == (0, "")
    assert found.scans >= 1
    assert found.files >= 3
    assert contents(run.path) == before


def damaged(content: bytes, times: int, seed: str, among: int | None = None) -> Iterator[bytes]:
    """The content with one byte of it changed, or of the first so many, so many times."""
    chance = random.Random(seed)
    for _ in range(times):
        changed = bytearray(content)
        changed[chance.randrange(among or len(content))] ^= chance.randrange(1, 256)
        yield bytes(changed)


def rewrite(path: Path, content: bytes) -> None:
    path.unlink(missing_ok=True)  # a scan that came home is read-only
    path.write_bytes(content)


@pytest.mark.parametrize(
    ("by", "name", "among", "times"),
    [
        ("ended", "mission.db", None, 150),
        ("killed", "mission.db", 100, 50),  # its header: the write-ahead log has the rest anew
        ("killed", "mission.db-wal", None, 90),
    ],
)
def test_a_byte_of_the_ledger_that_changed_is_said_or_no_act_is_lost_by_it(
    by: str, name: str, among: int | None, times: int, request: pytest.FixtureRequest, tmp_path: Path
) -> None:
    left: Left = request.getfixturevalue(by)
    said = 0
    for content in damaged((left.folder / name).read_bytes(), times, name, among):
        run = left.copy(tmp_path / "run")
        rewrite(run.path / name, content)
        found = check(run)
        said += found.exit_code
        if found.exit_code == 0:
            left.assert_told_the_same(run)
        else:
            assert found.exit_code == 1
            assert str(run.ledger) in found.unusable[0]
    assert said


@pytest.mark.parametrize("share", [0.0, 0.25, 0.5, 0.75, 0.999])
def test_a_write_ahead_log_that_lost_an_act_is_missed(share: float, killed: Left, tmp_path: Path) -> None:
    run = killed.copy(tmp_path / "run")
    log = run.path / "mission.db-wal"
    rewrite(log, log.read_bytes()[: int(share * log.stat().st_size)])
    said = check(run).exit_code
    assert said == (1 if len(records_of(run)) < killed.last_act else 0)


def test_what_a_power_cut_may_take_is_not_missed(killed: Left, tmp_path: Path) -> None:
    run = killed.copy(tmp_path / "run")
    cut_off_after(run, killed.last_act)
    run.events.write_bytes(run.events.read_bytes()[:-7])
    assert check(run).exit_code == 0
    cut_off_after(run, killed.last_act - 1)
    (words,) = check(run).unusable
    assert "its end is lost: expected job" in words


def cut_off_after(run: RunFolder, record: int) -> None:
    with closing(Ledger(run.ledger)) as ledger:
        ledger._db.execute("DELETE FROM record WHERE seq > ?", (record,))


def test_a_scan_that_the_ledger_never_ordered_says_that_its_end_is_lost(left: Left, tmp_path: Path) -> None:
    """Also where the event log is gone as well."""
    run = left.copy(tmp_path / "run")
    cut_off_after(run, next(seq for seq, sort, _, _ in left.records if sort == BEGIN) - 1)
    run.events.unlink()
    words = check(run).unusable[0]
    assert "its end is lost: expected the order of S01, whose scan is there" in words


DELETED = {
    "mission.db": 1,
    "mission.db-wal": 1,
    "config.yaml": 3,
    "events.jsonl": 3,
    "scans": 3,
    "maps": 3,
    "voxels": 3,
    "evidence": 3,
    "state.json": 0,
    "report.html": 0,
}
"""What is said when a file of this name, or in this folder, is gone."""


def test_each_file_that_is_gone_or_overwritten_is_said_or_is_made_of_others(left: Left, tmp_path: Path) -> None:
    files = [name for name in contents(left.folder) if name != "control.json"]
    assert {"maps", "voxels", "evidence", "scans"} < {name.partition("/")[0] for name in files}
    for name in files:
        says = DELETED[name.partition("/")[0]]
        run = left.copy(tmp_path / "run")
        (run.path / name).unlink()
        assert check(run).exit_code == says, f"{name} was deleted"
        assert not (run.path / name).exists()
        for content in (b"", b"\xff\xfe\n" * 9):
            rewrite(run.path / name, content)
            assert check(run).exit_code == says, f"{name} was overwritten"


def test_a_byte_that_changed_in_any_file_that_is_needed_is_said(ended: Left, tmp_path: Path) -> None:
    names = [
        name for name in contents(ended.folder) if name.partition("/")[0] in ("scans", "maps", "voxels", "evidence")
    ]
    for name in names:
        for content in damaged((ended.folder / name).read_bytes(), 6, name):
            run = ended.copy(tmp_path / "run")
            rewrite(run.path / name, content)
            found = check(run)
            assert found.exit_code == 3
            assert any(name in words for words in (*found.lost, *found.only_shown))


def test_a_map_in_the_place_of_another_is_found(ended: Left, tmp_path: Path) -> None:
    run = ended.copy(tmp_path / "run")
    first, second = sorted((run.path / "maps").glob("*.npz"))[:2]
    rewrite(first, second.read_bytes() + b" ")
    assert [words.partition(":")[0] for words in check(run).lost] == [str(first)]


@pytest.mark.parametrize(("later", "code"), [("done", 3), (None, 0), ("failed", 0)])
def test_a_file_that_a_later_job_may_have_written_without_living_to_tell_is_believed_if_it_is_whole(
    later: str | None, code: int, ended: Left, tmp_path: Path
) -> None:
    run = ended.copy(tmp_path / "run")
    first, second = sorted((run.path / "voxels").glob("*.npz"))[0], sorted((run.path / "maps").glob("*.npz"))[0]
    room, cycle = first.stem.split("_")
    with closing(Ledger(run.ledger)) as ledger:
        number = ledger.begin("label_space", f"{room} {int(cycle)}", "null", 9e9)
        if later is not None:
            ledger.end(number, later, "null", 9e9)
    rewrite(first, second.read_bytes())
    assert check(run).exit_code == code
    rewrite(first, second.read_bytes()[:-9])
    assert check(run).exit_code == 3
    np.savez(first, labels=np.zeros(1000, np.uint8))
    middle = first.stat().st_size // 2
    rewrite(first, first.read_bytes()[:middle] + b"\x01" + first.read_bytes()[middle + 1 :])
    assert (" bytes, found " if later == "done" else "labels.npy damaged") in check(run).lost[0]
