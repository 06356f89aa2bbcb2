"""Who may move the base, and until when: one owner, fresh nonces only, and an old lease never counts again."""

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import Bundle, RuleBasedStateMachine, invariant, rule

from drivers.lease import LIMIT_S, NEVER, STALE_S, LeaseKeeper
from drivers.simulated.clock import VirtualClock
from perception.failure import FailureError

EPOCH = 7


class Desk:
    """A keeper on a clock that is advanced by hand."""

    def __init__(self) -> None:
        self.clock = VirtualClock()
        self.keeper = LeaseKeeper(EPOCH, self.clock.now)

    @property
    def may_move(self) -> bool:
        return self.clock.now() < self.keeper.moves_until

    def beat(self, lease, tick, may_move=True, nonce=None):
        return self.keeper.beat(lease.number, self.keeper.nonce() if nonce is None else nonce, tick, may_move)


@pytest.fixture
def desk() -> Desk:
    return Desk()


def code_of(act, *args) -> str:
    with pytest.raises(FailureError) as refused:
        act(*args)
    return refused.value.failure.code


def test_the_wheels_turn_until_the_limit_after_the_nonce_and_not_after_the_beat(desk):
    lease = desk.keeper.acquire("A")
    nonce = desk.keeper.nonce()
    desk.clock.sleep(0.3)
    assert desk.beat(lease, 1, nonce=nonce)
    assert desk.keeper.moves_until == pytest.approx(LIMIT_S)
    desk.clock.sleep(LIMIT_S - 0.3 - 1e-6)
    assert desk.may_move
    desk.clock.sleep(2e-6)
    assert not desk.may_move


def test_a_lease_alone_moves_nothing(desk):
    desk.keeper.acquire("A")
    assert not desk.may_move


def test_a_beat_that_echoes_an_old_nonce_or_none_that_ever_was_does_not_count(desk):
    lease = desk.keeper.acquire("A")
    nonce = desk.keeper.nonce()
    desk.clock.sleep(LIMIT_S)
    assert not desk.beat(lease, 1, nonce=nonce)
    assert not desk.beat(lease, 1, nonce=12345)
    assert not desk.may_move
    assert desk.beat(lease, 1)


def test_a_beat_that_counts_lets_the_wheels_turn_also_at_the_last_instant():
    """Sums of hundredths are rounded: what is young enough to count must not be too old to move by."""
    for start in range(100):
        fresh = Desk()
        lease = fresh.keeper.acquire("A")
        fresh.clock.sleep(start / 100)
        nonce = fresh.keeper.nonce()
        fresh.clock.sleep(LIMIT_S)
        assert fresh.beat(lease, 1, nonce=nonce) == fresh.may_move


def test_a_beat_that_was_overtaken_or_repeated_does_not_lift_a_pause(desk):
    lease = desk.keeper.acquire("A")
    assert desk.beat(lease, 5)
    assert desk.beat(lease, 7, may_move=False)
    assert not desk.may_move
    assert not desk.beat(lease, 6)
    assert not desk.beat(lease, 7)
    assert not desk.may_move
    assert desk.beat(lease, 8)
    assert desk.may_move


def test_a_second_owner_is_refused_and_told_who_is_the_first(desk):
    first = desk.keeper.acquire("ann@robot process 7")
    desk.clock.sleep(0.2)
    with pytest.raises(FailureError) as refused:
        desk.keeper.acquire("bob")
    failure = refused.value.failure
    assert failure.code == "LEASE_HELD" and "ann@robot process 7" in failure.message
    assert failure.evidence["owner"] == "ann@robot process 7"
    assert failure.evidence["silent_s"] == pytest.approx(0.2)
    assert failure.evidence["free_in_s"] == pytest.approx(STALE_S - 0.2)
    assert desk.keeper.holds(first.number)


def test_an_owner_who_beats_keeps_the_lease_and_one_who_stands_still_too(desk):
    lease = desk.keeper.acquire("A")
    for tick in range(1, 100):
        desk.clock.sleep(0.1)
        assert desk.beat(lease, tick, may_move=False)
    assert code_of(desk.keeper.acquire, "B") == "LEASE_HELD"


def test_a_silent_owner_may_be_succeeded_and_is_refused_for_ever(desk):
    old = desk.keeper.acquire("A")
    assert desk.beat(old, 1)
    desk.clock.sleep(STALE_S)
    assert desk.keeper.owner == ""
    new = desk.keeper.acquire("B")
    assert new.number > old.number and desk.keeper.owner == "B"
    for _ in range(3):
        assert code_of(desk.beat, old, 2) == "LEASE_LOST"
        assert code_of(desk.keeper.require, old.number) == "LEASE_LOST"
        desk.clock.sleep(STALE_S)
    assert not desk.keeper.release(old.number)
    assert desk.keeper.holds(new.number)


def test_a_silent_owner_whom_nobody_succeeded_goes_on(desk):
    lease = desk.keeper.acquire("A")
    desk.clock.sleep(10 * STALE_S)
    assert desk.beat(lease, 1)
    assert desk.may_move and desk.keeper.owner == "A"


def test_what_the_one_before_was_allowed_does_not_pass_on(desk):
    first = desk.keeper.acquire("A")
    assert desk.beat(first, 900)
    assert desk.keeper.release(first.number)
    assert not desk.may_move
    second = desk.keeper.acquire("B")
    assert not desk.may_move
    assert desk.beat(second, 1), "the ticks of another mission are counted anew"


def test_the_loss_names_the_owner_and_keeps_how_far_one_came(desk):
    lease = desk.keeper.acquire("A")
    desk.keeper.release(lease.number)
    desk.keeper.acquire("B")
    failure = desk.keeper.lost({"track": [1], "owner": "x", "code": "X"}).failure
    assert (failure.code, failure.evidence) == ("LEASE_LOST", {"track": [1], "owner": "B", "code": "X"})
    assert "held by B" in failure.message


class Keeper(RuleBasedStateMachine):
    """Any number of owners with any leases, nonces and ticks, old ones above all, against a list of what happened."""

    leases = Bundle("leases")
    nonces = Bundle("nonces")

    def __init__(self) -> None:
        super().__init__()
        self.desk = Desk()
        self.counts_until: dict[int, float] = {}
        self.given: list[tuple[int, int]] = []
        self.given_up: set[tuple[int, int]] = set()
        self.accepted: list[tuple[tuple[int, int], int, int, bool]] = []
        self.heard = NEVER

    @property
    def now(self) -> float:
        return self.desk.clock.now()

    @property
    def holder(self) -> tuple[int, int] | None:
        """Nobody but the last one who was given the lease, unless he gave it back."""
        return self.given[-1] if self.given and self.given[-1] not in self.given_up else None

    @rule(seconds=st.sampled_from([0.01, 0.1, 0.2, 0.44, 0.45, 1.0, 5.0]))
    def time_passes(self, seconds):
        self.desk.clock.sleep(seconds)

    @rule(target=nonces)
    def publish(self):
        nonce = self.desk.keeper.nonce()
        assert nonce not in self.counts_until
        self.counts_until[nonce] = self.now + LIMIT_S
        return nonce

    @rule(target=leases, owner=st.sampled_from("ABC"))
    def acquire(self, owner):
        free = self.holder is None or self.now - self.heard >= STALE_S
        if not free:
            assert code_of(self.desk.keeper.acquire, owner) == "LEASE_HELD"
            return self.holder
        number = self.desk.keeper.acquire(owner).number
        assert all(number > before for before in self.given), "the number only grows"
        self.given.append(number)
        self.heard = self.now
        return number

    @rule(number=leases, nonce=nonces, tick=st.integers(0, 20), may_move=st.booleans())
    def beat(self, number, nonce, tick, may_move):
        if number != self.holder:
            assert code_of(self.desk.keeper.beat, number, nonce, tick, may_move) == "LEASE_LOST"
            return
        ticks = [tick for holder, _, tick, _ in self.accepted if holder == number]
        counts = self.now < self.counts_until[nonce] and tick > max(ticks, default=-1)
        assert self.desk.keeper.beat(number, nonce, tick, may_move) == counts
        if counts:
            self.accepted.append((number, nonce, tick, may_move))
            self.heard = self.now

    @rule(number=leases)
    def release(self, number):
        assert self.desk.keeper.release(number) == (number == self.holder)
        self.given_up.add(number) if number == self.given[-1] else None

    @invariant()
    def the_wheels_turn_only_on_the_newest_word_of_the_one_owner_and_while_it_is_fresh(self):
        words = [word for word in self.accepted if word[0] == self.holder]
        allowed = bool(words) and words[-1][3] and self.now < self.counts_until[words[-1][1]]
        assert self.desk.may_move == allowed

    @invariant()
    def at_most_one_lease_counts(self):
        assert [number for number in self.given if self.desk.keeper.holds(number)] == [
            number for number in [self.holder] if number is not None
        ]


TestKeeper = Keeper.TestCase
TestKeeper.settings = settings(max_examples=60, stateful_step_count=40, deadline=None)
