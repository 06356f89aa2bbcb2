"""LAS and LAZ (ASPRS): points in metres of a world frame, without pose or beams. Needs the extra ``las``."""

import struct
from pathlib import Path

import numpy as np

from drivers.recorded.raw import RawScan, broken, check_room, raw_scan
from perception.failure import FailureError

SUFFIXES = (".las", ".laz")
_AT_ONCE = 1_000_000
_SIGNATURE = b"LASF"
_SHORTEST, _LONGEST = 227, 375
"""Bytes of a header before version 1.3, and since 1.4."""
_LAYOUT = struct.Struct("<HII")
"""Header size, offset of the points, number of variable length records; from byte 94 on."""
_EXTENDED = struct.Struct("<QI")
"""Where the extended records begin and how many there are; from byte 235 on, since version 1.4."""
_OFFSET, _CHUNKS = struct.Struct("<q"), struct.Struct("<II")
"""Where the table of chunks is, before the points; its version and number of chunks."""
_COMPRESSED = 0xC0
"""Bits of the point format."""
_RECORD, _EXTENDED_RECORD = 54, 60
"""Bytes of an empty record of either kind."""


def read(path: Path) -> list[RawScan]:
    """The points of a file as one scan.

    Raises:
        FailureError: ``RECORDED_NEEDS_EXTRA`` when laspy (for ``.laz``: lazrs) is not installed.
    """
    try:
        import laspy
        import lazrs  # noqa: F401
    except ImportError as error:
        message = f"{path}: reading LAS and LAZ needs the extra 'las': pip install building-scan-mission[las]"
        raise FailureError("RECORDED_NEEDS_EXTRA", message, missing=error.name) from error
    _check_header(path)
    try:
        with laspy.open(path, laz_backend=laspy.LazBackend.Lazrs) as file:
            if path.suffix.lower() == ".las":
                check_room(path, "points", file.header.point_count, file.header.point_format.size)
            parts = [np.stack([p.x, p.y, p.z], axis=1) for p in file.chunk_iterator(_AT_ONCE)]
            count = file.header.point_count
    except FailureError:
        raise
    except Exception as error:
        # laspy, struct, numpy and the decompressor each have errors of their own for bytes that are none of LAS.
        broken(path, "LAS", "a file that can be read", f"{type(error).__name__}: {error}")
    points = np.concatenate([np.empty((0, 3)), *parts])
    if len(points) != count:
        broken(path, "points", f"{count}", f"{len(points)}")
    return [raw_scan(points, path)]


def _check_header(path: Path) -> None:
    """Refuse numbers of records that the file has no room for: laspy would look for each."""
    with path.open("rb") as file:
        head = file.read(_LONGEST)
    if not head.startswith(_SIGNATURE) or len(head) < _SHORTEST:
        broken(path, "header", f"{_SIGNATURE!r} and {_SHORTEST} bytes", f"{head[:4]!r} and {len(head)} bytes")
    size, points_at, records = _LAYOUT.unpack_from(head, 94)
    check_room(path, "header", 1, points_at)
    if size + records * _RECORD > points_at:
        broken(path, "records", f"{records} of at least {_RECORD} bytes", f"{points_at - size} bytes")
    if head[104] & _COMPRESSED:
        _check_chunks(path, points_at, int.from_bytes(head[105:107], "little"))
    minor = head[25]
    if minor >= 4 and len(head) == _LONGEST:
        first, count = _EXTENDED.unpack_from(head, 235)
        if count:
            check_room(path, "extended records", count, _EXTENDED_RECORD, first)


def _check_chunks(path: Path, points_at: int, point_size: int) -> None:
    """Refuse more chunks than the file has room for: each begins with a whole point, and the decompressor aborts."""
    size = path.stat().st_size
    with path.open("rb") as file:
        file.seek(points_at)
        (table,) = _OFFSET.unpack(file.read(8).ljust(8, b"\0"))
        if table == -1:
            file.seek(max(0, size - 8))
            (table,) = _OFFSET.unpack(file.read(8).ljust(8, b"\0"))
        if not points_at < table <= size - _CHUNKS.size:
            broken(path, "chunk table", f"between {points_at} and {size}", f"{table}")
        file.seek(table)
        _, chunks = _CHUNKS.unpack(file.read(_CHUNKS.size))
    check_room(path, "chunks", chunks, max(1, point_size))
