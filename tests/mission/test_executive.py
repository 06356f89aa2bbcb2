"""The tick loop: what it records, and how it ends."""

from dataclasses import replace

import pytest
from py_trees.behaviour import Behaviour
from py_trees.behaviours import Running, StatusQueue
from py_trees.blackboard import Blackboard
from py_trees.common import Status
from py_trees.composites import Sequence

from behaviours.keys import Key
from behaviours.safety import EndMission
from behaviours.survey import Survey, Target
from mission.clock import MissionClock
from mission.executive import TICK, Executive, active_branch, verdict
from mission.phase import Phase, State
from perception.building import Building
from perception.failure import Failure, FailureError
from perception.findings import Door
from tests.behaviours.bench import Bench, HandJob

DOOR = Door(3.0, 0.0, (1.0, 0.0), 0.9, 0.9, 2.1, 0.9)


class ObedientBench(Bench):
    """A bench whose base stops at once."""

    def __init__(self) -> None:
        super().__init__()
        self.services.base.stop = self._stop  # type: ignore[method-assign]
        self.services.interlock.set_out("a drive")
        self.stops = 0

    def _stop(self) -> HandJob:
        self.stops += 1
        job = HandJob()
        job.done()
        return job


class Ending(Behaviour):
    """Runs for so many ticks and then writes how the mission ended, or just ends."""

    def __init__(self, ticks: int, outcome: str | None) -> None:
        super().__init__("ending")
        self.left, self.outcome = ticks, outcome
        self.commands: list[str] = []

    def update(self) -> Status:
        self.commands.append(Blackboard.get(Key.COMMAND))
        self.left -= 1
        if self.left:
            return Status.RUNNING
        if self.outcome is not None:
            Blackboard.set(Key.OUTCOME, self.outcome)
        return Status.SUCCESS


def mission_clock(bench: Bench) -> MissionClock:
    return MissionClock(source=bench.clock.now, wait=bench.clock.sleep)


def executed(root: Behaviour, bench: Bench | None = None, **kwargs: object) -> tuple[ObedientBench, str]:
    bench = bench or ObedientBench()
    return bench, Executive(root, bench.services, mission_clock(bench), **kwargs).run()  # type: ignore[arg-type, return-value]


def rooms(*statuses: str) -> Survey:
    building = Building()
    for number, status in enumerate(statuses):
        building, room_id = building.add_room((10.0 * number, 0.0))
        building = building.end_room(room_id, status, "scripted")
    return replace(Survey(), building=building)


# --- outcomes -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("outcome", ["aborted", "safety_stop"])
def test_the_outcome_is_what_the_tree_wrote(outcome: str) -> None:
    bench, found = executed(Ending(3, outcome))
    assert found == outcome
    assert bench.stops == 1


def test_a_mission_that_cannot_be_told_again_is_a_fault_with_its_own_code_and_words() -> None:
    def diverge(_: object) -> None:
        raise FailureError("RESUME_DIVERGED", "job 3 was take S01, but this tree begins drive G01")

    bench = ObedientBench()
    executive = Executive(Ending(1, "finished"), bench.services, mission_clock(bench), recall=diverge)  # type: ignore[arg-type]
    assert executive.run() == "fault"
    assert str(executive.course.state) == ("FAULT(RESUME_DIVERGED): job 3 was take S01, but this tree begins drive G01")


def test_a_tree_that_ends_without_an_outcome_is_a_fault() -> None:
    bench, found = executed(Ending(2, None))
    assert (found, bench.stops) == ("fault", 1)


def test_a_finished_mission_without_any_room_is_not_complete() -> None:
    assert executed(Ending(1, "finished"))[1] == "incomplete"


@pytest.mark.parametrize(
    ("survey", "expected"),
    [
        (rooms(), "incomplete"),
        (rooms("complete"), "complete"),
        (rooms("complete", "partial"), "incomplete"),
        (rooms("complete", "open"), "incomplete"),
    ],
)
def test_the_verdict_asks_for_every_room(survey: Survey, expected: str) -> None:
    assert verdict(survey) == expected


@pytest.mark.parametrize("state", ["unexplored", "deferred", "refused", "linked", "passed"])
def test_the_verdict_asks_for_every_door(state: str) -> None:
    survey = rooms("complete")
    building = survey.building.observe_doors("R1", [DOOR])
    building = replace(building, doors=(replace(building.doors[0], state=state),))
    done = state in ("linked", "passed")
    assert verdict(replace(survey, building=building)) == ("complete" if done else "incomplete")


def test_an_end_that_asks_the_base_to_stop_waits_for_it() -> None:
    bench, found = executed(EndMission("end", "aborted"))
    assert (found, bench.stops) == ("aborted", 2)


# --- ways out -------------------------------------------------------------------------------------------------------


def test_a_tree_that_cannot_be_set_up_is_a_fault_and_the_base_is_told_to_stop() -> None:
    class Unready(Running):
        def setup(self, **kwargs: object) -> None:
            raise OSError("no such device")

    bench, found = executed(Unready("unready"))
    assert (found, bench.stops) == ("fault", 1)
    assert bench.codes == ["TICK_EXCEPTION"]


def test_an_exception_in_mid_tick_leaves_no_node_running() -> None:
    """The sequence is in its first tick and does not know yet that its first child runs."""

    class Breaking(StatusQueue):
        def update(self) -> Status:
            self.status = Status.RUNNING
            raise RuntimeError("a bug in a node of somebody else")

    root = Sequence(
        "root", memory=True, children=[StatusQueue("ok", [Status.SUCCESS], None), Breaking("bad", [], None)]
    )
    bench, found = executed(root)
    assert (found, bench.stops) == ("fault", 1)
    assert {node.status for node in root.iterate()} == {Status.INVALID}


def test_a_node_that_cannot_be_stopped_does_not_keep_the_base_driving() -> None:
    class Stubborn(Ending):
        def terminate(self, new_status: Status) -> None:
            if new_status == Status.INVALID:
                raise RuntimeError("will not")

    bench, found = executed(Stubborn(2, "aborted"))
    assert (found, bench.stops) == ("aborted", 1)


def test_a_base_that_never_confirms_is_waited_for_a_while() -> None:
    bench = Bench()
    executed(Ending(1, "aborted"), bench)
    assert [name for name, _, _ in bench.calls] == ["stop"]
    assert 1.0 <= bench.clock.now() <= 10.0


# --- what it tells --------------------------------------------------------------------------------------------------


def test_each_change_of_a_node_is_one_event_with_its_path() -> None:
    child = StatusQueue("child", [Status.RUNNING, Status.RUNNING, Status.SUCCESS], None)
    root = Sequence("root", memory=True, children=[child, Ending(1, "aborted")])
    bench, _ = executed(root)
    changes = [(event["path"], event["before"], event["after"]) for event in bench.events]
    assert changes == [
        ("/root", "INVALID", "RUNNING"),
        ("/root/child", "INVALID", "RUNNING"),
        ("/root", "RUNNING", "SUCCESS"),
        ("/root/child", "RUNNING", "SUCCESS"),
        ("/root/ending", "INVALID", "SUCCESS"),
        ("/root", "SUCCESS", "INVALID"),
        ("/root/child", "SUCCESS", "INVALID"),
        ("/root/ending", "SUCCESS", "INVALID"),
    ]


def test_the_command_is_asked_for_before_each_tick() -> None:
    words = iter(["run", "run", "abort"])
    root = Ending(3, "aborted")
    executed(root, command=lambda: next(words))
    assert root.commands == ["run", "run", "abort"]


def test_every_tick_beats_once_and_lets_the_base_move_only_when_nothing_is_ordered() -> None:
    words = iter(["run", "pause", "pause", "run", "abort"])
    bench, _ = executed(Ending(5, "aborted"), command=lambda: next(words))
    assert bench.beats == [(1, True), (2, False), (3, False), (4, True), (5, False)]


def test_a_held_interlock_keeps_the_base_where_it_is() -> None:
    bench = ObedientBench()
    bench.services.interlock.hold("a scan")
    executed(Ending(2, "aborted"), bench)
    assert {may_move for _, may_move in bench.beats} == {False}


def test_nothing_moves_but_what_drives_here() -> None:
    """The base may have a goal still that the mission has given up, because a link was silent for too long."""
    bench = ObedientBench()
    bench.services.interlock.arrive("a drive")
    executed(Ending(2, "aborted"), bench)
    assert {may_move for _, may_move in bench.beats} == {False}


class Waiting(Ending):
    """Keeps something on the blackboard that a mission waits for."""

    def __init__(self, key: Key, value: object) -> None:
        super().__init__(3, "aborted")
        self.key, self.value = key, value

    def update(self) -> Status:
        Blackboard.set(self.key, self.value)
        return super().update()


@pytest.mark.parametrize(("key", "value"), [(Key.HOLD, Failure("DISK_FULL", "no room")), (Key.QUESTION, "go on?")])
def test_nothing_may_move_while_the_mission_holds_or_asks(key: Key, value: object) -> None:
    bench, _ = executed(Waiting(key, value))
    assert [may_move for _, may_move in bench.beats] == [False] * 3


def test_mission_time_stands_still_while_it_is_paused() -> None:
    words = iter(["run", "run", *["pause"] * 8, "run", "run"])
    bench, times = ObedientBench(), []
    clock = mission_clock(bench)
    Executive(
        Ending(12, "aborted"), bench.services, clock, lambda: next(words), lambda _: times.append(clock.now())
    ).run()
    assert times[2:10] == pytest.approx([2 * TICK] * 8)
    assert times[-1] == pytest.approx(3 * TICK)


@pytest.mark.parametrize(
    ("keys", "expected"),
    [
        ({Key.HOLD: Failure("ESTOP", "release it"), Key.QUESTION: "go on?"}, State(Phase.HOLD, "ESTOP", "release it")),
        ({Key.QUESTION: "again?"}, State(Phase.ASKING, message="again?")),
        ({Key.TARGET: Target("G001", 0.0, 0.0, None, "start")}, State(Phase.RETURNING)),
        ({Key.TARGET: Target("G001", 0.0, 0.0, None, "view")}, State(Phase.RUNNING)),
    ],
)
def test_the_phase_is_what_the_blackboard_tells(keys: dict[Key, object], expected: State) -> None:
    class Telling(Ending):
        def update(self) -> Status:
            for key, value in keys.items():
                Blackboard.set(key, value)
            return super().update()

    seen = []
    bench = ObedientBench()
    executive = Executive(
        Telling(2, "aborted"),
        bench.services,
        mission_clock(bench),
        after_tick=lambda _: seen.append(executive.course.state),
    )
    executive.run()
    assert seen[0] == expected
    assert executive.course.state == State(Phase.ABORTED)


def test_ticks_are_counted_and_a_tick_apart() -> None:
    ticks: list[tuple[int, float]] = []
    bench = ObedientBench()
    executed(Ending(3, "aborted"), bench, after_tick=lambda number: ticks.append((number, bench.clock.now())))
    assert [number for number, _ in ticks] == [1, 2, 3]
    assert [at for _, at in ticks] == pytest.approx([0.0, TICK, 2 * TICK])


def test_it_says_whether_the_last_tick_changed_the_survey() -> None:
    class Surveying(Ending):
        def update(self) -> Status:
            if self.left == 2:
                Blackboard.set(Key.SURVEY, rooms("open"))
            return super().update()

    changed = []
    bench = ObedientBench()
    executive = Executive(
        Surveying(3, "aborted"),
        bench.services,
        mission_clock(bench),
        after_tick=lambda _: changed.append(executive.changed),
    )
    executive.run()
    assert changed == [False, True, False]


def test_nothing_of_an_earlier_mission_is_left_on_the_blackboard() -> None:
    for key in Key:
        Blackboard.set(key, "old")
    seen = []

    class Looking(Ending):
        def update(self) -> Status:
            seen.extend(key for key in Key if Blackboard.exists(key) and Blackboard.get(key) == "old")
            return super().update()

    executed(Looking(1, "aborted"))
    assert seen == []


def test_the_active_branch_ends_at_the_leaf_that_runs() -> None:
    leaf = Running("at work")
    inner = Sequence("inner", memory=True, children=[StatusQueue("done", [Status.SUCCESS], None), leaf])
    root = Sequence("root", memory=True, children=[inner])
    assert active_branch(root) == []
    root.tick_once()
    assert active_branch(root) == [root, inner, leaf]
