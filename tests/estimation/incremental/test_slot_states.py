"""The table of users at slots."""

from __future__ import annotations

import numpy as np
import pytest

from synchronizar._core import followed_apart
from synchronizar.arrays import Array
from synchronizar.estimation.incremental.slot_ranges import DISTANCE, END_I, END_J, SLOT, USER_I, USER_J
from synchronizar.estimation.incremental.slot_states import SlotStates

USERS, COLUMNS = 4, 29


def table_of(random: np.random.Generator, slots: range) -> SlotStates:
    """All users at all slots."""
    out = SlotStates(USERS)
    for slot in slots:
        for user in range(USERS):
            out.add(user, slot, float(slot), random.normal(size=3), random.normal(0.0, [3.0] * 4 + [0.1, 0.2, 0.05]))
    return out


def ranges_of(random: np.random.Generator, slots: range, n: int = 40) -> Array:
    """(n, columns)."""
    rows = random.normal(size=(n, COLUMNS))
    rows[:, USER_I] = random.integers(0, USERS - 1, n)
    rows[:, USER_J] = USERS - 1
    rows[:, SLOT] = random.integers(slots[0], slots[-1] + 1, n)
    return rows


def antenna(state: Array, end: Array) -> Array:
    """(3,) m, by hand: the device's place plus its turned arm."""
    x, y, yaw, height, log_scale, _, clock = state
    offset, lever, velocity = end.reshape(3, 3)
    arm = np.exp(log_scale) * offset + lever + clock * velocity
    turned = np.exp(1j * yaw) * (arm[0] + 1j * arm[1])
    return np.array([x + turned.real, y + turned.imag, height + arm[2]])


def test_residuals_are_distances_of_turned_arms_plus_both_biases() -> None:
    random, slots = np.random.default_rng(0), range(7, 12)
    states, rows = table_of(random, slots), ranges_of(random, slots)
    expected = []
    for row in rows:
        i, j = (states.state(int(row[user]), int(row[SLOT])) for user in (USER_I, USER_J))
        way = antenna(i, row[END_I : END_I + 9]) - antenna(j, row[END_J : END_J + 9])
        expected.append(np.linalg.norm(way) + i[5] + j[5] - row[DISTANCE])
    np.testing.assert_allclose(states.residuals(rows), expected, rtol=1e-12)
    np.testing.assert_allclose(states.residuals(np.hstack([rows, rows])[:, :COLUMNS]), expected, rtol=1e-12)
    away, bias, _ = states.apart(rows)
    np.testing.assert_allclose(np.linalg.norm(away, axis=1) + bias - rows[:, DISTANCE], expected, rtol=1e-12)
    assert len(states.residuals(rows[:0])) == 0


@pytest.mark.parametrize(("column", "value"), [(SLOT, 12), (SLOT, 6), (USER_I, USERS), (USER_J, -1)])
def test_ranges_of_what_is_not_there_are_refused(column: int, value: int) -> None:
    random = np.random.default_rng(1)
    states, rows = table_of(random, range(7, 12)), ranges_of(random, range(7, 12))
    rows[3, column] = value
    with pytest.raises(ValueError, match="not there"):
        states.residuals(rows)
    with pytest.raises(ValueError, match="no such column"):
        followed_apart(rows, (USER_I, USER_J, SLOT, DISTANCE, END_I, COLUMNS - 8), np.zeros((4, 7)), 4, 0)


def test_slots_come_at_both_ends_and_go_at_one() -> None:
    states = SlotStates(2)
    one, zero = np.ones(7), np.zeros(3)
    for user, slot in ((0, 5), (1, 5), (0, 60), (1, 2)):
        states.add(user, slot, 0.5, zero + slot, one * slot)
    assert len(states) == 4
    assert [states.has(0, 5), states.has(0, 2), states.has(1, 2), states.has(0, 60)] == [True, False, True, True]
    there = states.have(np.array([0, 0, 1, 1, 0]), np.array([5, 2, 2, 60, 99]))
    assert there.tolist() == [True, False, True, False, False]
    np.testing.assert_array_equal(states.places(np.array([0, 0]), np.array([60, 5])), [[60.0] * 3, [5.0] * 3])
    states.change([(0, 60), (1, 5)], np.array([one * 7, one * 8]))
    assert states.state(0, 60).tolist() == [7.0] * 7
    states.forget(5)
    assert len(states) == 3
    assert not states.has(1, 2)
    assert states.state(1, 5).tolist() == [8.0] * 7
    states.drop(0)
    assert len(states) == 1
    states.forget(100)
    assert len(states) == 0
    states.add(0, 200, 0.0, zero, one)
    assert states.has(0, 200)


def test_a_table_comes_back_as_it_went() -> None:
    random = np.random.default_rng(2)
    states, again = table_of(random, range(3, 9)), SlotStates(USERS)
    states.forget(4)
    again.restore(states.to_table())
    rows = ranges_of(random, range(4, 9))
    np.testing.assert_array_equal(again.residuals(rows), states.residuals(rows))
    again.add_user()
    again.add(USERS, 8, 0.0, np.zeros(3), np.zeros(7))
    assert again.has(USERS, 8)
    assert not again.has(USERS, 7)
    with pytest.raises(ValueError, match="other users"):
        again.restore(states.to_table())
