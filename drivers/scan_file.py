"""The one format of a scan on disk and on the wire: a small header, metadata in msgpack, then the raw arrays.

==========  ==========================================================================
bytes       content (little-endian)
==========  ==========================================================================
0-7         magic ``SCAN\\r\\n\\x1a\\n``
8-11        format version
12-15       length of the metadata in bytes
16-23       length of the arrays in bytes
24-27       CRC-32 of everything else
28-         metadata, zeros up to a multiple of 64
...         points ``(N, 3)`` float32, intensity ``(N,)`` float32, beam ``(N,)`` int32
==========  ==========================================================================

What is no such file is refused by a code that names the cause:

===============  =====================================================================
SCAN_UNREADABLE  the file is not there, or the disk or the rights say no
SCAN_TRUNCATED   the file ends before the header says
SCAN_FOREIGN     another kind of file, or another version of this one
SCAN_HEADER      the header promises what is not there, or what no scan can have
SCAN_CORRUPT     the checksum is wrong: bits changed since it was written
===============  =====================================================================
"""

import mmap
import os
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, NamedTuple, NoReturn

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from drivers.poses import rigid
from perception.failure import FailureError
from perception.scan import BeamPattern, Scan

MAGIC = b"SCAN\r\n\x1a\n"
VERSION = 1
MAX_BEAMS = 100_000_000
"""Beams of the finest pattern that is believed: images of it fit into memory."""

_FIELDS = struct.Struct("<8sIIQ")
_CRC = struct.Struct("<I")
_HEADER = _FIELDS.size + _CRC.size
_ALIGNMENT = 64
_MAX_METADATA = 1 << 16
BYTES_PER_POINT = 12 + 4 + 4

Buffer = bytes | bytearray | memoryview
Number = Annotated[float, Meta(ge=-1e9, le=1e9)]
Numbers16 = Annotated[list[Number], Meta(min_length=16, max_length=16)]


class _Metadata(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    scan_id: Annotated[str, Meta(min_length=1, max_length=256)]
    points: Annotated[int, Meta(ge=0, le=MAX_BEAMS)]
    columns: Annotated[int, Meta(ge=1, le=MAX_BEAMS)]
    rows: Annotated[int, Meta(ge=2, le=MAX_BEAMS)]
    elevation: tuple[Number, Number]
    range: tuple[Number, Number]
    odom_from_base: Numbers16
    base_from_scanner: Numbers16


class _Header(NamedTuple):
    """Lengths in bytes, and where the arrays begin."""

    metadata: int
    arrays: int
    crc: int

    @property
    def arrays_at(self) -> int:
        return -(-(_HEADER + self.metadata) // _ALIGNMENT) * _ALIGNMENT

    @property
    def total(self) -> int:
        return self.arrays_at + self.arrays


def encode(scan: Scan) -> bytes:
    """The scan as bytes; ``decode`` gives the same values back, bit for bit."""
    return b"".join(_parts(scan))


def write(path: Path, scan: Scan) -> None:
    """Write the encoded scan and bring it to the disk. Not atomic: write aside and rename where that matters."""
    with path.open("wb") as file:
        for part in _parts(scan):
            file.write(part)
        file.flush()
        os.fsync(file.fileno())


def decode(data: Buffer, source: str = "scan", checked: bool = False) -> Scan:
    """The scan in ``data``; its arrays are views of it, not copies.

    Args:
        checked: whether the checksum was found right before; it is the one step that reads every byte.

    Raises:
        FailureError: one of the codes above, naming ``source``, what was expected and what was found.
    """
    view = memoryview(data).cast("B")
    header = _read_header(view[:_HEADER], view.nbytes, source)
    if not checked:
        _check_crc(view, header, source)
    metadata = _read_metadata(view[_HEADER : _HEADER + header.metadata], header, source)
    points, intensity, beam = _arrays(view[header.arrays_at :], metadata.points)
    pattern = BeamPattern(metadata.columns, metadata.rows, *metadata.elevation, *metadata.range)
    if len(beam) and not (beam.min() >= 0 and beam.max() < pattern.size):
        _refuse("SCAN_HEADER", source, "beams", f"0..{pattern.size - 1}", f"{beam.min()}..{beam.max()}")
    try:
        odom_from_base, base_from_scanner = rigid(metadata.odom_from_base), rigid(metadata.base_from_scanner)
    except ValueError as error:
        _refuse("SCAN_HEADER", source, "transform", "a rigid one", str(error))
    return Scan(metadata.scan_id, points, intensity, beam, pattern, odom_from_base, base_from_scanner)


def read(path: Path, checked: bool = False) -> Scan:
    """Map an encoded scan into memory. Raises as :func:`decode`.

    The arrays may be written to, which does not change the file. Their pages belong to the file until then, so that
    a machine short of memory takes them back; nothing is allocated that the file does not hold.
    """
    try:
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            _read_header(file.read(_HEADER), size, str(path))
            data = mmap.mmap(file.fileno(), size, access=mmap.ACCESS_COPY)
    except OSError as error:
        raise FailureError(
            "SCAN_UNREADABLE",
            f"{path} cannot be read: {error.strerror}; expected a scan there: look after the disk and its rights",
            file=str(path),
        ) from error
    return decode(memoryview(data), str(path), checked)


def _parts(scan: Scan) -> Iterator[Buffer]:
    count = len(scan.points)
    arrays = [
        np.ascontiguousarray(values, kind).reshape(-1)
        for values, kind in ((scan.points, "<f4"), (scan.intensity, "<f4"), (scan.beam, "<i4"))
    ]
    if [len(array) for array in arrays] != [3 * count, count, count]:
        raise ValueError(f"the arrays of scan {scan.scan_id} do not all have {count} rows")
    pattern = scan.pattern
    metadata = msgspec.msgpack.encode(
        _Metadata(
            scan.scan_id,
            count,
            pattern.columns,
            pattern.rows,
            (float(pattern.elevation_min), float(pattern.elevation_max)),
            (float(pattern.range_min), float(pattern.range_max)),
            rigid(scan.odom_from_base).ravel().tolist(),
            rigid(scan.base_from_scanner).ravel().tolist(),
        )
    )
    fields = _FIELDS.pack(MAGIC, VERSION, len(metadata), count * BYTES_PER_POINT)
    padding = bytes(-(_HEADER + len(metadata)) % _ALIGNMENT)
    body: list[Buffer] = [metadata + padding, *(array.data.cast("B") if len(array) else b"" for array in arrays)]
    yield fields + _CRC.pack(_crc(fields, *body))
    yield from body


def _read_header(start: Buffer, size: int, source: str) -> _Header:
    if len(start) < _HEADER:
        _refuse("SCAN_TRUNCATED", source, "size", f"at least {_HEADER} bytes", f"{size} bytes")
    magic, version, metadata, arrays = _FIELDS.unpack(start[: _FIELDS.size])
    if magic != MAGIC:
        _refuse("SCAN_FOREIGN", source, "first bytes", repr(MAGIC), repr(bytes(magic)))
    if version != VERSION:
        _refuse("SCAN_FOREIGN", source, "version", str(VERSION), str(version))
    header = _Header(metadata, arrays, _CRC.unpack(start[_FIELDS.size :])[0])
    if metadata > _MAX_METADATA:
        _refuse("SCAN_HEADER", source, "metadata", f"at most {_MAX_METADATA} bytes", f"{metadata} bytes")
    if arrays > MAX_BEAMS * BYTES_PER_POINT:
        _refuse("SCAN_HEADER", source, "arrays", f"at most {MAX_BEAMS} points", f"{arrays} bytes")
    if header.total > size:
        _refuse("SCAN_TRUNCATED", source, "size", f"{header.total} bytes", f"{size} bytes")
    if header.total < size:
        _refuse("SCAN_HEADER", source, "size", f"{header.total} bytes", f"{size} bytes")
    return header


def _check_crc(view: memoryview, header: _Header, source: str) -> None:
    found = _crc(view[: _FIELDS.size], view[_HEADER:])
    if found != header.crc:
        _refuse("SCAN_CORRUPT", source, "checksum", f"{header.crc:08x}", f"{found:08x}")


def _read_metadata(data: memoryview, header: _Header, source: str) -> _Metadata:
    try:
        metadata = msgspec.msgpack.decode(data, type=_Metadata)
    except (ValueError, RecursionError) as error:
        _refuse("SCAN_HEADER", source, "metadata", "a description of the scan", str(error))
    if metadata.columns * metadata.rows > MAX_BEAMS:
        _refuse("SCAN_HEADER", source, "pattern", f"at most {MAX_BEAMS} beams", f"{metadata.columns} x {metadata.rows}")
    if metadata.points * BYTES_PER_POINT != header.arrays:
        promised = f"{metadata.points} points of {BYTES_PER_POINT} bytes"
        _refuse("SCAN_HEADER", source, "arrays", promised, f"{header.arrays} bytes")
    return metadata


def _arrays(data: memoryview, count: int) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.int32]]:
    return (
        np.frombuffer(data, "<f4", 3 * count).reshape(count, 3),
        np.frombuffer(data, "<f4", count, offset=12 * count),
        np.frombuffer(data, "<i4", count, offset=16 * count),
    )


def _crc(*parts: Buffer) -> int:
    value = 0
    for part in parts:
        value = zlib.crc32(part, value)
    return value


def _refuse(code: str, source: str, what: str, expected: str, found: str) -> NoReturn:
    advice = "fetch it again" if code in ("SCAN_TRUNCATED", "SCAN_CORRUPT") else "look at who wrote it"
    raise FailureError(
        code,
        f"{source}: {what}: expected {expected}, found {found}; {advice}",
        file=source,
        expected=expected,
        found=found,
    )
