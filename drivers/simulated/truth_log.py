"""What really happened, for the evaluation only: ``truth.jsonl``, appended to by both simulated agents."""

from pathlib import Path

import msgspec
import numpy as np

_NAME = "truth.jsonl"


class TruthLog:
    """Appends one JSON object per event to ``<folder>/truth.jsonl``; without a folder it forgets everything.

    Events: ``scan`` (``scan_id``, ``world_from_scanner`` 4x4 with tilt, ``world_from_base``, ``moving``),
    ``collision`` (``pose``), ``drive_begun`` (``goal_id``) and, at its end, ``drive`` (``goal_id``, ``pose``,
    ``distance`` so far), each with ``time`` in simulated seconds.
    """

    def __init__(self, folder: Path | None = None) -> None:
        self._path = folder / _NAME if folder else None
        if folder:
            folder.mkdir(parents=True, exist_ok=True)

    def write(self, event: str, time: float, **values: object) -> None:
        if self._path is None:
            return
        line = msgspec.json.encode({"event": event, "time": time, **values}, enc_hook=_plain)
        # One short append per event, so that two processes may share the file.
        with self._path.open("ab") as file:
            file.write(line + b"\n")


def read_truth(folder: Path) -> list[dict[str, object]]:
    """All events of a truth log, in the order they were written; empty where there is none."""
    path = folder / _NAME
    return [msgspec.json.decode(line) for line in path.read_bytes().splitlines()] if path.exists() else []


def _plain(value: object) -> object:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"cannot write {type(value).__name__} into the truth log")
