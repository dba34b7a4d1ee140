"""The verdict on each user whom a search looked for: whether it is where the search has it."""

from __future__ import annotations

import numpy as np

from synchronizar.data.registration import State
from synchronizar.estimation.incremental.following import Following
from synchronizar.estimation.incremental.found_places import FoundPlaces
from synchronizar.estimation.incremental.roster import Roster
from synchronizar.estimation.incremental.snapshot import FoundUser
from synchronizar.estimation.incremental.standing import Placed, Standing

_WATCHED_AT = 0.9  # of the progress: while a user is watched
_FOLLOWED_AT = 0.25  # of the progress: who is known worse is not followed, for nothing is linear so far off
_PARTED, _PARTED_SIGMAS = 0.25, 3.0  # of the largest error, of a search's: who is further off in height is elsewhere


class FoundVerdicts:
    """What a search says of users changes how they stand, and ends following where it has them elsewhere."""

    def __init__(self, roster: Roster, following: Following) -> None:
        self._roster, self._following = roster, following

    def judge(self, user: int, places: FoundPlaces) -> None:
        """The new state of a user who was sought."""
        standing, found, m = self._roster.standings[user], places.found, self._roster.parameters.integrity
        own, placed, before = found.users[user], places.placed(user), standing.placed
        state, reason = own.verdict.state, own.verdict.reason
        standing.progress = own.progress
        elsewhere = self._followed_elsewhere(user, placed, places)
        wrongly = elsewhere and standing.is_registered and self._is_elsewhere(user, placed)
        if wrongly:  # it was relied on where it was not, and may be again
            standing.doubted_at = found.t
        if state is State.REGISTERED and elsewhere:
            self._following.leave(user)
        doubted = found.t - standing.doubted_at < m.doubted_duration
        if state is State.REGISTERED and doubted and own.rejected > m.doubted_share:
            state, reason = State.UNOBSERVABLE, f"{own.rejected:.0%} of its latest ranges do not fit"
            if own.rejected > m.doubted_share + self._following.nlos_share:  # more than among the others: it lasts
                standing.doubted_at = found.t
        drifts = float(found.noise[user].max()) > m.watched_drift
        anew = state is State.REGISTERED and (wrongly or not standing.is_registered)
        if anew and not self._is_steady(standing, own, before, placed, drifts, doubted):
            standing.progress *= _WATCHED_AT
            state, reason = State.UNOBSERVABLE, "its place is known, if it stays there: it is watched on"
        if state is State.REGISTERED:
            if standing.registered_at is None:
                standing.registered_at = found.t
                self._confirm(standing, found.t)
            standing.proven = found.t - standing.registered_at >= m.proven_duration and own.single
            standing.contradicted = False
        else:
            standing.registered_at, standing.proven = None, False
            if own.verdict.state is State.AMBIGUOUS or not own.single or elsewhere:
                self._following.leave(user)
            if state is not State.UNOBSERVABLE or own.verdict.state is not State.REGISTERED:
                standing.steady_since = None
        if not self._is_followed(user):
            standing.placed, standing.verdict = placed, own.verdict
        self._roster.change(user, state, reason)

    def check(self, user: int, places: FoundPlaces) -> None:
        """A user who is followed was looked for anew: whether it may be somewhere else."""
        own, placed = places.found.users[user], places.placed(user)
        if not self._is_elsewhere(user, placed) or own.verdict.state is State.UNOBSERVABLE:
            return
        if self._gain_elsewhere(user, places) > self._roster.parameters.integrity.cost_excluded_nlos:
            self._following.leave(user)
            self._roster.look_anew(user, State.AMBIGUOUS, "another placement explains its ranges better")

    def is_to_follow(self, user: int, places: FoundPlaces) -> bool:
        """Whether a user who is not followed is known well enough for that, registered or not."""
        own = places.found.users[user]
        vague = own.verdict.state is State.AMBIGUOUS or not own.single or own.progress < _FOLLOWED_AT
        return not vague and not self._is_followed(user)

    def _is_followed(self, user: int) -> bool:
        return user in self._following.tracking.members

    def _followed_elsewhere(self, user: int, placed: Placed, places: FoundPlaces) -> bool:
        """Whether a user is followed, and a search leaves no doubt that it is somewhere else."""
        if not self._is_followed(user):
            return False
        excluded = self._roster.parameters.integrity.cost_excluded
        if self._is_elsewhere(user, placed) and self._gain_elsewhere(user, places) > excluded:
            return True
        return self._is_at_other_height(user, places.found.users[user], placed)

    def _is_elsewhere(self, user: int, placed: Placed) -> bool:
        """Whether a search has a user somewhere else than it is followed to be."""
        followed = self._roster.standings[user].placed
        return followed is not None and placed.is_elsewhere(followed, self._roster.parameters.integrity)

    def _is_at_other_height(self, user: int, own: FoundUser, placed: Placed) -> bool:
        """Whether a search leaves no doubt that a user is higher or lower than it is followed to be."""
        followed = self._roster.standings[user].placed
        if followed is None or own.verdict.state is not State.REGISTERED:
            return False
        off = abs(float(placed.at(followed.place)[2] - followed.state[3]))
        least = _PARTED * self._roster.parameters.integrity.largest_error
        return off > max(least, _PARTED_SIGMAS * float(np.sqrt(own.covariance[2, 2])))

    def _gain_elsewhere(self, user: int, places: FoundPlaces) -> float:
        """Log likelihood that a user's latest ranges gain where a search has it, beside where it is followed to be."""
        ranges = places.found.ranges
        followed, found = self._following.tracking.costs_of(user, ranges.serial, -ranges.residual)
        return float((followed - found).sum())

    def _confirm(self, standing: Standing, t: float) -> None:
        """A search that saw as much since a user came into doubt as of one who has just come tells where it is."""
        least = self._roster.parameters.integrity.least_duration
        if standing.unconfirmed_since is not None and t - standing.unconfirmed_since >= least:
            standing.unconfirmed_since = None
        if standing.left_at is not None and t - standing.left_at >= least:
            standing.left_at = None

    def _is_steady(
        self, standing: Standing, own: FoundUser, before: Placed | None, placed: Placed, drifts: bool, doubted: bool
    ) -> bool:
        """Whether who seems registered has ranged for long enough, and stayed in its place where it may be wrong.

        That is where ranges are NLOS, or fit a track that drifts unusually far alone, also where that was so by the
        search before: all may fit in another place. And longer where its ranges contradicted it lately: while SLAM
        slides on, the few since then fit a walk in another direction.
        """
        m, now = self._roster.parameters.integrity, self._roster.now
        assert standing.since is not None
        long_enough = now - standing.since >= m.least_duration
        usual = own.rejected <= m.watched_share and not drifts and not doubted
        if usual and standing.steady_since is None:
            return long_enough
        if standing.steady_since is None or before is None or before.is_elsewhere(placed, m):
            standing.steady_since = now
        watched = m.doubted_watched if doubted else m.watched_duration
        return long_enough and now - standing.steady_since >= watched
