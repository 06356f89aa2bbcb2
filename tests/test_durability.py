"""What is promised to outlast a power cut: bytes on the disk before the name, and the name on the disk after it."""

import os
import sqlite3
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from drivers.agent import scanner_agent
from drivers.wire.keys import Keyring
from drivers.wire.scanner_client import ScannerClient
from drivers.wire.spool import Spool
from mission.ledger import Ledger
from mission.store import write_arrays, write_text
from perception import transforms
from tests.drivers.wire_fakes import ANYWHERE, QUICK, SETTINGS, FakeScanner, make_scan, value_of


class Disk:
    """Notes what was brought to the disk and what was given a name, in that order."""

    def __init__(self, patch: pytest.MonkeyPatch) -> None:
        self.notes: list[tuple[str, str]] = []
        self._aside: dict[str, str] = {}
        fsync, replace = os.fsync, os.replace

        def synced(handle: int) -> None:
            fsync(handle)
            self.notes.append(("sync", str(Path(f"/proc/self/fd/{handle}").readlink())))

        def named(old: Path, new: Path, **folders: int) -> None:
            replace(old, new, **folders)
            self.notes.append(("name", str(new)))
            self._aside[str(new)] = str(old)

        patch.setattr(os, "fsync", synced)
        patch.setattr(os, "replace", named)

    def holds(self, path: Path) -> bool:
        """Whether the file of this name would be there, and whole, after the last event."""
        named = self.notes.index(("name", str(path)))
        whole_before = ("sync", self._aside[str(path)]) in self.notes[:named]
        return whole_before and ("sync", str(path.parent)) in self.notes[named:]


@pytest.fixture
def disk(monkeypatch: pytest.MonkeyPatch) -> Disk:
    return Disk(monkeypatch)


@pytest.mark.parametrize(
    "write",
    [lambda path: write_text(path, "the state"), lambda path: write_arrays(path, labels=np.zeros(3))],
    ids=["text", "arrays"],
)
def test_a_file_of_the_run_is_whole_on_the_disk_before_it_has_its_name(
    write: Callable[[Path], None], disk: Disk, tmp_path: Path
) -> None:
    write(tmp_path / "file.npz")
    assert disk.holds(tmp_path / "file.npz"), disk.notes


def test_a_scan_is_safe_at_the_scanner_before_it_exists(disk: Disk, tmp_path: Path) -> None:
    Spool(tmp_path).store(make_scan("S01"), "before", "after")
    assert disk.holds(tmp_path / "S01.scan"), disk.notes
    assert disk.holds(tmp_path / "S01.json"), disk.notes
    names = [what for kind, what in disk.notes if kind == "name"]
    assert names == [str(tmp_path / "S01.scan"), str(tmp_path / "S01.json")], (
        "a receipt promises that the data are there"
    )


def test_a_scan_is_safe_here_before_the_scanner_is_told_that_it_may_forget_it(disk: Disk, tmp_path: Path) -> None:
    with scanner_agent(FakeScanner(0.01), ANYWHERE, tmp_path / "spool") as agent:
        client = ScannerClient(agent.endpoints, QUICK)
        receipt = value_of(client.take("S01", SETTINGS, transforms.planar(0.0, 0.0, 0.0)))
        disk.notes.clear()
        here = tmp_path / "scans" / "S01.scan"
        value_of(client.fetch(receipt, here))
    assert disk.holds(here), disk.notes


def test_a_key_is_on_the_disk_before_anybody_is_told_of_it(disk: Disk, tmp_path: Path) -> None:
    Keyring(tmp_path / "keys").own  # noqa: B018
    synced = [what for kind, what in disk.notes if kind == "sync"]
    assert any(Path(what).parent == tmp_path / "keys" for what in synced), disk.notes
    assert str(tmp_path / "keys") in synced, disk.notes


@pytest.mark.parametrize(("acts", "level"), [(True, "FULL"), (False, "NORMAL")])
def test_what_moves_the_world_is_waited_for_until_it_is_on_the_disk(acts: bool, level: str, tmp_path: Path) -> None:
    said: list[str] = []
    ledger = Ledger(tmp_path / "mission.db")
    database: sqlite3.Connection = ledger._db
    database.set_trace_callback(said.append)
    ledger.begin("drive", "G01", "null", 0.0, acts=acts)
    ledger.close()
    levels = [statement.rpartition("=")[2] for statement in said if "synchronous" in statement]
    assert levels == [level]
    assert said.index(f"PRAGMA synchronous={level}") < said.index("BEGIN IMMEDIATE") < said.index("COMMIT")
