"""What is taken up again, and what is not; whole missions that were killed are flown in ``tests/missions``."""

import hashlib
import json
from contextlib import closing
from pathlib import Path

import pytest

from drivers.interfaces import ScanReceipt
from drivers.wire.endpoints import Endpoints
from mission.config import SiteConfig, dump_config
from mission.fsck import check
from mission.journal import read_events
from mission.ledger import Ledger
from mission.resume import resume_run, rewrite_log
from mission.store import RunFolder
from mission.values import to_json
from perception.failure import FailureError


@pytest.fixture
def run(tmp_path: Path) -> RunFolder:
    """One scan was brought home, another was only ordered."""
    folder = RunFolder.at(tmp_path)
    content = b"a scan" * 1000
    folder.scan_file("S01").write_bytes(content)
    receipt = ScanReceipt("S01", 1000, len(content), hashlib.sha256(content).hexdigest(), "", "")
    ledger = Ledger(folder.ledger)
    ledger.end(ledger.begin("take", "S01", "null", 0.0), "done", json.dumps(to_json(receipt)), 45.0)
    ledger.end(ledger.begin("fetch", "S01", "null", 45.0), "done", json.dumps(to_json(Path("S01.scan"))), 46.0)
    ledger.begin("take", "S02", "null", 100.0)
    ledger.append(['{"kind": "mission_started"}'])
    ledger.close()
    folder.events.write_text('{"kind": "mission_started"}\n')
    config = SiteConfig(
        site="kept", scanner=Endpoints("ipc://s", bulk="ipc://s"), base=Endpoints("ipc://b", telemetry="ipc://b")
    )
    folder.config.write_text(dump_config(config))
    return folder


def test_a_whole_folder_is_clean(run: RunFolder) -> None:
    found = check(run)
    assert (found.exit_code, found.scans, found.lost, found.left_over) == (0, 1, (), ())


def test_a_write_that_never_ended_is_listed_and_kept(run: RunFolder) -> None:
    half = run.path / "maps" / "map.npz.partial"
    half.write_bytes(b"half")
    assert check(run).left_over == (str(half),)
    assert (check(run).exit_code, half.exists()) == (0, True)


@pytest.mark.parametrize("offset", [0, 3000, 5999])
def test_any_changed_byte_of_a_scan_is_found(run: RunFolder, offset: int) -> None:
    content = bytearray(run.scan_file("S01").read_bytes())
    content[offset] ^= 1
    run.scan_file("S01").write_bytes(content)
    assert check(run).exit_code == 3
    with pytest.raises(FailureError, match=r"RUN_LOSSY.*S01\.scan"):
        resume_run(run.path)


def test_a_scan_that_is_gone_or_short_is_lost(run: RunFolder) -> None:
    scan = run.scan_file("S01")
    scan.write_bytes(scan.read_bytes()[:-1])
    assert "expected 6000 bytes, found 5999" in check(run).lost[0]
    scan.unlink()
    assert "No such file" in check(run).lost[0]


def test_a_folder_without_its_ledger_or_with_a_broken_one_is_unusable(run: RunFolder) -> None:
    whole = run.ledger.read_bytes()
    run.ledger.write_bytes(whole[:1000] + b"\xff" * 3000 + whole[4000:])
    assert check(run).exit_code == 1
    run.ledger.unlink()
    assert check(run).exit_code == 1
    with pytest.raises(FailureError, match="RUN_UNREADABLE"):
        resume_run(run.path)


@pytest.mark.parametrize("outcome", ["complete", "incomplete"])
def test_a_mission_that_has_ended_is_not_taken_up(run: RunFolder, outcome: str) -> None:
    run.write_state({"outcome": outcome})
    with pytest.raises(FailureError, match=f"MISSION_ENDED.*{outcome}"):
        resume_run(run.path)


@pytest.mark.parametrize(("go_on_at_once", "paused"), [(False, True), (True, False)])
def test_a_mission_that_had_begun_nothing_comes_back_paused_too(
    go_on_at_once: bool, paused: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It may have been refused at its start, or have died there; the robot is somebody else's by now, perhaps."""
    folder = RunFolder.at(tmp_path)
    with closing(Ledger(folder.ledger)) as ledger:
        ledger.append(['{"kind": "preflight"}'])
    site = SiteConfig(
        site="laboratory", scanner=Endpoints("ipc://s", bulk="ipc://s"), base=Endpoints("ipc://b", telemetry="ipc://b")
    )
    folder.config.write_text(dump_config(site))
    flown: list[bool] = []
    monkeypatch.setattr("mission.resume.run_mission", lambda *_, paused: flown.append(paused))
    resume_run(folder.path, go_on_at_once=go_on_at_once)
    assert flown == [paused]


@pytest.mark.parametrize("state", ["null", "[]", "7", "{", ""])
def test_a_state_that_tells_nothing_does_not_end_a_mission(run: RunFolder, state: str) -> None:
    """It comes as far as the agents, which are not there."""
    run.state.write_text(state)
    with pytest.MonkeyPatch.context() as patch, pytest.raises(FailureError, match="AGENT_UNREACHABLE"):
        patch.setattr("mission.resume.run_mission", refusing)
        resume_run(run.path)


def refusing(*_: object, **__: object) -> None:
    raise FailureError("AGENT_UNREACHABLE", "nobody is there")


def test_an_event_log_that_is_gone_or_damaged_is_written_anew_and_what_was_there_is_put_aside(run: RunFolder) -> None:
    run.events.write_bytes(b"\xff\xfe\n")
    rewrite_log(run)
    assert read_events(run.events) == [{"kind": "mission_started"}]
    assert (run.path / "events.damaged").read_bytes() == b"\xff\xfe\n"
    run.events.unlink()
    with pytest.MonkeyPatch.context() as patch, pytest.raises(FailureError, match="AGENT_UNREACHABLE"):
        patch.setattr("mission.resume.run_mission", refusing)
        resume_run(run.path)
    assert read_events(run.events) == [{"kind": "mission_started"}]
    with closing(Ledger(run.ledger)) as ledger:
        assert ledger.damage() == []
