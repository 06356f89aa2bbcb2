"""Scripted agents that outlive an executive: asked again by a name they know, they say how that goes."""

from drivers.interfaces import DriveGoal, ScanSettings
from perception.transforms import Matrix
from tests.scenarios.scripted import Script, ScriptedBase, ScriptedJob, ScriptedScanner
from tests.scenarios.site import Site


class LastingBase(ScriptedBase):
    """A base agent as it is: asked for a goal that it knows, it says how that goes."""

    def __init__(self, site: Site, script: Script, owner: str = "") -> None:
        super().__init__(site, script, owner)
        self._jobs: dict[str, ScriptedJob] = {}

    def drive(self, goal: DriveGoal) -> ScriptedJob:
        if goal.goal_id not in self._jobs:
            self._jobs[goal.goal_id] = super().drive(goal)
        return self._jobs[goal.goal_id]

    def reboot(self, at: tuple[float, float, float] | None = None) -> None:
        """Its next process knows no goal of the one before."""
        super().reboot(at)
        self._jobs.clear()


class LastingScanner(ScriptedScanner):
    """A scanner agent as it is: a name is taken once, unless that was cancelled."""

    def __init__(self, base: ScriptedBase, script: Script) -> None:
        super().__init__(base, script)
        self._jobs: dict[str, ScriptedJob] = {}

    def take(self, scan_id: str, settings: ScanSettings, odom_from_base: Matrix) -> ScriptedJob:
        if scan_id in self._jobs and self._jobs[scan_id].cancelled:
            del self._jobs[scan_id], self.taken[scan_id]
        if scan_id not in self._jobs:
            self._jobs[scan_id] = super().take(scan_id, settings, odom_from_base)
        return self._jobs[scan_id]
