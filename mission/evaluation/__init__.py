"""A run against the building as it is: the one place where the mission's account meets the simulator's truth."""

from mission.evaluation.evaluate import Evaluation, evaluate, evaluate_run
from mission.evaluation.settings import EvaluationSettings

__all__ = ["Evaluation", "EvaluationSettings", "evaluate", "evaluate_run"]
