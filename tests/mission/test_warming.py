"""The rehearsal runs all stages, and none of them refuses the toy room: what is refused is not rehearsed."""

import contextlib
from pathlib import Path

from mission.stages import warming
from mission.stages.scan_library import Library
from mission.store import RunFolder


def test_every_stage_accepts_the_toy_room(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setattr(warming, "suppress", lambda *_: contextlib.nullcontext())
    warming.warm_up(Library(RunFolder(tmp_path)))
    assert not any(tmp_path.iterdir()), "the mission's own folder is left alone"
