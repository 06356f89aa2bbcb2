"""A disk that is full or broken at any instant: nothing half written, no scan lost or taken twice, and it goes on.

Every operation in turn: ``python -m benchmarks.disk``.
"""

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest

from mission.report import write_report
from mission.run import Summary
from perception.failure import FailureError
from tests.scenarios.bad_disk import BadDisk, Way
from tests.scenarios.kept import Kept, survive
from tests.scenarios.scripted import FOR_GOOD

pytestmark = pytest.mark.xdist_group("bad disk")
"""Its fixture is a whole mission: one process flies it for all."""


@dataclass(frozen=True)
class Undisturbed:
    """A mission with a good disk: what it asks of the disk, and its scans."""

    operations: list[str]
    scans: list[str]

    def after(self, share: float) -> int:
        """The operation after so large a share of them."""
        return 1 + int(share * len(self.operations))

    def last(self, operation: str) -> int:
        """The last one that is this."""
        return len(self.operations) - self.operations[::-1].index(operation)


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Undisturbed:
    kept = Kept(tmp_path_factory.mktemp("clean"))
    disk = BadDisk(kept.run.path, Way.FULL, None)
    assert isinstance(kept.fly(disk), Summary)
    kept.assert_folder_is_whole()
    return Undisturbed(disk.log, list(kept.scanner.taken))


@pytest.mark.parametrize("way", Way, ids=lambda way: way.name)
@pytest.mark.parametrize("share", [0.12, 0.38, 0.63, 0.89])
def test_whatever_operation_fails_the_mission_keeps_every_scan_and_goes_on_or_is_resumed(
    way: Way, share: float, undisturbed: Undisturbed, tmp_path: Path
) -> None:
    told = survive(tmp_path, way, undisturbed.after(share), undisturbed.scans)
    assert not told.startswith("nothing")


@pytest.mark.parametrize(
    ("way", "operation", "then"),
    [
        (Way.ERROR, "ftruncate events.jsonl", "IO_ERROR"),
        (Way.ERROR, "open control.json", "IO_ERROR"),
        (Way.FULL, "open control.json", "DISK_FULL"),
        (Way.ERROR, "open S02.scan.part", "complete, XFER_WRITE_FAILED"),
        (Way.FULL, "open S02.scan.part", "complete, DISK_FULL, hold(DISK_FULL)"),
        (Way.ERROR, "unlink control.json", "complete"),
    ],
)
def test_a_mission_that_cannot_begin_its_files_is_refused_and_one_that_flies_goes_on(
    way: Way, operation: str, then: str, undisturbed: Undisturbed, tmp_path: Path
) -> None:
    told = survive(tmp_path, way, undisturbed.last(operation), undisturbed.scans)
    assert told == f"{operation}: {then}"


@contextmanager
def failing_files(ending: str, code: int, times: int) -> Iterator[list[str]]:
    """The disk does not take files of this ending, so many times."""
    refused: list[str] = []
    replace = os.replace

    def refuses(source: object, target: object) -> None:
        if str(target).endswith(ending) and len(refused) < times:
            refused.append(str(target))
            raise OSError(code, os.strerror(code))
        replace(source, target)  # type: ignore[arg-type]

    with patch.object(os, "replace", refuses):
        yield refused


@pytest.mark.parametrize("ending", ["run/scans/S02.scan", "map_S02.npz", "R1_02.npz", "R1_01_flatness.npz"])
@pytest.mark.parametrize("code", [errno.ENOSPC, errno.EIO])
def test_a_file_that_the_disk_refuses_twice_is_written_the_third_time(ending: str, code: int, tmp_path: Path) -> None:
    kept = Kept(tmp_path)
    with failing_files(ending, code, times=2) as refused:
        summary = kept.fly()
    assert isinstance(summary, Summary)
    assert summary.outcome == "complete"
    assert len(refused) == 2
    assert list(kept.scanner.taken) == ["S01", "S02"]
    kept.assert_folder_is_whole()


def test_a_map_that_is_never_written_is_the_reason_why_its_room_is_partial(tmp_path: Path) -> None:
    kept = Kept(tmp_path)
    with failing_files("map_S01.npz", errno.EIO, times=1000) as refused:
        summary = kept.fly()
    assert isinstance(summary, Summary)
    assert summary.outcome == "incomplete"
    assert [room["reason_ended"] for room in summary.rooms] == ["IO_ERROR"]
    assert len(refused) == 3


def test_a_disk_that_stays_full_ends_the_mission_with_the_reason(undisturbed: Undisturbed, tmp_path: Path) -> None:
    kept = Kept(tmp_path)
    kept.room_after_ticks = FOR_GOOD
    disk = BadDisk(kept.run.path, Way.FULL, undisturbed.after(0.3))
    summary = kept.fly(disk)
    assert isinstance(summary, Summary)
    assert summary.outcome == "safety_stop"
    assert kept.base.commands[-1] == "stop"
    disk.make_room()
    again = kept.fly()
    assert isinstance(again, Summary)
    assert (again.outcome, list(kept.scanner.taken)) == ("complete", ["S01", "S02"])


def test_an_abort_on_a_full_disk_is_an_abort(undisturbed: Undisturbed, tmp_path: Path) -> None:
    """What it gives up cannot be written down any more; it ends as it was told, and is taken up where it was left."""
    kept = Kept(tmp_path)
    kept.room_after_ticks = FOR_GOOD
    kept.abort_when_full = True
    disk = BadDisk(kept.run.path, Way.FULL, undisturbed.after(0.4))
    summary = kept.fly(disk)
    assert isinstance(summary, Summary)
    assert summary.outcome == "aborted"
    assert kept.errors == []
    disk.make_room()
    kept.abort_when_full = False
    again = kept.fly()
    assert isinstance(again, Summary)
    assert (again.outcome, list(kept.scanner.taken)) == ("complete", ["S01", "S02"])


@pytest.mark.parametrize("ending", ["report.json", "report.html"])
def test_a_report_that_the_disk_refuses_leaves_no_half_of_it(ending: str, tmp_path: Path) -> None:
    kept = Kept(tmp_path)
    kept.fly()
    with failing_files(ending, errno.ENOSPC, times=1), pytest.raises(FailureError, match="DISK_FULL"):
        write_report(kept.run.path)
    assert [path.name for path in kept.run.path.rglob("*") if ".part" in path.name] == []
    assert not kept.run.report.exists()


def test_the_disk_counts_what_is_asked_of_it_and_of_nobody_else(tmp_path: Path) -> None:
    (tmp_path / "here").mkdir()
    disk = BadDisk(tmp_path / "here", Way.FULL, 2)
    with disk.mounted():
        (tmp_path / "elsewhere").write_bytes(b"x")
        np.save(tmp_path / "elsewhere.npy", np.zeros(3))
        with pytest.raises(OSError, match="No space"):
            (tmp_path / "here" / "file").write_bytes(b"x")
    assert disk.log == ["open file", "write file"]
    assert disk.hit == "write file"


def test_a_folder_of_a_longer_name_lies_on_another_disk(tmp_path: Path) -> None:
    disk = BadDisk(tmp_path / "here", Way.FULL, None)
    assert disk.holds(tmp_path / "here" / "file")
    assert not disk.holds(tmp_path / "here too" / "file")


def test_a_write_is_cut_short_also_where_the_operation_meant_is_none(tmp_path: Path) -> None:
    (tmp_path / "here").mkdir()
    disk = BadDisk(tmp_path / "here", Way.SHORT, 1)
    with disk.mounted():
        (tmp_path / "here" / "file").write_bytes(b"whole all the same")
    assert disk.hit == "write file"
    assert (tmp_path / "here" / "file").read_bytes() == b"whole all the same"
