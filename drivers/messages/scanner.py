"""What a scanner is asked, and what it answers."""

from typing import Annotated

import msgspec
from msgspec import Meta

from drivers import interfaces
from drivers.messages.common import Identify, Pose
from drivers.messages.envelope import Body, Command, Count, Finite, Name, Query, WallClock, Wire

CHUNK = 1 << 20
"""Bytes of a scan in one message."""

ScanId = Annotated[str, Meta(pattern=r"\A[A-Za-z0-9][A-Za-z0-9_.:-]{0,63}\Z")]
Sha256 = Annotated[str, Meta(pattern=r"\A[0-9a-f]{64}\Z")]


class Receipt(Wire, frozen=True):
    """:class:`drivers.interfaces.ScanReceipt` on the wire and beside the stored scan."""

    scan_id: ScanId
    points: Count
    size: Count
    sha256: Sha256
    started: Name
    ended: Name

    def value(self) -> interfaces.ScanReceipt:
        return interfaces.ScanReceipt(**msgspec.structs.asdict(self))


class SelfTest(Query, frozen=True):
    """Is the instrument fit to scan? ``SelfTested``."""


class Take(Command, frozen=True):
    """Take a scan: ``Pending``, or ``ScanDone`` when it exists."""

    scan_id: ScanId
    step: Annotated[float, Meta(gt=0.0, le=1.0)]
    odom_from_base: Pose


class ScanStatus(Query, frozen=True):
    """``Pending``, ``ScanDone``, ``Problem``, or ``Unknown`` when this agent knows nothing of it."""

    scan_id: ScanId


class Abort(Command, frozen=True):
    """Give a scan up: ``Ok``."""

    scan_id: ScanId


class Release(Command, frozen=True):
    """The scan with this hash is safe elsewhere, its data may go: ``Ok``."""

    scan_id: ScanId
    sha256: Sha256


class Open(Query, frozen=True):
    """What a stored scan is made of: ``Manifest``."""

    scan_id: ScanId


class Read(Query, frozen=True):
    """One chunk of it: ``Chunk``. Asking is the credit: nothing is sent that was not asked for."""

    scan_id: ScanId
    index: Count


class ScannerIdentity(Body, frozen=True):
    model: Name
    serial: Name
    wall_clock: WallClock


class SelfTested(Body, frozen=True):
    """:class:`drivers.interfaces.SelfTest` on the wire."""

    faults: Annotated[list[Name], Meta(max_length=64)]
    figures: Annotated[dict[Name, Finite], Meta(max_length=64)]

    @classmethod
    def of(cls, test: interfaces.SelfTest) -> "SelfTested":
        figures = {name[:256]: float(value) for name, value in test.figures.items()}
        return cls([fault[:256] for fault in test.faults], figures)

    def value(self) -> interfaces.SelfTest:
        return interfaces.SelfTest(tuple(self.faults), self.figures)


class ScanDone(Body, frozen=True):
    receipt: Receipt


class Manifest(Body, frozen=True):
    """A stored scan: its size, its hash, and the hash of each chunk of ``chunk`` bytes."""

    size: Count
    sha256: Sha256
    chunk: Annotated[int, Meta(ge=1, le=CHUNK)]
    digests: list[Annotated[bytes, Meta(min_length=32, max_length=32)]]

    def __post_init__(self) -> None:
        if len(self.digests) != -(-self.size // self.chunk):
            raise ValueError(f"{len(self.digests)} chunk hashes do not fit {self.size} bytes")


class Chunk(Body, frozen=True):
    index: Count
    data: bytes


ScannerRequest = Identify | SelfTest | Take | ScanStatus | Abort | Release
BulkRequest = Open | Read
