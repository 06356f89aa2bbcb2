"""The one state machine: where it leads, and that nothing leads anywhere else."""

from contextlib import suppress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from mission.phase import (
    DRIVING,
    ENDED,
    TRANSITIONS,
    UNDER_WAY,
    Course,
    IllegalTransitionError,
    Phase,
    State,
    under_way,
)

STATES = st.builds(State, st.sampled_from(Phase), st.sampled_from(["", "ESTOP", "BASE_LOST"]))


def test_every_phase_is_in_the_table_and_in_one_group() -> None:
    assert set(TRANSITIONS) == set(Phase)
    assert ENDED | UNDER_WAY | {Phase.PREFLIGHT} == set(Phase)
    assert not ENDED & UNDER_WAY


@given(st.lists(STATES, max_size=30))
def test_only_legal_transitions_happen_and_each_is_told_once(wanted: list[State]) -> None:
    told: list[tuple[State, State]] = []
    course = Course(lambda before, after: told.append((before, after)))
    for state in wanted:
        before = course.state
        legal = state == before or state.phase in TRANSITIONS[before.phase]
        if legal:
            assert course.enter(state) is (state != before)
            assert course.state == state
        else:
            with pytest.raises(IllegalTransitionError):
                course.enter(state)
            assert course.state == before
    course_of = [State(Phase.PREFLIGHT), *(after for _, after in told)]
    assert [before for before, _ in told] == course_of[:-1]
    assert all(after.phase in TRANSITIONS[before.phase] for before, after in told)
    assert all(before != after for before, after in told)


@given(st.lists(STATES, min_size=1, max_size=30))
def test_what_has_ended_stays_ended(wanted: list[State]) -> None:
    course = Course()
    for state in wanted:
        ended_as = course.state if course.ended else None
        with suppress(IllegalTransitionError):
            course.enter(state)
        assert ended_as is None or course.state == ended_as


def test_a_mission_ends_well_only_from_work() -> None:
    well = {Phase.DONE, Phase.INCOMPLETE}
    assert {phase for phase in Phase if TRANSITIONS[phase] & well} == {Phase.RUNNING, Phase.ASKING, Phase.RETURNING}


@given(
    st.none() | st.builds(State, st.just(Phase.HOLD), st.sampled_from(["ESTOP", "BASE_LOST"])),
    st.none() | st.just(State(Phase.PAUSED)),
    st.none() | st.text(min_size=1),
    st.booleans(),
)
def test_the_base_may_drive_only_where_nothing_keeps_it(
    hold: State | None, pause: State | None, question: str | None, returning: bool
) -> None:
    state = under_way(hold, pause, question, returning)
    assert state.phase in UNDER_WAY
    assert (state.phase in DRIVING) is (hold is pause is question is None)
    assert hold is None or state == hold


@pytest.mark.parametrize("outcome", ["complete", "incomplete", "aborted", "safety_stop", "fault"])
def test_every_outcome_has_a_phase_to_end_in(outcome: str) -> None:
    assert State.at_the_end(outcome).phase in ENDED


def test_a_phase_is_told_with_its_code_and_words() -> None:
    words = [str(State(Phase.HOLD, *more)) for more in ((), ("ESTOP",), ("ESTOP", "release it"))]
    assert words == ["HOLD", "HOLD(ESTOP)", "HOLD(ESTOP): release it"]
