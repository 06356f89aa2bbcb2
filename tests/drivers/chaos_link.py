"""A cable between two ZeroMQ ends that loses, repeats, holds up and swaps whole messages, by a seed.

TCP never does that to a message that arrives, but links that break and come back, brokers, and processes that are
stopped do all of it. What becomes of the n-th message in a direction depends on the seed alone.
"""

import heapq
import math
import random
import threading
import time
from collections import Counter, deque
from collections.abc import Iterable
from dataclasses import dataclass

import zmq

ANY_PORT = "tcp://127.0.0.1:*"
_GLANCE_MS = 20


@dataclass(frozen=True)
class Mischief:
    """Shares of the messages, in each direction, that something befalls, one thing each; the rest passes at once.

    Args:
        reorder: a message waits until another one has passed it, for ``longest_s`` at most.
        hold: with a message the link stops for up to ``longest_s``, and then delivers all that waited at once.
        longest_s: seconds that a message is held up at most.
    """

    drop: float = 0.1
    duplicate: float = 0.1
    delay: float = 0.1
    reorder: float = 0.1
    hold: float = 0.02
    longest_s: float = 0.6


NONE = Mischief(0.0, 0.0, 0.0, 0.0, 0.0)


class _Direction:
    """One way of the cable: when each message is due, and how often."""

    def __init__(self, sink: zmq.Socket, mischief: Mischief, chance: random.Random) -> None:
        self.befell: Counter[str] = Counter()
        self.cut = False
        self._sink = sink
        self._mischief = mischief
        self._chance = chance
        self._waiting: list[tuple[float, int, list[bytes]]] = []
        self._to_be_passed: deque[tuple[float, list[bytes]]] = deque()
        self._held_until = 0.0
        self._count = 0

    def carry(self, message: list[bytes]) -> None:
        """Decide what becomes of a message. The same draws are made for each, so that none depends on the time."""
        drawn, share = self._chance.random(), self._chance.random()
        fate = "drop" if self.cut else self._fate(drawn)
        self.befell[fate] += 1
        now, late = time.monotonic(), share * self._mischief.longest_s
        if fate == "reorder":
            self._to_be_passed.append((now + self._mischief.longest_s, message))
        if fate in ("duplicate", "delay"):
            self._put(now + late, message)
        if fate == "hold":
            self._held_until = max(self._held_until, now + late)
        if fate in ("pass", "duplicate", "hold"):
            self._put(now, message)
            self._follow(now)

    def deliver(self) -> None:
        """All that is due."""
        now = time.monotonic()
        while self._to_be_passed and self._to_be_passed[0][0] <= now:
            # Nobody came to pass it: then it is only late.
            self._put(now, self._to_be_passed.popleft()[1])
        while self._waiting and self._waiting[0][0] <= now >= self._held_until:
            _, _, message = heapq.heappop(self._waiting)
            if not self.cut:
                self._sink.send_multipart(message)

    @property
    def due_in(self) -> float:
        """Seconds until something is due."""
        dues = [first[0][0] for first in (self._waiting, self._to_be_passed) if first]
        return max(min(dues), self._held_until) - time.monotonic() if dues else 1.0

    def _fate(self, drawn: float) -> str:
        for what in ("drop", "duplicate", "delay", "reorder", "hold"):
            drawn -= getattr(self._mischief, what)
            if drawn < 0:
                return what
        return "pass"

    def _follow(self, now: float) -> None:
        """All that was to be passed has been."""
        while self._to_be_passed:
            self._put(now, self._to_be_passed.popleft()[1])

    def _put(self, due: float, message: list[bytes]) -> None:
        self._count += 1
        heapq.heappush(self._waiting, (due, self._count, message))


class ChaosLink:
    """Stands before the ROUTER of an agent, or, as a ``telemetry`` link, before its PUB; connect to :attr:`endpoint`.

    Args:
        target: the agent's endpoint.
        seed: of all that befalls messages; each direction has chances of its own.
    """

    def __init__(self, target: str, seed: str, mischief: Mischief, telemetry: bool = False) -> None:
        context: zmq.Context[zmq.Socket[bytes]] = zmq.Context.instance()
        near, far = (zmq.PUB, zmq.SUB) if telemetry else (zmq.ROUTER, zmq.DEALER)
        self._front, self._back = context.socket(near), context.socket(far)
        for socket in (self._front, self._back):
            socket.setsockopt(zmq.LINGER, 0)
        if telemetry:
            self._back.setsockopt(zmq.SUBSCRIBE, b"")
        self._front.bind(ANY_PORT)
        self.endpoint = self._front.get_string(zmq.LAST_ENDPOINT).rstrip("\0")
        self._back.connect(target)
        ways = {self._back: self._front} if telemetry else {self._back: self._front, self._front: self._back}
        self._ways = {
            source: _Direction(sink, mischief, random.Random(f"{seed} {number}"))
            for number, (source, sink) in enumerate(ways.items())
        }
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def __enter__(self) -> "ChaosLink":
        return self

    def __exit__(self, *exception: object) -> None:
        self._closing.set()
        self._thread.join()

    def cut(self) -> None:
        """From now on all is lost, what waits too."""
        for way in self._ways.values():
            way.cut = True

    def heal(self) -> None:
        for way in self._ways.values():
            way.cut = False

    @property
    def befell(self) -> Counter[str]:
        """How many messages what became of."""
        return sum((way.befell for way in self._ways.values()), Counter())

    def _run(self) -> None:
        poller = zmq.Poller()
        for source in self._ways:
            poller.register(source, zmq.POLLIN)
        with self._front, self._back:
            while not self._closing.is_set():
                for source, _ in poller.poll(self._patience_ms(self._ways.values())):
                    self._ways[source].carry(source.recv_multipart())
                for way in self._ways.values():
                    way.deliver()

    @staticmethod
    def _patience_ms(ways: Iterable[_Direction]) -> int:
        return max(0, math.ceil(min(_GLANCE_MS, *(1000 * way.due_in for way in ways))))
