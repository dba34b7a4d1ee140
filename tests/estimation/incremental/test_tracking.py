from __future__ import annotations

import numpy as np
import pytest

from synchronizar.arrays import Array
from synchronizar.data.user import User
from synchronizar.estimation.incremental.slot_ranges import SERIAL, SIGMA, SLOT, T
from synchronizar.estimation.incremental.tracking import JoiningUser, NewRanges, Tracking
from synchronizar.graph.follower import Follower
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.pose_stream import PoseStream

PARAMETERS = Parameters()
USERS = (User("a"), User("b", antennas={"only": (0.2, 0.0, 0.1)}), User("post", static=True))
TURN = 0.7
"""rad: how b's SLAM lies in the common frame, which is a's."""
CLOCK = 0.05
"""s: b's own stamps minus the range clock."""
POST = np.array([4.0, 5.0, 1.0])
RATE = 20.0


def turn_of(angle: float) -> Array:
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def place(user: int, t: float) -> Array:
    """(3,) m, in the common frame, by the range clock."""
    if user == 2:
        return POST
    x, y = 2.0 * np.cos(0.5 * t + 2.5 * user) + 3.0 * user, 1.5 * np.sin(0.9 * t + user)
    return np.array([x, y, 1.0 + 0.2 * np.sin(0.3 * t)])


def own(user: int, t: float) -> Array:
    """(3,) m: the same in its own SLAM frame."""
    return turn_of(-TURN * user) @ place(user, t)


class People:
    """Two who walk, and a radio; their poses and ranges as they come."""

    def __init__(self, sigma: float = 0.0) -> None:
        self.streams: list[PoseStream | None] = [PoseStream(PARAMETERS), PoseStream(PARAMETERS), None]
        self.tracking = Tracking(USERS, self.streams, PARAMETERS)
        self.tracking.origin = 0.0
        self.random, self.sigma, self.serial, self.t = np.random.default_rng(0), sigma, 0, 0.0

    def walk(self, until: float, users: tuple[int, ...] = (0, 1)) -> None:
        """Poses until then, by the range clock."""
        for t in np.arange(self.t, until, 1.0 / RATE).tolist():
            for user in users:
                stream = self.streams[user]
                assert stream is not None
                stream.add(t + CLOCK * user, own(user, t).tolist(), (0.0, 0.0, 0.0, 1.0))
        self.t = until

    def ranges(self, stamps: list[float], pairs: tuple[tuple[int, int], ...] = ((0, 1), (0, 2), (1, 2))) -> NewRanges:
        rows = []
        for t in stamps:
            for i, j in pairs:
                ends = []
                for user in (i, j):
                    lever = turn_of(TURN) @ [0.2, 0.0, 0.1] if user == 1 else np.zeros(3)
                    ends.append(place(user, t) + lever)
                measured = float(np.linalg.norm(ends[0] - ends[1])) + self.random.normal(0.0, self.sigma)
                rows.append((t, i, j, measured, 0.1, 0.05, -1 if i != 1 else 0, -1 if j != 1 else 0, self.serial))
                self.serial += 1
        columns = [np.array(column) for column in zip(*rows, strict=True)]
        whole = (1, 2, 6, 7, 8)
        return NewRanges(*(c.astype(np.int32) if n in whole else c.astype(float) for n, c in enumerate(columns)))

    def joining(self, user: int, slots: list[int], off: float = 0.0) -> JoiningUser:
        """As a search found it: where it is, but for so many metres."""
        clock = CLOCK if user == 1 else 0.0
        stamps = np.array([float(n) for n in slots]) + clock
        places = np.array([own(user, n) if user < 2 else np.zeros(3) for n in slots])
        at = np.array([place(user, n) for n in slots]) + off
        yaw = np.full(len(slots), TURN if user == 1 else 0.0)
        states = np.column_stack([at[:, :2], yaw, at[:, 2], np.zeros((len(slots), 3))])
        return JoiningUser(slots, stamps, places, states, clock)

    def begin(self, off: float = 0.1, last: int = 2) -> Tracking:
        """All are followed from the slots 0 to `last` on."""
        self.walk(last + 0.2)
        slots = list(range(last + 1))
        joining = {0: self.joining(0, slots), 1: self.joining(1, slots, off), 2: self.joining(2, slots, -off)}
        self.tracking.join(joining, 0)
        self.tracking.add(self.ranges(np.arange(0.05, last + 0.1, 0.1).tolist()))
        self.tracking.advance(last + 0.15, set(), settle=True)
        return self.tracking

    def follow(self, until: float) -> Tracking:
        """Poses and ranges a tenth of a second at a time."""
        for now in np.arange(self.t + 0.1, until, 0.1).tolist():
            self.walk(now)
            self.tracking.add(self.ranges([now - 0.06]))
            self.tracking.advance(now, set())
        return self.tracking


def off(tracking: Tracking, user: int) -> float:
    """m, in the plane: how far a member is from where it is at the begin of its newest slot."""
    tracked = tracking.members[user]
    return float(np.linalg.norm(tracked.state[:2] - place(user, tracked.slot)[:2]))


def sigma_of(tracking: Tracking, user: int) -> float:
    """m: 1 sigma of that, along the longer axis."""
    covariance = tracking.follower.covariance([(user, tracking.members[user].slot)])
    return float(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1]))


def test_who_joins_is_drawn_to_where_its_ranges_have_it() -> None:
    tracking = People().begin(off=0.1, last=8)
    assert list(tracking.members) == [0, 1, 2]
    for user, most in ((0, 0.3), (1, 0.3), (2, 1.0)):
        assert off(tracking, user) < min(most, 3.0 * sigma_of(tracking, user))


def test_those_who_are_followed_stay_near_the_truth() -> None:
    people = People(sigma=0.1)
    people.begin()
    tracking = people.follow(12.0)
    for user in range(3):
        assert tracking.members[user].slot == 11
        assert off(tracking, user) < 0.25
        assert off(tracking, user) < 3.0 * sigma_of(tracking, user)
    assert abs(tracking.members[1].state[2] - TURN) < 0.1
    # The origin of b's antenna, and its clock, are read from the track where the ranges were.
    rows = tracking.ranges.rows
    assert np.std(tracking.residuals(rows)) < 0.12
    assert np.mean(tracking.inlier_probability(rows) > 0.5) > 0.95


def joined_by_a_clock_that_is_off(late: float, read: float) -> Tracking:
    """All where they are; b's clock is `late` (s) more than the one that its states count from."""
    people = People()
    people.walk(8.2)
    slots = list(range(9))
    found = people.joining(1, slots)
    found.states[:, 6] += late
    tracking = people.tracking
    tracking.join({0: people.joining(0, slots), 1: found._replace(clock=CLOCK - late), 2: people.joining(2, slots)}, 0)
    tracking.read_clock[1] = read
    tracking.add(people.ranges([0.1 * n for n in range(1, 82)]))
    tracking.advance(8.15, set(), settle=True)
    return tracking


def test_ranges_are_read_along_a_line_about_the_read_clock() -> None:
    exact, about_another = (joined_by_a_clock_that_is_off(0.3, read) for read in (CLOCK, CLOCK - 0.3))
    left = [float(np.abs(tracking.residuals(tracking.ranges.rows)).max()) for tracking in (exact, about_another)]
    # The prior draws the clock towards 0 by part of its 0.05 s. Over 0.3 s these curves leave their tangents by 0.1 m.
    assert left[0] < 0.03
    assert left[1] > 0.1


def test_the_read_clock_follows_its_estimate() -> None:
    people = People()
    tracking = people.begin()
    tracking.read_clock[1] = CLOCK - 0.3
    people.follow(20.0)
    estimate = tracking.assumed_clock[1] + tracking.members[1].state[6]
    assert tracking.read_clock[1] == pytest.approx(estimate, abs=0.005)
    assert (tracking.read_clock[0], tracking.read_clock[2]) == pytest.approx(
        (tracking.members[0].state[6], 0.0), abs=0.005
    )


def test_a_clock_is_looked_for_beside_what_it_has_run_off_by() -> None:
    tracking, devices = People().tracking, PARAMETERS.devices
    usual = 3.0 * np.hypot(devices.clock_sigma, devices.clock_common_sigma)
    for clock, beyond in ((0.0, 0.0), (0.9 * usual, 0.0), (usual + 0.5, 0.5), (-usual - 2.0, -2.0)):
        assert tracking.run_off(clock) == pytest.approx(beyond)


def test_ranges_wait_for_poses_and_are_left_out_where_none_come_in_time() -> None:
    people = People()
    tracking = people.begin()
    before = len(tracking.ranges)
    tracking.add(people.ranges([2.3], ((0, 1),)))
    tracking.advance(2.4, set())
    assert len(tracking.ranges) == before
    people.walk(2.6)
    tracking.advance(2.6, set())
    assert len(tracking.ranges) == before + 1
    tracking.add(people.ranges([2.9], ((0, 1),)))
    tracking.advance(4.0, set())
    people.walk(4.2)
    tracking.advance(4.2, set())
    assert len(tracking.ranges) == before + 1


def test_nothing_is_taken_in_of_a_user_in_doubt() -> None:
    people = People()
    tracking = people.begin()
    people.walk(3.4)
    before = len(tracking.ranges)
    tracking.add(people.ranges([3.2], ((0, 1), (0, 2))))
    tracking.advance(3.4, {1})
    assert tracking.members[1].slot == 2
    assert tracking.members[0].slot == 3
    assert tracking.ranges.rows[before:, SLOT].tolist() == [3.0]
    tracking.advance(3.5, set())
    assert tracking.members[1].slot == 3
    assert len(tracking.ranges) == before + 2


def test_innovations_are_residuals_before_the_range_was_used_over_all_that_is_expected() -> None:
    people = People()
    tracking = people.begin()
    tracking.take_innovations({})
    people.walk(3.0)
    new = people.ranges([2.7], ((0, 1),))
    tracking.add(new._replace(distance=new.distance - 0.5))
    tracking.advance(3.0, set())
    (row,) = tracking.ranges.rows[tracking.ranges.rows[:, SERIAL] == new.serial[0]]
    innovations = tracking.take_innovations({0: 0.3, 1: 0.4})
    assert (innovations.users.tolist(), innovations.t.tolist()) == ([[0, 1]], [2.7])
    expected = np.hypot(row[SIGMA], 0.5)
    assert innovations.whitened[0] == pytest.approx(0.5 / expected, abs=0.1)  # too short: positive
    assert len(tracking.take_innovations({}).t) == 0


def test_ranges_that_are_late_by_far_are_rejected_and_move_nobody() -> None:
    people = People(sigma=0.05)
    people.begin()
    tracking = people.follow(8.0)
    for now in np.arange(8.1, 11.0, 0.1).tolist():
        people.walk(now)
        ranges = people.ranges([now - 0.06])
        of_pair = (ranges.i == 0) & (ranges.j == 1)
        tracking.add(ranges._replace(distance=ranges.distance + np.where(of_pair, 3.0, 0.0)))
        tracking.advance(now, set())
    share = tracking.rejected(8.05)
    assert share[0] == pytest.approx(0.5, abs=0.1)
    assert share[2] == pytest.approx(0.0, abs=0.1)
    assert off(tracking, 1) < 0.25


@pytest.mark.parametrize(("sigma", "shows"), [(0.05, True), (0.2, False)])
def test_a_detour_that_reflections_might_explain_shows_where_there_are_none(sigma: float, shows: bool) -> None:
    people = People(sigma=sigma)
    people.begin()
    tracking = people.follow(10.0)
    detour = 0.45  # m: two and a half of the model's sigmas
    for now in np.arange(10.1, 12.0, 0.1).tolist():
        people.walk(now)
        ranges = people.ranges([now - 0.06])
        of_pair = (ranges.i == 0) & (ranges.j == 1)
        tracking.add(ranges._replace(distance=ranges.distance + np.where(of_pair, detour, 0.0)))
        tracking.advance(now, set())
    share = tracking.rejected(10.05)
    assert (share[0] > 0.4) == shows
    assert share[2] < 0.1


def test_who_leaves_takes_its_ranges_along_and_the_others_stay() -> None:
    people = People(sigma=0.05)
    people.begin()
    tracking = people.follow(6.0)
    tracking.leave(1)
    tracking.advance(6.0, set())
    assert list(tracking.members) == [0, 2]
    assert not tracking.has(1, 5)
    assert not any(1 in users for users in tracking.follower.slots.values())
    assert set(tracking.ranges.rows[:, 1:3].ravel().tolist()) == {0.0, 2.0}
    assert off(tracking, 2) < 0.3


def test_who_is_not_seen_any_more_is_followed_no_more_once_its_slots_are_forgotten() -> None:
    people = People()
    people.begin()
    for now in np.arange(2.3, 9.0, 0.1).tolist():
        people.walk(now, (0,))
        people.tracking.add(people.ranges([now - 0.06], ((0, 2),)))
        people.tracking.advance(now, set())
    assert people.tracking.forget(2) == []
    assert people.tracking.forget(4) == [1]
    assert list(people.tracking.members) == [0, 2]
    people.tracking.advance(9.0, set())
    assert off(people.tracking, 0) < 0.1


def test_what_is_older_than_the_window_is_forgotten_and_not_what_it_told() -> None:
    people = People(sigma=0.05)
    people.begin()
    tracking = people.follow(9.0)
    for _ in range(5):  # until it stands
        tracking.follower.update()
    tracking._refresh()
    before = {u: tracking.members[u].state.copy() for u in tracking.members}
    tracking.forget(5)
    assert list(tracking.follower.slots) == [5, 6, 7, 8]
    assert tracking.ranges.rows[:, T].min() >= 5.0
    assert tracking.has(0, 5)
    assert not tracking.has(0, 4)
    tracking.advance(9.0, set())
    for user, state in before.items():
        np.testing.assert_allclose(tracking.members[user].state, state, atol=5e-3)


def test_what_is_taken_to_plain_values_and_back_goes_on_the_same() -> None:
    ours, theirs = People(sigma=0.05), People(sigma=0.05)
    for people in (ours, theirs):
        people.begin()
        people.follow(7.05)
        people.tracking.forget(3)
    again = Tracking(USERS, theirs.streams, PARAMETERS)
    again.restore(theirs.tracking.state())
    theirs.tracking = again
    for people in (ours, theirs):
        people.follow(9.0)
    for user, tracked in ours.tracking.members.items():
        np.testing.assert_allclose(theirs.tracking.members[user].state, tracked.state, atol=1e-7)
    np.testing.assert_allclose(theirs.tracking.ranges.rows, ours.tracking.ranges.rows, rtol=1e-6, atol=1e-9)


def test_nothing_that_it_knows_is_left_out() -> None:
    tracking = People().begin()
    made_anew = {"users", "streams", "parameters", "_loss", "_levers", "_survey", "_biases"}
    assert set(vars(tracking)) == set(tracking.state()) | made_anew
    assert isinstance(tracking.follower, Follower)
