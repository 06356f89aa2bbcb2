"""The scanner agent's shelf: every finished scan with its receipt, on disk until it was fetched, for good as a name."""

import hashlib
import os
import shutil
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import msgspec

from drivers import scan_file
from drivers.messages import CHUNK, Chunk, Manifest, Receipt, Wire
from drivers.wire.hashing import sha256_of
from perception.failure import FailureError
from perception.scan import Scan


class Stored(Wire, frozen=True):
    """What lies beside the data of a scan."""

    receipt: Receipt
    manifest: Manifest


class Spool:
    """Scans in one folder: ``<scan_id>.scan`` and, written after it, ``<scan_id>.json``.

    A scan exists from the moment its receipt does. The receipt outlives the data, so that no name is taken twice.
    """

    def __init__(self, folder: Path) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._folder = folder

    @property
    def free(self) -> int:
        """Bytes that may still be written."""
        return shutil.disk_usage(self._folder).free

    def require_room(self, size: int) -> None:
        """Raise ``DISK_FULL`` unless so many bytes are free."""
        free = self.free
        if free < size:
            raise FailureError(
                "DISK_FULL",
                f"{self._folder} has {free / 1e6:.0f} MB free, a scan may need {size / 1e6:.0f} MB",
                free=free,
                needed=size,
            )

    def store(self, scan: Scan, started: str, ended: str) -> Receipt:
        """Put a scan on the shelf. Raises ``SPOOL_FAILED`` (no permission, disk full)."""
        path = self._data(scan.scan_id)
        try:
            scan_file.write(_aside(path), scan)
            manifest = _manifest(_aside(path))
            receipt = Receipt(scan.scan_id, len(scan.points), manifest.size, manifest.sha256, started, ended)
            _publish(path)
            note = self._note(scan.scan_id)
            with _aside(note).open("wb") as file:
                file.write(msgspec.json.encode(Stored(receipt, manifest)))
                file.flush()
                os.fsync(file.fileno())
            _publish(note)
        except OSError as error:
            raise FailureError("SPOOL_FAILED", f"{path} cannot be stored: {error.strerror}", file=str(path)) from error
        return receipt

    def find(self, scan_id: str) -> Stored | None:
        """Receipt and manifest of a scan, whether or not its data is still here."""
        note = self._note(scan_id)
        try:
            return msgspec.json.decode(note.read_bytes(), type=Stored)
        except FileNotFoundError:
            return None
        except (OSError, ValueError) as error:
            raise FailureError("SPOOL_FAILED", f"{note} cannot be read: {error}", file=str(note)) from error

    def open(self, scan_id: str) -> Manifest:
        """What the data of a scan is made of. Raises ``SCAN_UNKNOWN``, or ``SCAN_RELEASED`` when it is gone."""
        stored = self.find(scan_id)
        if stored is None:
            raise FailureError("SCAN_UNKNOWN", f"there is no scan {scan_id} here", scan_id=scan_id)
        if not self._data(scan_id).exists():
            raise FailureError("SCAN_RELEASED", f"scan {scan_id} was fetched and its data removed", scan_id=scan_id)
        return stored.manifest

    def read(self, scan_id: str, index: int) -> Chunk:
        """One chunk, as it is on the disk. Raises ``SCAN_RELEASED``; ``XFER_BROKEN`` past the end."""
        try:
            with self._data(scan_id).open("rb") as file:
                data = os.pread(file.fileno(), CHUNK, index * CHUNK)
        except OSError as error:
            raise FailureError("SCAN_RELEASED", f"scan {scan_id} is not here: {error.strerror}") from error
        if not data:
            raise FailureError("XFER_BROKEN", f"scan {scan_id} has no chunk {index}", scan_id=scan_id, index=index)
        return Chunk(index, data)

    def release(self, scan_id: str, sha256: str) -> None:
        """Remove the data of a scan that is safe elsewhere, if it is the one with this hash."""
        stored = self.find(scan_id)
        if stored is not None and stored.receipt.sha256 == sha256:
            self._data(scan_id).unlink(missing_ok=True)

    def _data(self, scan_id: str) -> Path:
        return self._folder / f"{scan_id}.scan"

    def _note(self, scan_id: str) -> Path:
        return self._folder / f"{scan_id}.json"


def _aside(path: Path) -> Path:
    return path.with_name(path.name + ".tmp")


def _publish(path: Path) -> None:
    """Give a file that is safely on the disk its name, so that a crash leaves all of it or none."""
    _aside(path).replace(path)
    sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Bring renames in a folder to the disk; without it they may vanish with the power."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)


def _manifest(path: Path) -> Manifest:
    with ThreadPoolExecutor(1, "hash") as beside, path.open("rb") as file:
        whole = beside.submit(sha256_of, path)
        digests = [hashlib.sha256(data).digest() for data in iter(lambda: file.read(CHUNK), b"")]
        return Manifest(file.tell(), whole.result(), CHUNK, digests)
