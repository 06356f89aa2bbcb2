"""A base whose executive dies, hangs or is cut off: real sockets, real processes, simulated wheels."""

import random
import time
from collections.abc import Callable, Iterator
from itertools import count, pairwise

import pytest

from drivers.jobs import Running
from drivers.wire.base_client import BaseClient
from tests.drivers.beating import PLACES, TICK_S, goal, load_map
from tests.drivers.dead_man import FAULTS, Bench, Halt, bench, halts_by, halts_by_kill, obeyed_after_takeover
from tests.drivers.wire_fakes import IMPATIENT, eventually, failure_of, value_of

pytestmark = pytest.mark.xdist_group("dead man")
"""Its fixture is a base on real time, which nobody else should keep from the processor: one process has it."""

ROUNDS = 3


@pytest.fixture(scope="module")
def rig(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    with bench(tmp_path_factory.mktemp("dead man")) as ready:
        yield ready


@pytest.fixture
def pauses() -> Iterator[float]:
    chance = random.Random(4)
    return iter(lambda: chance.uniform(0.1, 0.6), None)


@pytest.mark.parametrize("fault", FAULTS)
def test_the_wheels_stand_half_a_second_after_the_last_beat_and_the_drive_goes_on(fault, rig, pauses):
    halts = list(halts_by(fault, rig, ROUNDS, pauses))
    assert len(halts) == ROUNDS and all(halt.kept for halt in halts), halts


def test_the_wheels_stand_half_a_second_after_the_last_beat_of_an_executive_that_was_killed(rig, pauses):
    halts = list(halts_by_kill(rig, 2, pauses))
    assert len(halts) == 2 and all(halt.kept for halt in halts), halts


def test_a_second_executive_is_refused_at_once_and_told_who_the_first_is(rig):
    """However long the first one may be kept from beating by a busy machine."""
    with rig.agent(stale_after=60.0) as agent, rig.executive("ann", agent), rig.executive("bob", agent) as second:
        assert second.first_word["refused"] == "LEASE_HELD"
        assert "ann" in str(second.first_word["message"])
        assert second.process.wait(10.0) == 0


@pytest.mark.parametrize("fault", ["SIGSTOP", "link cut"])
def test_an_owner_who_was_thought_dead_moves_nothing_when_he_comes_back(fault, rig):
    """Struck while driving, succeeded, back again: all that waited and all that he still says is refused."""
    assert obeyed_after_takeover(fault, rig, f"succeeded after {fault}") == 0
    assert not rig.base.moving


def test_an_executive_that_lives_but_may_not_move_stands_with_its_goal_and_goes_on(rig):
    """The pause, and the interlock of a scan: half a second to rest; a stop is obeyed meanwhile."""
    ticks = count(1)

    def tick_until(holds: Callable[[], bool], may_move: bool) -> None:
        def tick() -> bool:
            client.beat(next(ticks), may_move)
            time.sleep(TICK_S / 2)
            return holds()

        eventually(tick)

    def halt() -> Halt:
        looked = [time.monotonic()]
        tick_until(lambda: looked.append(time.monotonic()) or not rig.base.moving, may_move=False)
        return Halt(looked[-1] - looked[0], max(b - a for a, b in pairwise(looked)))

    with rig.agent() as agent:
        client = BaseClient(agent.endpoints, IMPATIENT)
        value_of(client.acquire("pausing"))
        job = client.drive(goal("paused", load_map(rig.map_file), PLACES[1], client))
        tick_until(lambda: rig.base.moving, may_move=True)
        assert (stood := halt()).kept, stood
        at = rig.base.stance().map_from_base
        tick_until(lambda: client.state().activity == "held", may_move=False)
        tick_until(iter([False] * 10 + [True]).__next__, may_move=False)
        assert (rig.base.stance().map_from_base == at).all()
        assert isinstance(job.poll(), Running)
        tick_until(lambda: rig.base.moving, may_move=True)
        tick_until(lambda: client.state().activity == "held", may_move=False)
        value_of(client.stop())
        assert failure_of(job).code == "CANCELLED"
        value_of(client.release())
        eventually(lambda: client.state().owner == "")
        client.close()
