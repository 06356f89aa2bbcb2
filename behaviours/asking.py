"""The leaf that puts a question to the operator where the robot is at its wits' end."""

from dataclasses import replace

from py_trees.common import Status

from behaviours.job import JobLeaf
from behaviours.keys import Key
from behaviours.survey import Survey
from drivers.jobs import Job
from perception.failure import Failure


class Ask(JobLeaf):
    """Asks what to do about the newest failure: SUCCESS for "again", FAILURE for the default.

    Args:
        what: what has failed, for the operator; ``{room}``, ``{door}`` and ``{place}`` name where.
        advice: what a person could do about it.
        otherwise: the default's name, what happens where nobody can.
    """

    reads = (Key.FAILURE, Key.ROOM, Key.DOOR)
    writes = (Key.SURVEY, Key.QUESTION)

    AGAIN, GO_ON = "again", "go on"

    def __init__(self, name: str, what: str, advice: str, otherwise: str = GO_ON) -> None:
        super().__init__(name)
        self.what = what
        self.advice = advice
        self.otherwise = otherwise

    def start(self) -> Job[str]:
        self._failure: Failure | None = self.read(Key.FAILURE)
        survey: Survey = self.read(Key.SURVEY)
        place = "({:.1f}, {:.1f})".format(*survey.position)
        what = self.what.format(room=self.read(Key.ROOM), door=self.read(Key.DOOR), place=place)
        reason = f" ({self._failure})" if self._failure else ""
        text = f"{what}{reason}. {self.advice} Answer '{self.AGAIN}', or '{self.otherwise}' without it."
        self.say(text)
        self.write(Key.QUESTION, text)
        number = survey.questions_asked + 1
        self.write(Key.SURVEY, replace(survey, questions_asked=number))
        deadline = self.services.clock.now() + self.services.settings.operator.patience_s
        options = (self.AGAIN, self.otherwise)
        return self.services.operator.ask(f"Q{number:03d}", text, options, self.otherwise, deadline)

    def finish(self, value: str) -> Status:
        self.say(value)
        return Status.SUCCESS if value == self.AGAIN else Status.FAILURE

    def terminate(self, new_status: Status) -> None:
        super().terminate(new_status)
        if new_status != Status.INVALID or self.status == Status.RUNNING:
            self.write(Key.QUESTION, None)
