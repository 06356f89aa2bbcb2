"""The patches of ``benchmarks.guards`` apply, so that a guard that has moved takes its patch with it."""

from pathlib import Path

import pytest

from benchmarks.guards import ROOT, Guard, guards


@pytest.mark.parametrize("guard", guards(), ids=lambda guard: guard.name)
def test_a_guard_stands_where_it_can_be_taken_out_and_its_tests_are_there(guard: Guard) -> None:
    assert guard.file(ROOT).is_file()
    assert guard.there != guard.instead
    assert all((ROOT / test).is_file() for test in guard.tests)


def test_a_guard_that_is_not_there_or_there_twice_is_named(tmp_path: Path) -> None:
    for name in ("a.py", "b.py"):
        (tmp_path / "drivers").mkdir(exist_ok=True)
        (tmp_path / "drivers" / name).write_text("if lease:\n    pass\n")
    for text, places in (("if lease:", "drivers/a.py, drivers/b.py"), ("if held:", "nowhere")):
        with pytest.raises(SystemExit, match=f"(?s)fencing: .*{places}"):
            Guard("fencing", text, "", ()).file(tmp_path)
