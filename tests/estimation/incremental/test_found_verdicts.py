from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.registration import State
from synchronizar.data.user import User
from synchronizar.estimation.incremental.following import Following
from synchronizar.estimation.incremental.found_places import FoundPlaces
from synchronizar.estimation.incremental.found_verdicts import FoundVerdicts
from synchronizar.estimation.incremental.range_log import RangeLog
from synchronizar.estimation.incremental.roster import Roster
from synchronizar.estimation.incremental.snapshot import Found, FoundRanges, FoundUser, SlotPoses
from synchronizar.estimation.integrity import Verdict
from synchronizar.parameters import Parameters

PARAMETERS = Parameters()
BOB = 1
HERE, THERE = np.array([3.0, 0.0, 0.0, 0.0]), np.array([3.0, 2.0, 0.0, 2.0])
SURE = Verdict(State.REGISTERED, "its place is known to 0.10 m (1 sigma)")


@dataclass
class Walk:
    """What searches find of Bob, one after the other."""

    roster: Roster = field(default_factory=lambda: Roster((User("alice"), User("bob")), 0, PARAMETERS))

    def __post_init__(self) -> None:
        self.verdicts = FoundVerdicts(self.roster, Following(self.roster, RangeLog(PARAMETERS)))
        self.roster.standings[BOB].since = 0.0

    def search(self, t: float, place: Array = HERE, rejected: float = 0.0, noise: float = 1.0) -> State:
        """What becomes of Bob by a search that finds him at a place, and is sure of it."""
        self.roster.now = t
        own = FoundUser(
            SURE,
            place,
            0.01 * np.eye(6),
            np.zeros(3),
            np.full(3, 0.01),
            place[None],
            1.0,
            True,
            rejected,
            0.0,
            1.0,
            np.full(3, 0.05),
        )
        poses = SlotPoses([0], np.zeros(2), np.zeros((2, 3)))
        none = np.zeros(0)
        ranges = FoundRanges(np.zeros(0, dtype=np.int32), none, none, none)
        factors = np.full((2, 2), noise)
        found = Found(t, 0, np.zeros(3), {BOB: poses}, {BOB: own}, [], (), factors, ranges)
        self.verdicts.judge(BOB, FoundPlaces(found, np.zeros(4), np.zeros(3)))
        return self.roster.standings[BOB].state


def test_who_has_ranged_for_long_enough_is_registered_at_once() -> None:
    walk = Walk()
    assert walk.search(2.5) is State.UNOBSERVABLE
    assert walk.search(3.0) is State.REGISTERED


def test_among_late_ranges_a_place_has_to_stay() -> None:
    walk = Walk()
    assert [walk.search(t, rejected=0.1) for t in (4.0, 5.0, 6.0)] == [*[State.UNOBSERVABLE] * 2, State.REGISTERED]


def test_with_a_track_that_drifts_unusually_far_a_place_has_to_stay() -> None:
    walk = Walk()
    assert [walk.search(t, noise=4.0) for t in (4.0, 5.0, 6.0)] == [*[State.UNOBSERVABLE] * 2, State.REGISTERED]


def test_who_was_watched_is_watched_on_where_all_ranges_fit_in_another_place() -> None:
    walk = Walk()
    assert walk.search(4.0, rejected=0.1) is State.UNOBSERVABLE
    assert [walk.search(t, THERE) for t in (5.0, 6.5)] == [State.UNOBSERVABLE] * 2
    assert walk.search(7.0, THERE) is State.REGISTERED


def test_who_was_contradicted_has_to_stay_for_longer() -> None:
    walk = Walk()
    walk.roster.standings[BOB].doubted_at = 0.0
    times = (4.0, 5.5, 6.5, 7.0)
    assert [walk.search(t) for t in times] == [*[State.UNOBSERVABLE] * 3, State.REGISTERED]


def test_a_search_that_saw_enough_since_a_pause_confirms_where_slam_goes_on() -> None:
    for since, confirmed in ((4.0, False), (2.0, True)):
        walk = Walk()
        walk.roster.standings[BOB].unconfirmed_since = since
        walk.search(5.0)
        state, _ = walk.roster.state(BOB, frozenset())
        assert (state is State.REGISTERED) == confirmed
