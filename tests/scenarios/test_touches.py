"""A robot that touched something moves again only when somebody has looked, and says so."""

import pytest

from tests.scenarios.play import Play
from tests.scenarios.site import row


def touching(*drives: int, attended: bool = True) -> Play:
    """A mission whose drives of these numbers touch something, and an operator who lets it drive on each time."""
    play = Play(row(2), attended=attended)
    play.script.fail("drive", "COLLISION", drives)

    def each_tick(play: Play, ticks: int) -> None:
        for question in play.desk.open:
            play.desk.answer(question.question_id, "again")

    play.each_tick = each_tick
    return play


def test_it_goes_on_to_where_it_was_sent_when_the_operator_lets_it() -> None:
    whole, play = Play(row(2)), touching(1)
    assert whole.run() == "complete"
    assert play.run() == "complete"
    (asked,) = play.events.of("asked")
    assert "touched something" in asked["text"] and "COLLISION" in asked["text"]
    assert "asking" in play.phases
    touched, again = play.base.goals[:2]
    assert (touched.x, touched.y) == (again.x, again.y) and touched.goal_id != again.goal_id
    assert play.rooms == whole.rooms


@pytest.mark.parametrize(
    ("drive", "last", "unfinished"),
    [
        pytest.param(1, "incomplete(COLLISION)", ["COLLISION"], id="to a view"),
        pytest.param(2, "incomplete(COLLISION)", ["COLLISION"], id="to a door"),
        pytest.param(4, "done(COLLISION)", [], id="home"),
    ],
)
def test_without_an_answer_nothing_moves_any_more(drive: int, last: str, unfinished: list[str]) -> None:
    play = touching(drive, attended=False)
    play.run()
    assert play.phases[-1] == last
    assert len(play.base.goals) == drive
    assert play.events.codes == ["COLLISION"]
    building = play.survey.building
    partial = [room.reason for room in building.rooms if room.status == "partial"]
    assert partial + [door.reason for door in building.unfinished_doors()] == unfinished


def test_it_is_asked_each_time_and_gives_the_goal_up_when_it_always_touches() -> None:
    play = touching(*range(1, 7))
    assert play.run() == "complete"
    assert len(play.events.of("asked")) == 6
    views = [(goal.x, goal.y) for goal in play.base.goals]
    assert len(set(views[:6])) == 1 and views[6] != views[0], "the view is left aside for another"
