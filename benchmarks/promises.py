"""What a mission that broke a promise says of it, for the benchmarks that fly many."""

import traceback


def words(broken: Exception) -> str:
    """The promise that was broken, how, and what was done to the mission, in one line."""
    line = traceback.extract_tb(broken.__traceback__)[-1].line
    kind = "" if isinstance(broken, AssertionError) else f"{type(broken).__name__}: "
    notes = "; ".join(getattr(broken, "__notes__", ()))
    first, *_ = f"{line} {kind}{broken}".strip().splitlines()
    return f"{first} ({notes})" if notes else first
