"""What a solver that falls behind is spared."""

from __future__ import annotations

from synchronizar.live.solver_wire import Lost, Pose, Range
from synchronizar.live.sparing import LESS_EVERY, MORE_EVERY, RANGES_S, Sparing

NO_TURN = (0.0, 0.0, 0.0, 1.0)


def taken(sparing: Sparing, began: float, seconds: float = 8.0) -> tuple[int, int]:
    """Of a device's poses, 60 a second, and of a pair's ranges, said in turn by both ends, 40 a second."""
    poses = [Pose("alice", began + n / 60.0, (0.0, 0.0, 0.0), NO_TURN) for n in range(round(60 * seconds))]
    ends = (("alice", "bob"), ("bob", "alice"))
    ranges = [Range(began + n / 40.0, *ends[n % 2], 3.0, {}) for n in range(round(40 * seconds))]
    return sum(map(sparing.takes, poses)), sum(map(sparing.takes, ranges))


def test_who_keeps_up_is_told_everything() -> None:
    sparing = Sparing()
    for n in range(1000):
        assert not sparing.update(0.1 * n, 0.15)
    assert taken(sparing, 0.0) == (480, 320)


def test_of_many_pairs_no_more_than_a_thousand_ranges_a_second_are_told() -> None:
    sparing = Sparing()
    names = [f"device{n:02d}" for n in range(20)]
    pairs = [(a, b) for n, a in enumerate(names) for b in names[:n]]
    told = sum(sparing.takes(Range(n / 20.0, a, b, 3.0, {})) for n in range(200) for a, b in pairs)
    assert 0.8 * 10_000 < told <= 10_000 + len(pairs)


def test_of_many_devices_no_more_than_a_thousand_poses_a_second_are_told() -> None:
    sparing = Sparing()
    poses = [Pose(f"device{k:02d}", n / 60.0, (0.0, 0.0, 0.0), NO_TURN) for n in range(600) for k in range(32)]
    assert 0.8 * 10_000 < sum(map(sparing.takes, poses)) <= 10_000 + 32


def test_who_falls_behind_is_told_less_step_by_step_and_everything_again_when_it_has_kept_up_for_a_while() -> None:
    sparing, t, counts = Sparing(), 0.0, []
    sparing.update(t, 5.0)
    for _ in RANGES_S:
        counts.append(taken(sparing, t))
        assert not sparing.update(t + 0.5 * MORE_EVERY, 5.0)
        t += MORE_EVERY
        sparing.update(t, 5.0)
    assert counts == [(480, 320), (240, 80), (240, 40), (120, 20), (120, 10), (120, 5)]
    assert not sparing.update(t + MORE_EVERY, 60.0)  # there is no further step
    t += MORE_EVERY
    sparing.update(t, 0.1)
    for step in reversed(range(len(RANGES_S) - 1)):
        t += LESS_EVERY
        assert sparing.update(t, 0.1)
        assert sparing.step == step
    assert taken(sparing, t) == (480, 320)


def test_who_is_behind_for_a_moment_is_told_everything() -> None:
    """As after a solver that was begun again, or a computer that slept."""
    sparing = Sparing()
    for n in range(100):
        assert not sparing.update(0.1 * n, 3600.0 if n % 15 else 0.2)


def test_what_is_no_measurement_is_always_told_and_what_comes_late_too() -> None:
    sparing = Sparing()
    sparing.update(8.0, 5.0)
    assert sparing.update(10.0, 5.0)
    assert all(sparing.takes(Lost("alice")) for _ in range(5))
    assert sparing.takes(Range(10.0, "alice", "bob", 3.0, {}))
    assert not sparing.takes(Range(10.05, "bob", "alice", 3.0, {}))
    assert sparing.takes(Range(9.0, "alice", "bob", 3.0, {}))
