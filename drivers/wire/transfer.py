"""Bringing a stored scan over: chunk by chunk with a few asked ahead, each checked, into a file that can be resumed."""

import errno
import hashlib
import os
import uuid
from collections import deque
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from drivers.disk import is_full
from drivers.interfaces import ScanReceipt
from drivers.jobs import Progress
from drivers.messages import Chunk, Manifest, Open, Problem, Read
from drivers.wire.client import Link, Patience
from drivers.wire.hashing import GrowingHash, sha256_of
from drivers.wire.spool import sync_folder
from perception.failure import FailureError

CREDIT = 8
"""Chunks asked for and not yet received: enough to fill a link, few enough to bound the queues."""
MAX_BAD_CHUNKS = 8


def fetch(link: Link, receipt: ScanReceipt, destination: Path, patience: Patience, progress: Progress) -> Path:
    """Bring the data of a scan to ``destination``, which appears whole and on the disk, or not at all.

    What an earlier attempt left in ``<destination>.part`` is checked against the hash of each chunk and kept.

    Raises:
        FailureError: ``SCAN_UNKNOWN``, ``SCAN_RELEASED``, ``XFER_BROKEN`` (hashes), ``DISK_FULL``,
            ``XFER_WRITE_FAILED`` (the disk, for any other reason), ``AGENT_UNREACHABLE``, ``CANCELLED``.
    """
    part = destination.with_name(destination.name + ".part")
    try:
        if destination.exists() and sha256_of(destination) == receipt.sha256:
            return destination
        manifest = link.ask(Open(receipt.scan_id), Manifest)
        if (manifest.size, manifest.sha256) != (receipt.size, receipt.sha256):
            raise _broken(receipt, "the agent holds another scan of this name", expected=receipt.sha256)
        part.parent.mkdir(parents=True, exist_ok=True)
        handle = os.open(part, os.O_RDWR | os.O_CREAT, 0o644)
        try:
            with GrowingHash(handle) as whole:
                _Transfer(link, receipt, manifest, handle, whole, patience, progress).run()
                os.fsync(handle)
                found = whole.hexdigest(manifest.size)
        finally:
            os.close(handle)
        if found != receipt.sha256:
            part.unlink()
            raise _broken(receipt, "its hash is wrong", expected=receipt.sha256, found=found)
        part.replace(destination)
        sync_folder(destination.parent)
    except OSError as error:
        # What a disk did not take it may yet show from memory: the next attempt must not take that for written.
        with suppress(OSError):
            part.unlink(missing_ok=True)
        code = "DISK_FULL" if is_full(error) else "XFER_WRITE_FAILED"
        raise FailureError(code, f"{destination} cannot be written: {error.strerror}", file=str(destination)) from error
    return destination


class _Transfer:
    """One run over the missing chunks of a file."""

    def __init__(
        self,
        link: Link,
        receipt: ScanReceipt,
        manifest: Manifest,
        handle: int,
        whole: GrowingHash,
        patience: Patience,
        progress: Progress,
    ) -> None:
        self._link = link
        self._receipt = receipt
        self._manifest = manifest
        self._handle = handle
        self._whole = whole
        self._there = bytearray(len(manifest.digests))
        # A chunk may take its time over a slow link: giving up on it early would only send it again.
        self._patience = replace(patience, first=patience.longest)
        self._progress = progress
        self._missing: deque[int] = deque()
        self._asked: dict[str, int] = {}
        self._bad = 0

    def run(self) -> None:
        # All of the room is taken before anything is sent: a full disk is known now.
        os.truncate(self._handle, min(os.fstat(self._handle).st_size, self._manifest.size))
        resumable = os.fstat(self._handle).st_size
        os.posix_fallocate(self._handle, 0, self._manifest.size)
        for index in range(len(self._there)):
            self._there[index] = self._has(index, resumable)
        self._missing.extend(index for index, there in enumerate(self._there) if not there)
        waits = self._patience.attempts()
        while self._missing or self._asked:
            self._ask_ahead()
            wait = next(waits, None)
            if wait is None:
                raise self._link.unreachable()
            if self._receive(wait):
                waits = self._patience.attempts()

    def _has(self, index: int, resumable: int) -> bool:
        start = index * self._manifest.chunk
        if start >= resumable:
            return False
        self._progress.wait(0.0)
        return self._is_right(index, os.pread(self._handle, self._manifest.chunk, start))

    def _is_right(self, index: int, data: bytes) -> bool:
        return hashlib.sha256(data).digest() == self._manifest.digests[index]

    def _ask_ahead(self) -> None:
        while self._missing and len(self._asked) < CREDIT:
            index = self._missing.popleft()
            request_id = uuid.uuid4().hex
            self._asked[request_id] = index
            self._link.send(Read(self._receipt.scan_id, index), request_id)

    def _receive(self, wait: float) -> bool:
        """Take in one reply; False after a silence, when all that was asked for is put back to be asked again."""
        reply = self._link.receive(wait)
        if reply is None:
            self._missing.extendleft(reversed(self._asked.values()))
            self._asked.clear()
            self._link.renew()
            return False
        index = self._asked.pop(reply.request_id, None)
        if index is None:
            return True
        if isinstance(reply.body, Problem):
            raise reply.body.error()
        if isinstance(reply.body, Chunk) and self._is_right(index, reply.body.data):
            self._accept(index, reply.body.data)
        else:
            self._reject(index)
        return True

    def _accept(self, index: int, data: bytes) -> None:
        _write_at(self._handle, data, index * self._manifest.chunk)
        self._there[index] = True
        first_gap = self._there.find(False)
        if first_gap > 0:
            self._whole.reach(first_gap * self._manifest.chunk)
        done, total = sum(self._there), len(self._there)
        self._progress.report(done / total, f"{done} of {total} MiB")

    def _reject(self, index: int) -> None:
        self._bad += 1
        if self._bad > MAX_BAD_CHUNKS:
            raise _broken(self._receipt, f"chunk {index} came with a wrong hash, {self._bad} such in all", chunk=index)
        self._missing.append(index)


def _write_at(handle: int, data: bytes, offset: int) -> None:
    view = memoryview(data)
    while view:  # a nearly full disk takes a part and raises nothing
        written = os.pwrite(handle, view, offset)
        if not written:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        view, offset = view[written:], offset + written


def _broken(receipt: ScanReceipt, why: str, **evidence: object) -> FailureError:
    return FailureError(
        "XFER_BROKEN", f"scan {receipt.scan_id} did not arrive: {why}", scan_id=receipt.scan_id, **evidence
    )
