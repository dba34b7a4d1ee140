from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.datagrams import some_ranges

from synchronizar.data.ranges import Ranges
from synchronizar.data.user import User
from synchronizar.io.datagrams import RangesDatagram, RoomKeys, encode_ranges, reporter_key
from synchronizar.io.receiver import MOST_WAITING, Receiver, Stamped, ranges_of, stamp_all

KEY = bytes(range(32))
SESSION = 5
NAMES = {7: "alice", 8: "beacon", 9: "bob"}
USERS = (User("alice"), User("beacon", static=True), User("bob", antennas={"top": (0.0, 0.0, 0.2)}))


@pytest.fixture
def receiver() -> Receiver:
    return Receiver(RoomKeys(SESSION, KEY))


def some_datagram(**change: object) -> RangesDatagram:
    said = RangesDatagram(SESSION, 7, 1, 13, 2_000_000_000, 0, some_ranges([9], [1000]))
    return replace(said, **change)  # type: ignore[arg-type]


def take(receiver: Receiver, arrived: float = 100.0, **change: object) -> RangesDatagram | None:
    taken = receiver.take(sealed(some_datagram(**change)), arrived)
    return taken and taken.datagram


def converted(*told: dict[str, object], users: tuple[User, ...] = USERS, names: dict[int, str] = NAMES) -> Ranges:
    """Of datagrams that came in at `arrived`."""
    arrived = [float(str(one.pop("arrived", 100.0))) for one in told]
    return ranges_of(stamp_all([some_datagram(**one) for one in told], arrived), users, names)


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
    assert receiver.reporters[7].datagrams == 1


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
    assert not receiver.reporters


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
    receiver = Receiver(RoomKeys(SESSION, KEY))
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


def test_what_is_known_of_a_reporter_is_what_its_own_key_was_right_for(receiver: Receiver) -> None:
    take(receiver, arrived=3.0, sequence=5)
    take(receiver, arrived=4.0, sequence=5)
    receiver.take(sealed(some_datagram(), bytes(32)), 5.0)
    (known,) = receiver.reporters.values()
    assert (known.heard, known.datagrams, known.ranges, dict(known.refused)) == (3.0, 1, 1, {"sequence": 1})


# ---- ranges as they come ----


def walk(receiver: Receiver, until: float, begin: float = 0.0, delay: float = 0.003) -> list[Stamped]:
    """One datagram each 0.1 s, of one range at that moment, that takes `delay` s, by a clock that is 50 s behind."""
    stamped: list[Stamped] = []
    for k in range(round(10 * begin), round(10 * until)):
        said = some_datagram(sequence=k, time_ns=k * 10**8)
        taken = receiver.take(sealed(said), 50.0 + 0.1 * k + delay)
        assert taken is not None
        stamped += taken.stamped
    return stamped


def test_ranges_of_a_new_clock_wait_until_it_is_set_and_each_comes_once(receiver: Receiver) -> None:
    assert walk(receiver, 0.5) == []
    stamped = walk(receiver, 2.0, 0.5)
    assert [one.datagram.sequence for one in stamped] == list(range(20))
    np.testing.assert_allclose([float(one.t[0]) for one in stamped], 50.003 + 0.1 * np.arange(20), atol=1e-6)


def test_a_greeting_has_nothing_to_stamp_and_does_not_move_the_clock(receiver: Receiver) -> None:
    walk(receiver, 5.0)
    greeting = some_datagram(sequence=50, time_ns=5_020_000_000, ranges=some_ranges([], []))
    taken = receiver.take(sealed(greeting), 55.003)
    assert taken is not None
    assert taken.stamped == ()
    (next_one,) = walk(receiver, 5.2, 5.1)
    assert next_one.t[0] == pytest.approx(55.103, abs=1e-6)


def test_what_is_from_the_future_is_refused_and_told(receiver: Receiver) -> None:
    walk(receiver, 5.0)
    assert take(receiver, arrived=55.0, sequence=50, time_ns=6 * 10**9) is None
    assert dict(receiver.refused) == {"future": 1}
    assert dict(receiver.reporters[7].refused) == {"future": 1}
    (next_one,) = walk(receiver, 5.2, 5.1)
    assert next_one.t[0] == pytest.approx(55.103, abs=1e-6)


def test_only_so_many_wait_for_a_clock(receiver: Receiver) -> None:
    for k in range(MOST_WAITING + 3):
        assert take(receiver, arrived=10.0, sequence=k) is not None
    assert receiver.unstamped == 3
    taken = receiver.take(sealed(some_datagram(sequence=1000)), 13.0)
    assert taken is not None
    assert len(taken.stamped) == MOST_WAITING + 1


# ---- ranges in columns ----


def test_ranges_have_the_units_of_a_recording() -> None:
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
    ranges = converted({"arrived": 50.0, "ranges": known})
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


def test_an_only_antenna_is_the_modules() -> None:
    ranges = converted({"ranges": some_ranges([8, 9], 1000)})
    np.testing.assert_array_equal(ranges.antenna_a, [-1, -1])
    np.testing.assert_array_equal(ranges.antenna_b, [-1, 0])


def test_of_several_antennas_none_can_be_chosen() -> None:
    both = User("bob", antennas={"left": (0.0, 0.1, 0.0), "right": (0.0, -0.1, 0.0)})
    with pytest.raises(ValueError, match="bob has several antennas"):
        converted({}, users=(USERS[0], USERS[1], both))


def test_doubtful_and_failed_measurements_are_left_out() -> None:
    ranges = converted({"ranges": some_ranges([9, 9, 9], [1, 2, 3], status=[1, 0, 2])})
    np.testing.assert_array_equal(ranges.distance, [0.002])


def test_ranges_of_strangers_are_left_out() -> None:
    for users, distances in ((USERS, [0.001, 0.002]), (USERS[::2], [0.002])):
        told = {"ranges": some_ranges([8, 9, 10], [1, 2, 3])}, {"reporter": 11, "ranges": some_ranges([9], [4])}
        np.testing.assert_array_equal(converted(*told, users=users).distance, distances)


def test_two_modules_of_one_user_are_at_no_distance() -> None:
    assert len(converted({}, names={7: "alice", 9: "alice"})) == 0


def test_datagrams_may_come_in_any_order() -> None:
    """Ten datagrams 0.1 s apart, which each took 5 ms."""
    ranges = converted(
        *(
            {"arrived": 30.005 + 0.1 * k, "time_ns": 10**18 + k * 10**8, "ranges": some_ranges([9], [k])}
            for k in np.random.default_rng(1).permutation(10).tolist()
        )
    )
    np.testing.assert_allclose(ranges.distance, 0.001 * np.arange(10), rtol=1e-15)
    np.testing.assert_allclose(ranges.t, 30.005 + 0.1 * np.arange(10), rtol=0, atol=1e-6)


def test_of_nothing_there_are_no_ranges() -> None:
    assert len(converted()) == 0
    assert len(converted({"ranges": some_ranges([], [])})) == 0


# ---- whatever members say ----


@st.composite
def members_words(draw: st.DrawFn) -> tuple[bytes, float]:
    """A datagram that its reporter's key is right for, with anything that the protocol lets it say, and its arrival."""
    reporter = draw(st.sampled_from([7, 8, 9, 0xFFFD]))
    peers = draw(st.lists(st.integers(0, 6), max_size=4))
    offsets = draw(st.lists(st.integers(-(10**7), 10**7), min_size=len(peers), max_size=len(peers)))
    said = RangesDatagram(
        SESSION,
        reporter,
        draw(st.integers(0, 2**64 - 1)),
        draw(st.sampled_from([0, 1, 2**32 - 1])),
        draw(st.one_of(st.integers(0, 2**62), st.integers(10**12, 10**12 + 10**10))),
        draw(st.integers(0, 2**32 - 1)),
        some_ranges(np.array(peers, dtype=np.uint16), np.full(len(peers), 1000), offset_us=offsets),
    )
    return sealed(said), draw(st.floats(0.0, 1e7))


@given(st.lists(members_words(), max_size=30))
def test_whatever_members_say_stamps_are_numbers_and_all_is_counted(words: list[tuple[bytes, float]]) -> None:
    receiver = Receiver(RoomKeys(SESSION, KEY))
    stamped: list[Stamped] = []
    taken = 0
    for word, arrived in words:
        one = receiver.take(word, arrived)
        taken += one is not None
        stamped += one.stamped if one is not None else ()
    assert taken + receiver.refused.total() == len(words)
    assert receiver.refused.keys() <= {"sequence", "future"}
    assert all(np.isfinite(one.t).all() and len(one.t) == len(one.datagram.ranges) > 0 for one in stamped)
    assert len({id(one.datagram) for one in stamped}) == len(stamped)
