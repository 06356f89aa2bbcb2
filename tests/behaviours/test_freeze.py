"""The composite that pauses without interrupting."""

from py_trees.behaviours import StatusQueue
from py_trees.common import Status

from behaviours.freeze import Freeze
from tests.behaviours.bench import Bench, tick
from tests.behaviours.test_job import Stopping

RUN, YES, NO = Status.RUNNING, Status.SUCCESS, Status.FAILURE


class Scripted(StatusQueue):
    """Notes what is done to it."""

    def __init__(self, name: str, *statuses: Status) -> None:
        super().__init__(name, list(statuses), None)
        self.begun = self.ticked = 0
        self.ended: list[Status] = []

    def initialise(self) -> None:
        self.begun += 1

    def update(self) -> Status:
        self.ticked += 1
        return super().update()

    def terminate(self, new_status: Status) -> None:
        self.ended.append(new_status)
        super().terminate(new_status)


def test_frozen_work_is_neither_ticked_nor_stopped_and_goes_on_where_it_was() -> None:
    watch, work = Scripted("watch", NO, RUN, RUN, NO), Scripted("work", RUN, YES)
    freeze = Freeze("freeze", watch, work)
    assert [tick(freeze) for _ in range(4)] == [RUN, RUN, RUN, YES]
    assert (work.begun, work.ticked, work.ended) == (1, 2, [YES])


def test_the_result_is_the_works() -> None:
    for result in (YES, NO):
        assert tick(Freeze("freeze", Scripted("watch", NO), Scripted("work", result))) == result


def test_work_that_was_frozen_from_the_start_has_not_begun() -> None:
    work = Scripted("work", YES)
    assert tick(Freeze("freeze", Scripted("watch", RUN), work)) == RUN
    assert (work.begun, work.status) == (0, Status.INVALID)


def test_a_watch_that_succeeds_stops_the_work() -> None:
    work = Scripted("work", RUN)
    freeze = Freeze("freeze", Scripted("watch", NO, YES), work)
    assert [tick(freeze), tick(freeze)] == [RUN, YES]
    assert work.ended == [Status.INVALID]


def test_an_interrupt_stops_frozen_work_too() -> None:
    work = Scripted("work", RUN)
    freeze = Freeze("freeze", Scripted("watch", NO, RUN), work)
    tick(freeze)
    tick(freeze)
    freeze.stop(Status.INVALID)
    assert (work.ended, work.status) == ([Status.INVALID], Status.INVALID)


def test_the_time_in_which_work_was_frozen_is_no_part_of_its_deadline() -> None:
    bench, work = Bench(), Stopping(limit=60.0)
    watch = Scripted("watch", NO, RUN, RUN, NO, NO, NO)
    freeze = Freeze("freeze", watch, work)
    bench.set_up(freeze)
    for passes in (30.0, 500.0, 500.0, 20.0):
        assert tick(freeze) == RUN
        bench.clock.sleep(passes)
    assert tick(freeze) == RUN, "50 s since it began, not counting the hold"
    bench.clock.sleep(11.0)
    assert (tick(freeze), bench.codes) == (NO, ["STOP_TIMEOUT"])
