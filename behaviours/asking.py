"""The leaf that puts a question to the operator where the robot is at its wits' end."""

from dataclasses import replace

from py_trees.common import Status

from behaviours.job import JobLeaf
from behaviours.keys import Key
from behaviours.survey import Survey
from drivers.jobs import Job
from perception.failure import Failure


class Ask(JobLeaf):
    """Asks what to do about the newest failure: SUCCESS for "again", FAILURE for the default, "go on".

    Args:
        what: what has failed, for the operator; ``{room}`` and ``{door}`` name where.
        advice: what a person could do about it.
    """

    reads = (Key.FAILURE, Key.ROOM, Key.DOOR)
    writes = (Key.SURVEY, Key.QUESTION)

    AGAIN, GO_ON = "again", "go on"

    def __init__(self, name: str, what: str, advice: str) -> None:
        super().__init__(name)
        self.what = what
        self.advice = advice

    def start(self) -> Job[str]:
        self._failure: Failure | None = self.read(Key.FAILURE)
        what = self.what.format(room=self.read(Key.ROOM), door=self.read(Key.DOOR))
        reason = f" ({self._failure})" if self._failure else ""
        text = f"{what}{reason}. {self.advice} Answer '{self.AGAIN}', or '{self.GO_ON}' without it."
        self.say(text)
        self.write(Key.QUESTION, text)
        survey: Survey = self.read(Key.SURVEY)
        number = survey.questions_asked + 1
        self.write(Key.SURVEY, replace(survey, questions_asked=number))
        deadline = self.services.clock.now() + self.services.settings.operator.patience_s
        options = (self.AGAIN, self.GO_ON)
        return self.services.operator.ask(f"Q{number:03d}", text, options, self.GO_ON, deadline)

    def finish(self, value: str) -> Status:
        self.say(value)
        return Status.SUCCESS if value == self.AGAIN else Status.FAILURE

    def terminate(self, new_status: Status) -> None:
        super().terminate(new_status)
        if new_status != Status.INVALID or self.status == Status.RUNNING:
            self.write(Key.QUESTION, None)
