"""Frames and connections that nobody well-behaved would send, seeded, and the figures of who has to bear them."""

import contextlib
import os
import random
import socket
import time
from collections import deque
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import zmq

from drivers.messages import (
    PROTOCOL,
    AnyReply,
    BaseIdentity,
    DriveDone,
    Goal,
    Identify,
    Reply,
    Request,
    Telemetry,
)
from drivers.wire.codec import Codec, UndecodableError, encode
from perception.failure import FailureError
from tests.drivers import wire_samples

CODECS: list[Codec[Any]] = [
    *(Codec(Request[union]) for union in wire_samples.REQUESTS.values()),
    Codec(Reply[AnyReply]),
    Codec(Telemetry),
]
_REPLIES: Codec = Codec(Reply[AnyReply])
_HEADERS = bytes([0xC1, 0xC6, 0xDB, 0xDD, 0xDF, 0xC9, 0xD9, 0x9F, 0xBF, 0x8F, 0xFF, 0xCB])
_PAGE = os.sysconf("SC_PAGE_SIZE")
HELD = 48
"""Raw connections that are kept open while the next ones come."""


def mutated_frames(seed: int, count: int) -> Iterator[bytes]:
    """``count`` good frames that something happened to."""
    rng, good = random.Random(seed), wire_samples.frames()
    for _ in range(count):
        frame = bytearray(rng.choice(good))
        for _ in range(rng.choice((1, 1, 1, 1, 2, 8))):
            rng.choice(_MUTATIONS)(rng, frame, good)
        yield bytes(frame)


def read_all_ways(frame: bytes) -> int:
    """How many codecs took the frame; whatever else than being refused comes out of one is let through."""
    taken = 0
    for codec in CODECS:
        try:
            message = codec.decode(frame)
        except UndecodableError:
            continue
        taken += 1
        with contextlib.suppress(FailureError):
            _use(message)
    return taken


def _use(message: object) -> None:
    """What a receiver does at once with the values of a message."""
    body = getattr(message, "body", None)
    for part in (body, getattr(body, "goal", None)):
        if isinstance(part, Goal | DriveDone):
            part.value()


def _flip(rng: random.Random, frame: bytearray, good: list[bytes]) -> None:
    if frame:
        frame[rng.randrange(len(frame))] ^= 1 << rng.randrange(8)


def _replace(rng: random.Random, frame: bytearray, good: list[bytes]) -> None:
    if frame:
        frame[rng.randrange(len(frame))] = rng.choice(_HEADERS)


def _cut(rng: random.Random, frame: bytearray, good: list[bytes]) -> None:
    del frame[rng.randint(0, len(frame)) :]


def _remove(rng: random.Random, frame: bytearray, good: list[bytes]) -> None:
    start = rng.randint(0, len(frame))
    del frame[start : start + rng.randint(1, 8)]


def _insert(rng: random.Random, frame: bytearray, good: list[bytes]) -> None:
    start = rng.randint(0, len(frame))
    frame[start:start] = rng.randbytes(rng.randint(1, 8))


def _splice(rng: random.Random, frame: bytearray, good: list[bytes]) -> None:
    other = rng.choice(good)
    start = rng.randint(0, len(other))
    frame[rng.randint(0, len(frame)) :] = other[start:]


def _lengthen(rng: random.Random, frame: bytearray, good: list[bytes]) -> None:
    """A header that announces far more than comes."""
    start = rng.randint(0, len(frame))
    frame[start : start + 5] = bytes([rng.choice(_HEADERS)]) + rng.choice((b"\xff\xff\xff\xff", b"\x00\xff\xff\xff"))


def _nest(rng: random.Random, frame: bytearray, good: list[bytes]) -> None:
    start = rng.randint(0, len(frame))
    frame[start:start] = bytes([rng.choice((0x91, 0x81, 0x92))]) * rng.choice((8, 64, 5000))


_MUTATIONS: list[Callable[[random.Random, bytearray, list[bytes]], None]] = [
    *([_flip] * 4),
    *([_replace] * 3),
    _cut,
    _remove,
    _insert,
    _splice,
    _lengthen,
    _nest,
]


def greeting(mechanism: bytes = b"NULL") -> bytes:
    """The first 64 bytes of ZMTP 3.1."""
    return b"\xff" + bytes(8) + b"\x7f\x03\x01" + mechanism.ljust(20, b"\0") + bytes(32)


def _command(name: bytes, data: bytes) -> bytes:
    body = bytes([len(name)]) + name + data
    return b"\x06" + len(body).to_bytes(8, "big") + body


READY = _command(b"READY", b"\x0bSocket-Type\x00\x00\x00\x06DEALER")


def raw_bytes(rng: random.Random) -> bytes:
    """What one raw connection sends: garbage, or a handshake that goes wrong sooner or later."""
    hello = _command(b"HELLO", b"\x01\x00" + bytes(72) + rng.randbytes(120))
    frame = next(mutated_frames(rng.getrandbits(32), 1))
    long_frame = bytes([rng.choice((2, 3))]) + len(frame).to_bytes(8, "big") + frame
    sent = rng.choice(
        [
            rng.randbytes(rng.randint(1, 2000)),
            b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n",
            greeting(rng.choice((b"NULL", b"PLAIN", b"CURVE", b"GSSAPI", rng.randbytes(20)))),
            greeting() + READY + long_frame * rng.randint(1, 20),
            greeting() + READY + bytes([2]) + rng.choice((b"\xff" * 8, b"\x7f" + b"\xff" * 7)) + b"xx",
            greeting() + READY + b"\x03" + (1 << 20).to_bytes(8, "big") + b"half",
            greeting() + _command(rng.choice((b"READY", b"ERROR", b"PING", b"")), rng.randbytes(rng.randint(0, 300))),
            greeting(b"CURVE") + hello,
            greeting(b"CURVE") + hello + _command(b"INITIATE", rng.randbytes(rng.randint(0, 400))),
            greeting(b"PLAIN") + _command(b"HELLO", b"\x04user\x08password"),
            b"",
        ]
    )
    if sent and rng.random() < 0.4:
        damaged = bytearray(sent)
        damaged[rng.randrange(len(damaged))] = rng.randrange(256)
        sent = bytes(damaged)
    return sent[: rng.randint(1, len(sent))] if sent and rng.random() < 0.3 else sent


def storm(endpoint: str, seed: int, count: int, hold: int = HELD) -> Iterator[int]:
    """Open ``count`` raw connections, the newest ``hold`` of which stay open; yields the number of each."""
    rng, held = random.Random(seed), deque[socket.socket]()
    host, _, port = endpoint.removeprefix("tcp://").rpartition(":")
    try:
        for number in range(count):
            connection = socket.create_connection((host, int(port)), timeout=5.0)
            held.append(connection)
            with contextlib.suppress(OSError):  # it may hang up on us while we are still at it
                connection.sendall(raw_bytes(rng))
            if len(held) > hold:
                held.popleft().close()
            yield number
    finally:
        for connection in held:
            connection.close()


def round_trip(connection: zmq.Socket, patience_s: float = 5.0) -> float:
    """Seconds until the agent said who it is."""
    started = time.perf_counter()
    connection.send(encode(Request(PROTOCOL, "good", Identify())))
    if not connection.poll(int(1000 * patience_s)):
        raise TimeoutError(f"no answer within {patience_s} s")
    reply = _REPLIES.decode(connection.recv()).body
    if not isinstance(reply, BaseIdentity):
        raise AssertionError(f"answered by {reply}")
    return time.perf_counter() - started


def resident(pid: int | str = "self") -> int:
    """Bytes of memory of a process."""
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * _PAGE


def open_files(pid: int | str = "self") -> int:
    """How many files and connections a process has open."""
    return len(list(Path(f"/proc/{pid}/fd").iterdir()))
