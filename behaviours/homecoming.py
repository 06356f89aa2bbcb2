"""What is said of a robot that does not come home."""

from dataclasses import replace

from py_trees.common import Status

from behaviours.keys import Key
from behaviours.leaf import Leaf
from behaviours.survey import Survey
from perception.failure import Failure


class Stranded(Leaf):
    """Writes down why the robot ends elsewhere than at the start; before the first scan it never left it."""

    reads = (Key.FAILURE,)
    writes = (Key.SURVEY,)

    def step(self) -> Status:
        survey: Survey = self.read(Key.SURVEY)
        why: Failure = self.read(Key.FAILURE)
        if survey.scans:
            stranded = Failure(why.code, f"the robot did not come home: {why.message}", why.evidence)
            self.write(Key.SURVEY, replace(survey, stranded=stranded))
            self.say(stranded.message)
        return Status.SUCCESS
