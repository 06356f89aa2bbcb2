"""The report of a mission: what was scanned, how well, why it stopped, in words a surveyor can check."""

from mission.report.build import write_report
from mission.report.run import Run, read_run

__all__ = ["Run", "read_run", "write_report"]
