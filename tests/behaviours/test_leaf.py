"""The base of every leaf: typed failures, declared keys, and exceptions that stay inside."""

from collections.abc import Callable

import pytest
from py_trees.common import Status

from behaviours.keys import Key
from behaviours.leaf import Leaf
from behaviours.services import connect
from perception.failure import FailureError
from tests.behaviours.bench import Bench, get, put, tick


class Doing(Leaf):
    """A leaf whose step is handed to it."""

    reads = (Key.ROOM,)
    writes = (Key.DOOR,)

    def __init__(self, step: Callable[["Doing"], object], begin: Callable[[], None] = lambda: None) -> None:
        super().__init__("doing")
        self._step = step
        self._begin = begin

    def begin(self) -> None:
        self._begin()

    def step(self) -> Status:
        return self._step(self)  # type: ignore[return-value]


def ticked(bench: Bench, *args: Callable[..., object]) -> tuple[Leaf, Status]:
    leaf = Doing(*args)  # type: ignore[arg-type]
    bench.set_up(leaf)
    return leaf, tick(leaf)


def raising(error: Exception) -> Callable[..., None]:
    def act(*_: object) -> None:
        raise error

    return act


@pytest.mark.parametrize("status", [Status.SUCCESS, Status.FAILURE, Status.RUNNING])
def test_the_three_statuses_pass(status: Status) -> None:
    assert ticked(Bench(), lambda _: status)[1] == status


@pytest.mark.parametrize("answer", [None, True, Status.INVALID, "SUCCESS"])
def test_any_other_answer_is_a_failure_with_a_name(answer: object) -> None:
    bench = Bench()
    _, status = ticked(bench, lambda _: answer)
    assert status == Status.FAILURE
    assert bench.codes == ["LEAF_STATUS"]


def test_a_typed_error_is_put_on_the_blackboard_and_in_the_journal() -> None:
    bench = Bench()
    leaf, status = ticked(bench, raising(FailureError("NAV_NO_MAP", "no map yet", tried=3)))
    assert status == Status.FAILURE
    assert (get(Key.FAILURE).code, get(Key.FAILURE).evidence) == ("NAV_NO_MAP", {"tried": 3})
    (event,) = bench.events
    assert event == {
        "kind": "failure",
        "leaf": "doing",
        "code": "NAV_NO_MAP",
        "message": "no map yet",
        "evidence": {"tried": 3},
    }
    assert leaf.feedback_message == "NAV_NO_MAP: no map yet"


def test_an_exception_is_a_failure_that_names_leaf_and_cause() -> None:
    bench = Bench()
    _, status = ticked(bench, raising(ZeroDivisionError("by zero")))
    assert status == Status.FAILURE
    assert bench.codes == ["LEAF_EXCEPTION"]
    assert get(Key.FAILURE).message == "doing: ZeroDivisionError: by zero"


def test_an_error_at_the_beginning_is_reported_by_the_first_tick_and_forgotten_by_the_next_run() -> None:
    bench = Bench()
    begins = iter([raising(FailureError("NAV_NO_TARGET", "nowhere to go")), lambda: None])
    leaf, status = ticked(bench, lambda _: Status.SUCCESS, lambda: next(begins)())
    assert status == Status.FAILURE
    assert bench.codes == ["NAV_NO_TARGET"]
    assert tick(leaf) == Status.SUCCESS


def test_a_key_that_nobody_wrote_reads_as_none() -> None:
    read = []
    ticked(Bench(), lambda leaf: read.append(leaf.read(Key.ROOM)) or Status.SUCCESS)
    assert read == [None]


@pytest.mark.parametrize("act", [lambda leaf: leaf.read(Key.SURVEY), lambda leaf: leaf.write(Key.ROOM, "R1")])
def test_keys_that_were_not_declared_are_out_of_reach(act: Callable[[Leaf], object]) -> None:
    put(SURVEY="somebody's")
    bench = Bench()
    assert ticked(bench, act)[1] == Status.FAILURE
    assert bench.codes == ["LEAF_EXCEPTION"]


def test_a_tree_set_up_without_services_says_so() -> None:
    with pytest.raises(TypeError, match=r"services=Services\(\.\.\.\), found None"):
        Doing(lambda _: Status.SUCCESS).setup()
    bench = Bench()
    assert connect({"services": bench.services}) is bench.services
