from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import linprog
from support.datagrams import some_ranges

from synchronizar.arrays import Array
from synchronizar.data.user import User
from synchronizar.io.datagrams import RangesDatagram, RoomKeys, encode_ranges, reporter_key
from synchronizar.io.range_clock import MAX_SKEW, RangeClock
from synchronizar.io.receiver import Receiver

KEY = bytes(range(32))
SESSION = 5
NAMES = {7: "alice", 8: "beacon", 9: "bob"}
USERS = (User("alice"), User("beacon", static=True), User("bob", antennas={"top": (0.0, 0.0, 0.2)}))


@pytest.fixture
def receiver() -> Receiver:
    return Receiver(RoomKeys(SESSION, KEY), NAMES)


def some_datagram(**change: object) -> RangesDatagram:
    said = RangesDatagram(SESSION, 7, 1, 13, 2_000_000_000, 0, some_ranges([9], [1000]))
    return replace(said, **change)  # type: ignore[arg-type]


def take(receiver: Receiver, arrived: float = 100.0, **change: object) -> RangesDatagram | None:
    return receiver.take(sealed(some_datagram(**change)), arrived)


def sealed(said: RangesDatagram, room: bytes = KEY) -> bytes:
    return encode_ranges(said, reporter_key(room, said.session, said.reporter))


# ---- what is taken ----


def test_what_is_told_is_given_back(receiver: Receiver) -> None:
    said = take(receiver)
    assert said is not None
    assert (said.reporter, said.sequence, said.ranges["distance_mm"].tolist()) == (7, 1, [1000])
    assert not receiver.refused


def test_each_datagram_is_taken_once(receiver: Receiver) -> None:
    assert take(receiver) is not None
    assert take(receiver) is None
    assert dict(receiver.refused) == {"sequence": 1}
    assert len(receiver.ranges(USERS)) == 1


def test_reporters_have_windows_of_their_own(receiver: Receiver) -> None:
    assert take(receiver, sequence=1000) is not None
    assert take(receiver, reporter=8, sequence=1) is not None
    assert take(receiver, sequence=936) is None
    assert take(receiver, sequence=937) is not None


def test_a_reporter_may_restart_and_what_it_said_before_is_too_old(receiver: Receiver) -> None:
    assert take(receiver, sequence=500) is not None
    assert take(receiver, sequence=1 << 32) is not None
    assert take(receiver, sequence=501) is None
    assert take(receiver, sequence=(1 << 32) + 1) is not None


def test_refusals_are_counted_by_their_reason(receiver: Receiver) -> None:
    good = sealed(some_datagram())
    assert receiver.take(b"", 0.0) is None
    assert receiver.take(good[:-1], 0.0) is None
    assert receiver.take(good[:-1] + bytes([good[-1] ^ 1]), 0.0) is None
    assert receiver.take(sealed(some_datagram(), bytes(32)), 0.0) is None
    assert receiver.take(encode_ranges(some_datagram(), KEY), 0.0) is None
    assert take(receiver, session=6) is None
    assert dict(receiver.refused) == {"size": 1, "tag": 4, "session": 1}
    assert len(receiver.ranges(USERS)) == 0


def test_what_is_refused_uses_up_no_sequence(receiver: Receiver) -> None:
    receiver.take(sealed(some_datagram(sequence=10**6), bytes(32)), 0.0)
    take(receiver, sequence=10**6, session=6)
    assert take(receiver, sequence=1) is not None


def test_nobody_speaks_for_another(receiver: Receiver) -> None:
    """Whoever has the key of 8, and even writes 7's address, is not taken for 7."""
    own = reporter_key(KEY, SESSION, 8)
    assert receiver.take(encode_ranges(some_datagram(reporter=7), own), 0.0) is None
    assert receiver.take(encode_ranges(some_datagram(reporter=8), own), 0.0) is not None
    assert dict(receiver.refused) == {"tag": 1}


@given(st.lists(st.binary(max_size=900), max_size=5))
def test_nothing_that_comes_in_makes_it_fail(datagrams: list[bytes]) -> None:
    receiver = Receiver(RoomKeys(SESSION, KEY), NAMES)
    for datagram in datagrams:
        assert receiver.take(datagram, 0.0) is None
    assert receiver.refused.total() == len(datagrams)


def test_dropped_ranges_are_counted_over_restarts_and_reporters(receiver: Receiver) -> None:
    assert receiver.dropped == 0
    take(receiver, sequence=1, dropped=3)
    take(receiver, sequence=3, dropped=5)
    take(receiver, sequence=2, dropped=4)  # late: told before the 5
    take(receiver, sequence=1 << 32, dropped=2)
    take(receiver, reporter=8, dropped=10)
    assert receiver.dropped == 5 + 2 + 10


# ---- ranges in columns ----


def test_ranges_have_the_units_of_a_recording(receiver: Receiver) -> None:
    known = some_ranges(
        [8, 9, 9],
        [1500, -12, 2345],
        offset_us=[0, -1500, 20_000],
        sigma_mm=[30, 65535, 1],
        rx_power_cdbm=[-7912, -32768, -8000],
        fp_power_cdbm=[-8203, -32768, -9500],
        sight=[0, 255, 1],
        source=[0, 1, 4],
    )
    take(receiver, arrived=50.0, ranges=known)
    ranges = receiver.ranges(USERS)
    # The newest, 20 ms after the datagram's time, came in at 50 s; they stand by time.
    np.testing.assert_allclose(ranges.t, [49.9785, 49.98, 50.0], rtol=0, atol=1e-5)
    np.testing.assert_array_equal(ranges.a, [0, 0, 0])
    np.testing.assert_array_equal(ranges.b, [2, 1, 2])
    np.testing.assert_allclose(ranges.distance, [-0.012, 1.5, 2.345], rtol=1e-15)
    np.testing.assert_allclose(ranges.sigma, [np.nan, 0.03, 0.001], rtol=1e-15)
    np.testing.assert_allclose(ranges.rx_power, [np.nan, -79.12, -80.0], rtol=1e-15)
    np.testing.assert_allclose(ranges.fp_power, [np.nan, -82.03, -95.0], rtol=1e-15)
    np.testing.assert_array_equal(ranges.nlos, [np.nan, 0.0, 1.0])
    np.testing.assert_array_equal(ranges.source, [1, 0, 4])


def test_an_only_antenna_is_the_modules(receiver: Receiver) -> None:
    take(receiver, ranges=some_ranges([8, 9], 1000))
    ranges = receiver.ranges(USERS)
    np.testing.assert_array_equal(ranges.antenna_a, [-1, -1])
    np.testing.assert_array_equal(ranges.antenna_b, [-1, 0])


def test_of_several_antennas_none_can_be_chosen(receiver: Receiver) -> None:
    take(receiver)
    both = User("bob", antennas={"left": (0.0, 0.1, 0.0), "right": (0.0, -0.1, 0.0)})
    with pytest.raises(ValueError, match="bob has several antennas"):
        receiver.ranges((USERS[0], USERS[1], both))


def test_doubtful_and_failed_measurements_are_left_out(receiver: Receiver) -> None:
    take(receiver, ranges=some_ranges([9, 9, 9], [1, 2, 3], status=[1, 0, 2]))
    np.testing.assert_array_equal(receiver.ranges(USERS).distance, [0.002])


def test_ranges_of_strangers_are_left_out(receiver: Receiver) -> None:
    take(receiver, ranges=some_ranges([8, 9, 10], [1, 2, 3]))
    take(receiver, reporter=11, ranges=some_ranges([9], [4]))
    np.testing.assert_array_equal(receiver.ranges(USERS).distance, [0.001, 0.002])
    np.testing.assert_array_equal(receiver.ranges(USERS[::2]).distance, [0.002])


def test_two_modules_of_one_user_are_at_no_distance() -> None:
    receiver = Receiver(RoomKeys(SESSION, KEY), {7: "alice", 9: "alice"})
    take(receiver)
    assert len(receiver.ranges(USERS)) == 0


def test_datagrams_may_come_in_any_order(receiver: Receiver) -> None:
    """Ten datagrams 0.1 s apart, which each took 5 ms."""
    for k in np.random.default_rng(1).permutation(10).tolist():
        take(
            receiver,
            arrived=30.005 + 0.1 * k,
            sequence=k,
            time_ns=10**18 + k * 10**8,
            ranges=some_ranges([9], [k]),
        )
    ranges = receiver.ranges(USERS)
    np.testing.assert_allclose(ranges.distance, 0.001 * np.arange(10), rtol=1e-15)
    np.testing.assert_allclose(ranges.t, 30.005 + 0.1 * np.arange(10), rtol=0, atol=1e-6)


# ---- one range clock ----

LEAST_DELAY = 0.003


def delays(random: np.random.Generator, n: int) -> Array:
    """s: of Wi-Fi, as it may be."""
    return LEAST_DELAY + random.exponential(0.004, n) + (random.random(n) < 0.02) * random.uniform(0.0, 0.5, n)


def heard(t: Array, begin_ns: int, ppm: float, epoch: int) -> tuple[np.ndarray, np.ndarray]:
    """Epochs and times of a clock that is fast by `ppm`, at the true times t."""
    return np.full(len(t), epoch, dtype=np.uint32), begin_ns + np.round(t * (1.0 + 1e-6 * ppm) * 1e9).astype(np.int64)


@pytest.mark.parametrize(
    ("seconds", "ppm"), [(12.0, 0.0), (12.0, 20.0), (3600.0, 20.0), (3600.0, -40.0), (86400.0, 35)]
)
def test_a_clock_that_drifts_is_followed(seconds: float, ppm: float) -> None:
    """72 ms in an hour at 20 ppm; what is left is the least delay."""
    random = np.random.default_rng(int(seconds) + int(ppm))
    t = np.sort(random.uniform(0.0, seconds, 2000))
    epoch, time_ns = heard(t, 10**15, ppm, 77)
    clock = RangeClock(epoch, time_ns, t + delays(random, len(t)))
    error = clock.seconds(epoch, time_ns) - t - LEAST_DELAY
    assert np.abs(error).max() < 0.0005


def test_every_epoch_is_brought_to_the_same_clock() -> None:
    """Two networks that begin at odd times and merge into a third."""
    random = np.random.default_rng(3)
    t = [np.sort(random.uniform(*span, 500)) for span in ((0.0, 20.0), (5.0, 20.0), (20.0, 40.0))]
    told = [heard(t[0], 0, 10.0, 1), heard(t[1], 10**12, -15.0, 2), heard(t[2], 5 * 10**17, 3.0, 2**32 - 1)]
    epoch, time_ns = (np.concatenate(column) for column in zip(*told, strict=True))
    true = np.concatenate(t)
    order = random.permutation(len(true))
    clock = RangeClock(epoch[order], time_ns[order], (true + delays(random, len(true)))[order])
    error = clock.seconds(epoch, time_ns) - true - LEAST_DELAY
    assert np.abs(error).max() < 0.0008


def test_a_clock_goes_on_without_a_jump() -> None:
    random = np.random.default_rng(4)
    t = np.linspace(0.0, 600.0, 3000)
    epoch, time_ns = heard(t, 0, 20.0, 1)
    clock = RangeClock(epoch, time_ns, t + delays(random, len(t)))
    fine = np.arange(0, 600 * 10**9, 10**7)
    steps = np.diff(clock.seconds(np.full(len(fine), 1, dtype=np.uint32), fine))
    np.testing.assert_allclose(steps, 0.01, rtol=2e-4)
    assert np.ptp(steps) < 1e-9


def test_one_datagram_gives_a_clock() -> None:
    clock = RangeClock(np.array([4], dtype=np.uint32), np.array([2 * 10**9]), np.array([50.0]))
    seconds = clock.seconds(np.full(3, 4, dtype=np.uint32), np.array([10**9, 2 * 10**9, 3 * 10**9]))
    np.testing.assert_allclose(seconds, [49.0, 50.0, 51.0], rtol=0, atol=1e-9)


@given(st.lists(st.tuples(st.integers(0, 10**10), st.floats(0.0, 0.5)), min_size=1, max_size=12), st.floats(-60, 60))
def test_the_line_is_the_best_that_no_datagram_lies_below(points: list[tuple[int, float]], ppm: float) -> None:
    """Against a linear program: least sum of delays, none below zero, skew within its bound."""
    time_ns = np.array([ns for ns, _ in points], dtype=np.int64)
    x = 1e-9 * time_ns
    arrived = x * (1.0 + 1e-6 * ppm) + [delay for _, delay in points]
    epoch = np.zeros(len(points), dtype=np.uint32)
    delay = arrived - RangeClock(epoch, time_ns, arrived).seconds(epoch, time_ns)
    assert delay.min() > -1e-9
    best = linprog(
        [-len(x), -x.sum()],
        A_ub=np.column_stack([np.ones(len(x)), x]),
        b_ub=arrived - x,
        bounds=[(None, None), (-MAX_SKEW, MAX_SKEW)],
        method="highs",
    )
    assert delay.sum() == pytest.approx((arrived - x).sum() + best.fun, abs=1e-6)
