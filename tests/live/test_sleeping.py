"""When modules sleep, and what wakes them."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from synchronizar.live.sleeping import RANGE_ON, Sleeping, Standing, standing_of
from synchronizar.parameters import SleepParameters

P = SleepParameters()
SURE = Standing(registered=True, sigma=0.05)
LOST = Standing(registered=False, sigma=np.inf)
STEP_S = 0.5


class Life:
    """A room whose users stand as is said, whose modules are heard twice a second while they are awake."""

    def __init__(self, **users: Standing) -> None:
        self.sleeping, self.t, self.users = Sleeping(), 0.0, users
        self.wakes: dict[str, float] = dict.fromkeys(users, 0.0)
        self.orders: dict[str, list[tuple[float, int]]] = {user: [] for user in users}

    def awake(self) -> set[str]:
        return {user for user in self.users if self.wakes.get(user, 0.0) <= self.t}

    def run(self, seconds: float, apart: tuple[str, ...] = ()) -> None:
        """All who are awake range with each other, but for those who are `apart`."""
        until = self.t + seconds
        while self.t < until:
            awake = sorted(self.awake() - set(apart))
            for i, a in enumerate(awake):
                for b in awake[i + 1 :]:
                    self.sleeping.ranged(self.t, a, b)
            self.sleeping.update(self.t, self.users)
            for user in self.awake():
                order = self.sleeping.answer(self.t, user)
                if order is not None:
                    self.orders.setdefault(user, []).append((self.t, order))
                    if order != RANGE_ON:
                        self.wakes[user] = self.t + order
            self.t += STEP_S


def test_modules_sleep_once_everybody_has_been_registered_for_a_while() -> None:
    life = Life(ann=SURE, bob=SURE)
    life.run(P.settled - 1.0)
    assert life.awake() == {"ann", "bob"}
    life.run(2.0)
    assert life.awake() == set()


def test_one_who_is_not_registered_keeps_those_awake_who_range_with_them() -> None:
    life = Life(ann=SURE, bob=SURE, cem=LOST)
    life.run(5.0)
    life.users["dan"] = SURE
    life.run(60.0, apart=("dan",))
    assert life.awake() == {"ann", "bob", "cem"}
    assert life.sleeping.awake["ann"] == life.sleeping.awake["cem"] == "cem"
    life.users["cem"] = SURE
    life.run(P.settled + 1.0)
    assert life.awake() == set()


def test_a_joiner_has_everybody_woken_within_a_nap() -> None:
    life = Life(ann=SURE, bob=SURE)
    life.run(105.0)
    assert life.awake() == set()
    life.users["cem"] = LOST
    life.wakes["cem"] = life.t
    life.run(P.nap + 1.0)
    assert life.awake() == {"ann", "bob", "cem"}
    life.run(60.0)
    assert life.awake() == {"ann", "bob", "cem"}


@pytest.mark.parametrize("need", [LOST, SURE._replace(doubted=True), SURE._replace(sigma=1.1 * P.wake_sigma)])
def test_whoever_is_doubted_unsure_or_lost_wakes_those_that_ranged_with_them(need: Standing) -> None:
    life = Life(ann=SURE, bob=SURE, cem=SURE, dan=SURE)
    life.run(10.0, apart=("dan",))
    life.run(90.0, apart=("dan",))
    life.users["bob"] = need
    life.run(P.nap + 1.0, apart=("dan",))
    assert {"ann", "bob", "cem"} <= life.awake()
    life.users["bob"] = SURE
    life.run(P.settled + 1.0)
    assert life.awake() == set()


def test_between_the_two_sigmas_nothing_changes() -> None:
    between = SURE._replace(sigma=0.5 * (P.sigma + P.wake_sigma))
    life = Life(ann=SURE, bob=between)
    life.run(100.0)
    assert life.awake() == {"ann", "bob"}
    life.users["bob"] = SURE
    life.run(P.settled + 1.0)
    life.users["bob"] = between
    life.run(0.5)
    assert life.sleeping.awake == {}


def test_all_naps_end_at_the_same_moments_and_none_is_long() -> None:
    sleeping = Sleeping()
    for t in np.arange(0.0, 200.0, 0.37).tolist():
        nap = sleeping.nap(t)
        assert abs((t + nap) / P.nap - round((t + nap) / P.nap)) * P.nap <= 0.5 + 1e-9
        assert P.shortest_nap - 0.5 <= nap <= P.nap + P.shortest_nap + 0.5


def test_orders_are_repeated_but_not_in_answer_to_each_datagram() -> None:
    life = Life(ann=SURE, bob=LOST)
    life.run(30.0)
    for orders in life.orders.values():
        assert {order for _, order in orders} == {RANGE_ON}
        assert np.diff([t for t, _ in orders]).tolist() == [P.range_on_every] * 9
    sleeping = Sleeping()
    sleeping.update(0.0, {"ann": SURE})
    sleeping.update(30.0, {"ann": SURE})
    told = [t for t in np.arange(30.0, 33.95, 0.1).tolist() if sleeping.answer(t, "ann") is not None]
    np.testing.assert_allclose(told, [31.0, 32.0, 33.0], atol=0.11, err_msg="it does not listen")


def test_a_need_is_answered_at_once() -> None:
    sleeping = Sleeping()
    sleeping.update(0.0, {"ann": SURE})
    sleeping.update(30.0, {"ann": SURE})
    assert sleeping.answer(29.0, "ann") is None
    assert sleeping.answer(30.0, "ann") == 10
    assert sleeping.is_asleep(31.0, "ann")
    sleeping.update(30.1, {"ann": LOST})
    assert sleeping.answer(30.1, "ann") == RANGE_ON
    assert not sleeping.is_asleep(30.2, "ann")


def test_one_who_has_woken_ranges_for_a_moment_before_sleeping_again() -> None:
    life = Life(ann=SURE, bob=SURE)
    life.run(200.0)
    naps = [t for t, order in life.orders["ann"] if order != RANGE_ON]
    assert naps[0] == pytest.approx(P.settled, abs=1.0)
    np.testing.assert_allclose(np.array(naps[1:]) % P.nap, P.glance, atol=STEP_S)
    assert len(naps) >= 9


def test_a_module_that_is_empty_keeps_nobody_awake() -> None:
    life = Life(ann=SURE, bob=SURE, cem=LOST)
    life.run(10.0)
    life.wakes["cem"] = np.inf
    life.run(P.unheard - 5.0)
    assert life.awake() == {"ann", "bob"}
    life.run(10.0)
    assert life.awake() == set()


def test_one_who_leaves_keeps_nobody_awake_and_is_new_when_they_come_again() -> None:
    life = Life(ann=SURE, bob=SURE, cem=LOST)
    life.run(30.0)
    del life.users["cem"]
    life.run(1.0)
    assert life.awake() == set()
    life.users["cem"] = SURE
    life.wakes["cem"] = life.t
    life.run(5.0)
    assert life.sleeping.awake.keys() == {"ann", "bob", "cem"}


def test_who_has_no_sigma_is_not_sure() -> None:
    assert standing_of("registered", 0.1) == Standing(registered=True, sigma=0.1)
    assert standing_of("registered", None).sigma == np.inf
    assert not standing_of("ambiguous", 0.1).registered


standings = st.builds(Standing, st.booleans(), st.sampled_from([0.05, 0.2, 0.5, np.inf, np.nan]), st.booleans())


@settings(max_examples=60, deadline=None)
@given(st.lists(st.tuples(st.sampled_from("abcd"), standings, st.floats(1.0, 60.0)), max_size=12))
def test_whoever_is_in_need_is_awake_within_a_nap_and_nobody_sleeps_longer(changes: list) -> None:
    life = Life(a=SURE, b=SURE)
    for user, standing, seconds in changes:
        life.users[user] = standing
        life.wakes.setdefault(user, life.t)
        life.run(seconds)
        assert max(life.wakes.values()) <= life.t + P.nap + P.shortest_nap + 1.0
    unfit = {user for user, s in life.users.items() if not s.registered or s.doubted or not s.sigma <= P.wake_sigma}
    life.run(P.nap + P.shortest_nap + 1.0)
    assert unfit <= life.awake()
    if unfit:
        assert len(life.awake()) > 1 or len(life.users) == 1, "alone they would range with nobody"
