"""The end of agents that a mission started for itself, and left behind: nobody else will ever end them."""

import json
import threading
import time
from collections.abc import Callable
from pathlib import Path

from drivers.processes import lives

GRACE_S = 600.0
"""How long agents wait for somebody who takes their mission up, seconds of the wall."""
_GLANCE_S = 1.0


def deserted(
    served: Path,
    grace: float = GRACE_S,
    clock: Callable[[], float] = time.monotonic,
    wait: Callable[[float], None] = time.sleep,
) -> threading.Event:
    """An event that is set when nobody has run the mission for so long.

    Args:
        served: a JSON file in which whoever runs it names his ``pid`` and ``birth`` (:mod:`drivers.processes`); another
            may take his place.
        grace: seconds without such a process, the time before the first one too.
        clock, wait: tell and pass the time.
    """
    over = threading.Event()

    def watch() -> None:
        seen = clock()
        while clock() - seen < grace:
            wait(min(_GLANCE_S, grace / 4))
            if _is_served(served):
                seen = clock()
        over.set()

    threading.Thread(target=watch, name="desertion", daemon=True).start()
    return over


def _is_served(served: Path) -> bool:
    try:
        told = json.loads(served.read_text(encoding="utf-8"))
        return lives(int(told["pid"]), str(told["birth"]))
    except (OSError, ValueError, KeyError, TypeError):
        return False
