"""Recorded scans and buildings of others, beside the repository; a test that needs one is skipped where it is not."""

from pathlib import Path

_DATA = Path(__file__).parents[2] / "shared" / "data"
SCANS, BUILDINGS = _DATA / "scans", _DATA / "buildings"
