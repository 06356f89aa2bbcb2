"""Leaves that run before any work in every tick: what the robot and the operator say, and standing still."""

from py_trees.common import Status

from behaviours.conditions import Condition
from behaviours.job import JobLeaf
from behaviours.keys import Key
from behaviours.leaf import Leaf
from drivers.interfaces import BaseState
from drivers.jobs import Job
from perception.failure import Failure


class SenseBase(Leaf):
    """Puts the newest telemetry on the blackboard; its age counts on when none comes."""

    writes = (Key.BASE,)

    def step(self) -> Status:
        state = self.services.base.state()
        self.write(Key.BASE, state)
        self.say("no telemetry yet" if state is None else f"{state.activity}, battery {state.battery:.0%}")
        return Status.SUCCESS


class AbortOrdered(Condition):
    """Whether the operator wants the mission to end."""

    reads = (Key.COMMAND,)

    def holds(self) -> bool:
        return bool(self.read(Key.COMMAND) == "abort")


class EmergencyStopped(Condition):
    """Whether the hardware stop is pressed."""

    reads = (Key.BASE,)

    def holds(self) -> bool:
        state: BaseState | None = self.read(Key.BASE)
        return state is not None and state.emergency_stop


class BaseIsLost(Condition):
    """Whether the base has been silent for too long; it stops by itself then, and so do we."""

    reads = (Key.BASE,)

    def holds(self) -> bool:
        state: BaseState | None = self.read(Key.BASE)
        return state is not None and state.age > self.services.settings.building.base_lost_s


class EndMission(JobLeaf):
    """Brings the base to rest and writes how the mission ended; the outcome is data, not this leaf's status."""

    writes = (Key.OUTCOME,)
    timeout_code = "STOP_TIMEOUT"
    patience_s = 60.0

    def __init__(self, name: str, outcome: str) -> None:
        super().__init__(name)
        self.outcome = outcome

    def start(self) -> Job[None]:
        return self.services.base.stop()

    def timeout(self) -> float:
        return self.patience_s

    def finish(self, value: None) -> Status:
        self.write(Key.OUTCOME, self.outcome)
        return Status.SUCCESS

    def failed(self, failure: Failure) -> Status:
        # The base may be gone for good; the mission has ended all the same.
        self.fail(failure)
        self.write(Key.OUTCOME, self.outcome)
        return Status.SUCCESS
