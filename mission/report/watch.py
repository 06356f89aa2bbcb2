"""What was between the mission and its operator: its phases, and what was asked."""

from typing import Any

from mission.report.run import Run

Row = dict[str, Any]


def questions(run: Run) -> list[Row]:
    """Every question that was put, with its answer and whose that is: ``operator``, ``default``, or nobody's."""
    answers = {event.get("question_id"): event for event in run.events_of("answered")}
    return [
        {
            "t": event.get("t"),
            "question_id": event.get("question_id"),
            "text": event.get("text"),
            "answer": answers.get(event.get("question_id"), {}).get("answer", ""),
            "by": answers.get(event.get("question_id"), {}).get("by", "nobody: it was withdrawn"),
        }
        for event in run.events_of("asked")
    ]


def interruptions(run: Run) -> list[Row]:
    """Every time that the robot stood still for its operator or its own sake: since when, why, and for how long."""
    changes = run.events_of("phase")
    ends = [event.get("t") for event in changes[1:]] + [None] * bool(changes)
    return [
        {
            "t": event.get("t"),
            "phase": event.get("after"),
            "code": event.get("code") or "",
            "message": event.get("message") or "",
            "seconds": None if end is None else float(end) - float(event.get("t") or 0.0),
        }
        for event, end in zip(changes, ends, strict=True)
        if event.get("after") in ("paused", "hold", "asking")
    ]
