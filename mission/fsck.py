"""Whether a run folder is what the mission wrote: its ledger whole, every scan of it there and unchanged."""

import json
from dataclasses import dataclass
from pathlib import Path

from drivers.interfaces import ScanReceipt
from drivers.wire.hashing import sha256_of
from mission.ledger import Ledger
from mission.store import RunFolder
from mission.values import from_json
from perception.failure import FailureError


@dataclass(frozen=True)
class Verdict:
    """What :func:`check` found.

    Args:
        unusable: why nothing can be done with the folder; empty if something can.
        lost: what is missing or changed though the ledger has it.
        left_over: files of writes that never ended; harmless, and never deleted without being asked.
        scans: how many were looked at.
    """

    unusable: tuple[str, ...] = ()
    lost: tuple[str, ...] = ()
    left_over: tuple[str, ...] = ()
    scans: int = 0

    @property
    def exit_code(self) -> int:
        """0 clean, 3 lossy but usable, 1 unusable."""
        return 1 if self.unusable else 3 if self.lost else 0


def check(run: RunFolder) -> Verdict:
    """Look at all of it; nothing is changed. The mission must not be running."""
    if not run.ledger.exists():
        return Verdict(unusable=(f"{run.ledger}: expected the mission's ledger, found nothing",))
    try:
        ledger = Ledger(run.ledger)
    except FailureError as error:
        return Verdict(unusable=(str(error),))
    try:
        damage = tuple(f"{run.ledger}: {words}" for words in ledger.damage())
        receipts = [] if damage else receipts_of(ledger)
    finally:
        ledger.close()
    lost = tuple(words for receipt in receipts if (words := _fault(run.scan_file(receipt.scan_id), receipt)))
    left_over = tuple(str(path) for path in sorted(run.path.rglob("*.part*")))
    return Verdict(damage, lost, left_over, len(receipts))


def receipts_of(ledger: Ledger) -> list[ScanReceipt]:
    """The receipts of all scans that were brought home, in their order."""
    taken: dict[str, ScanReceipt] = {}
    fetched = []
    for row in ledger.jobs():
        if row.how != "done" or row.outcome is None:
            continue
        if row.kind == "take":
            taken[row.name] = from_json(json.loads(row.outcome))
        elif row.kind == "fetch":
            fetched.append(taken[row.name])
    return fetched


def _fault(path: Path, receipt: ScanReceipt) -> str:
    """What is wrong with a scan's file, in words; empty if nothing."""
    try:
        size = path.stat().st_size
        if size != receipt.size:
            return f"{path}: expected {receipt.size} bytes, found {size}"
        found = sha256_of(path)
    except OSError as error:
        return f"{path}: {error.strerror}"
    return "" if found == receipt.sha256 else f"{path}: expected SHA-256 {receipt.sha256}, found {found}"
