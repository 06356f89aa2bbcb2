"""Leaves that run before any work in every tick: what the robot and the operator say, and standing still."""

from typing import ClassVar

from py_trees.common import Status

from behaviours.conditions import Condition
from behaviours.fence import fence_of
from behaviours.job import JobLeaf
from behaviours.keys import Key
from behaviours.leaf import Leaf
from behaviours.survey import Survey
from drivers.interfaces import BaseState
from drivers.jobs import Done, Job
from perception.building import contains
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


class Paused(Leaf):
    """RUNNING while the operator wants the robot to stand still, else FAILURE: nothing to wait for."""

    reads = (Key.COMMAND,)

    def step(self) -> Status:
        paused = self.read(Key.COMMAND) == "pause"
        self.say("paused by the operator" if paused else "")
        return Status.RUNNING if paused else Status.FAILURE


class Hold(Leaf):
    """Stands still for as long as something is wrong with the robot, and asks when that has taken too long.

    FAILURE says that there is nothing to hold for, so that the work goes on; SUCCESS that the mission is to end. A
    concrete leaf says in :meth:`trouble` what is wrong and in :meth:`limit` how long (mission seconds) that is borne.
    Its questions are named by its code, and not numbered with those of the work.
    """

    reads: ClassVar[tuple[Key, ...]] = (Key.BASE,)
    writes = (Key.HOLD, Key.QUESTION)
    code: ClassVar[str]
    until_told: ClassVar[bool] = False
    """Whether the operator must say so before the work goes on, even when the trouble is over."""

    WAIT, RESUME, END = "wait", "resume", "end"

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._questions = 0

    def trouble(self, base: BaseState) -> str | None:
        """What is wrong, in plain words with what to do about it; None if nothing is."""
        raise NotImplementedError(type(self).__name__)

    def limit(self) -> float:
        raise NotImplementedError(type(self).__name__)

    def begin(self) -> None:
        self._since: float | None = None
        self._asked_for = ""
        self._question: Job[str] | None = None

    def step(self) -> Status:
        base: BaseState | None = self.read(Key.BASE)
        words = None if base is None else self.trouble(base)
        now = self.services.clock.now()
        if words is None:
            if self._since is None or not self.until_told:
                return Status.FAILURE
            self._show("the trouble is over; it waits for the operator's word")
            return self._ask("The trouble is over. Shall the mission go on?", self.RESUME)
        self._since = now if self._since is None else self._since
        self._show(words)
        if now - self._since <= self.limit():
            self._withdraw()
            return Status.RUNNING
        return self._ask(f"{words} Wait on?", self.WAIT)

    def terminate(self, new_status: Status) -> None:
        if new_status == Status.INVALID and self.status != Status.RUNNING:
            return
        self._withdraw()
        hold: Failure | None = self.read(Key.HOLD)
        # After SUCCESS the mission ends in this very hold.
        if new_status != Status.SUCCESS and hold is not None and hold.code == self.code:
            self.write(Key.HOLD, None)

    def _show(self, words: str) -> None:
        self.say(f"{self.code}: {words}")
        self.write(Key.HOLD, Failure(self.code, words))

    def _ask(self, text: str, go_on: str) -> Status:
        if self._asked_for != go_on:
            self._withdraw()
            self._asked_for = go_on
            self._question = self._put(f"{self.code}: {text}", go_on)
        assert self._question is not None
        outcome = self._question.poll()
        if not isinstance(outcome, Done):
            return Status.RUNNING
        self._withdraw()
        if outcome.value == self.END:
            self.fail(Failure(self.code, text.partition("?")[0]))
            return Status.SUCCESS
        self._since = self.services.clock.now()
        return Status.FAILURE if outcome.value == self.RESUME else Status.RUNNING

    def _put(self, text: str, go_on: str) -> Job[str]:
        self._questions += 1
        self.write(Key.QUESTION, text)
        deadline = self.services.clock.now() + self.services.settings.operator.patience_s
        name = f"{self.code}-{self._questions}"
        return self.services.operator.ask(name, text, (go_on, self.END), self.END, deadline)

    def _withdraw(self) -> None:
        if self._question is not None:
            self._question.cancel()
            self.write(Key.QUESTION, None)
        self._question, self._asked_for = None, ""


class HoldForEmergencyStop(Hold):
    """The hardware stop is pressed: until it is released, and the operator says so too."""

    code = "ESTOP"
    until_told = True

    def trouble(self, base: BaseState) -> str | None:
        return "The emergency stop is pressed; release it, then resume." if base.emergency_stop else None

    def limit(self) -> float:
        return self.services.settings.building.release_s


class HoldForLostBase(Hold):
    """The base has been silent for too long. It stops by itself then; when it comes back the work goes on."""

    code = "BASE_LOST"

    def trouble(self, base: BaseState) -> str | None:
        if base.age <= self.services.settings.building.base_lost_s:
            return None
        return f"The base has been silent for {base.age:.0f} s; see whether it and its network are up."

    def limit(self) -> float:
        return self.services.settings.building.base_return_s


class HoldForLease(Hold):
    """The base is nobody's, or somebody else's: it is asked for again while it is free, and never fought over."""

    code = "LEASE_LOST"
    asks_again_s = 2.0

    def begin(self) -> None:
        super().begin()
        self._asked_at = float("-inf")

    def trouble(self, base: BaseState) -> str | None:
        if base.owner == self.services.owner:
            return None
        if base.owner:
            return f"The base belongs to {base.owner} now; end that mission, or this one."
        now = self.services.clock.now()
        if now - self._asked_at >= self.asks_again_s:
            self._asked_at = now
            self.services.base.acquire(self.services.owner)
        return "The base has forgotten whose it is; it is asked for again."

    def limit(self) -> float:
        return self.services.settings.building.base_return_s


class HoldForRogueBase(Hold):
    """The base moves though no drive is under way: it is pushed, or obeys somebody else. It is told to stand still."""

    code = "BASE_ROGUE"
    reads = (Key.BASE, Key.COMMAND)
    rolls_out_s, rolls_out_ticks = 5.0, 50
    """A drive that was broken off, and the news of its end, take this long at most; in a pause mission time stands."""
    tells_again_s = 2.0

    def __init__(self, name: str) -> None:
        super().__init__(name)
        self._moves_since, self._moving_ticks = 0.0, 0
        self._told_at = float("-inf")

    def trouble(self, base: BaseState) -> str | None:
        now = self.services.clock.now()
        # A drive that is paused explains no motion.
        drives = self.services.interlock.driving and self.read(Key.COMMAND) != "pause"
        if not base.moving or drives:
            self._moving_ticks = 0
            return None
        if self._moving_ticks == 0:
            self._moves_since = now
        self._moving_ticks += 1
        if now - self._moves_since <= self.rolls_out_s and self._moving_ticks <= self.rolls_out_ticks:
            return None
        if now - self._told_at >= self.tells_again_s:
            self._told_at = now
            self.services.base.stop()
        return "The base moves though no drive is under way; see who pushes or steers it."

    def limit(self) -> float:
        return self.services.settings.building.release_s


class HoldForFence(Hold):
    """The robot stands outside of its fence: pushed there, or lost. It comes back only by somebody's hand and word."""

    code = "GEOFENCE"
    reads = (Key.BASE, Key.SURVEY)
    until_told = True

    def trouble(self, base: BaseState) -> str | None:
        survey: Survey = self.read(Key.SURVEY)
        # Not by the base's own localisation: before its first drive that is still in another mission's map.
        boundary, pose = fence_of(survey, self.services.settings), survey.reckoned_pose(base)
        if boundary is None or pose is None or contains(boundary, pose[:2, 3]):
            return None
        x, y = pose[:2, 3]
        return f"The robot is outside of its fence, at ({x:.1f}, {y:.1f}); bring it back inside, then resume."

    def limit(self) -> float:
        return self.services.settings.building.release_s


class HoldForBattery(Hold):
    """So little charge is left that driving on would strand the robot somewhere worse."""

    code = "BATTERY_CRITICAL"

    def trouble(self, base: BaseState) -> str | None:
        battery = self.services.settings.battery
        # What has begun to charge goes on only when it may go on for a while.
        enough = battery.low if self._since is not None else battery.critical
        return None if base.battery >= enough else f"The battery is at {base.battery:.0%}; charge it where it stands."

    def limit(self) -> float:
        return self.services.settings.battery.charging_s


class HoldForDisk(Hold):
    """So little room is left on the disk that the next scan might not fit: it is not taken before there is more."""

    code = "DISK_FULL"

    def trouble(self, base: BaseState) -> str | None:
        free, needed = self.services.files.free_gb(), self.services.settings.scanning.min_free_gb
        if free >= needed:
            return None
        return f"{free:.2f} GB are free on the disk of the run folder, {needed:.2f} GB needed; make room."

    def limit(self) -> float:
        return self.services.settings.scanning.room_s


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
