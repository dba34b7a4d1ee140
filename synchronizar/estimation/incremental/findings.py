"""What the last search found: whom it registers, who is followed from then on, what else is possible."""

from __future__ import annotations

from typing import ClassVar

from synchronizar.arrays import Array
from synchronizar.estimation.incremental.following import Following
from synchronizar.estimation.incremental.found_places import FoundPlaces
from synchronizar.estimation.incremental.found_verdicts import FoundVerdicts
from synchronizar.estimation.incremental.roster import Roster
from synchronizar.estimation.incremental.snapshot import Candidate, Found
from synchronizar.estimation.incremental.tracking import JoiningUser
from synchronizar.graph.priors import height_sigma_of


class Findings:
    """Takes in what searches find, one after the other."""

    KEPT: ClassVar[tuple[str, ...]] = ("found", "candidates", "alternatives")

    def __init__(self, roster: Roster, following: Following) -> None:
        self._roster, self._following = roster, following
        self._verdicts = FoundVerdicts(roster, following)
        self.found: Found | None = None
        self.candidates: tuple[Candidate, ...] = ()
        """Where the next search may begin."""
        self.alternatives: list[tuple[float, dict[int, Array]]] = []
        """Cost and (4,) common_from_user of each user, of each joint placement; none where there is but one."""

    def take(self, found: Found, sought: list[int]) -> None:
        """Judge what a search found, and follow those whose places are known by it."""
        common = self._following.common_from_graph(found)
        if common is None:
            return
        self.found, self.candidates = found, found.candidates
        self._following.tracking.noise = found.noise.copy()
        places = FoundPlaces(found, common, self._following.shift)
        joining = self._judge(places, sought)
        self.alternatives = [
            (cost, {u: self._frame(u, at, found) for u, at in last.items()}) for cost, last in places.alternatives()
        ]
        self._join(joining, places)
        self._take_heights(places)

    def _judge(self, places: FoundPlaces, sought: list[int]) -> dict[int, JoiningUser]:
        """The verdicts on all whom the search saw; returns those of them who are to be followed now."""
        found, roster = places.found, self._roster
        joining: dict[int, JoiningUser] = {}
        for u in found.users:
            if u == found.gauge or (roster.standings[u].since or 0.0) > found.t:  # begun again since then
                continue
            if u in sought:
                self._verdicts.judge(u, places)
                if self._verdicts.is_to_follow(u, places) and (own := self._joining(u, places)):
                    joining[u] = own
            elif u in self._following.tracking.members:
                self._verdicts.check(u, places)
        return joining

    def _joining(self, user: int, places: FoundPlaces) -> JoiningUser | None:
        """A user as it is to be followed; None where it has no slot."""
        roster = self._roster
        own = places.joining(user, roster.users[user])
        if own is None:
            return None
        said, known = (height_sigma_of(of, roster.parameters) for of in (roster.users[user], roster.as_known(user)))
        return own._replace(height_weight=own.height_weight * (said / known) ** 2)

    def _frame(self, user: int, last: Array, found: Found) -> Array:
        """(4,) common_from_user, of a user's last pose (4,) in the common frame."""
        log_scale = float(found.users[user].calibration[0])
        return self._roster.frame_at(user, last, log_scale, found.poses[user].places[-1])

    def _join(self, joining: dict[int, JoiningUser], places: FoundPlaces) -> None:
        """Follow more users.

        Who is not registered yet is followed too, for the others are beside it; but somebody must be, to begin with.
        """
        roster, gauge = self._roster, places.found.gauge
        if self._following.tracking.members:
            if joining:
                self._following.join(joining, None)
        elif any(roster.standings[u].is_registered for u in joining):
            begins = self._joining(gauge, places)
            if begins is not None:
                roster.standings[gauge].contradicted = False
                self._following.join({gauge: begins, **joining}, gauge)

    def _take_heights(self, places: FoundPlaces) -> None:
        """How far the heights that a search holds possible lie from where its users are followed.

        What a height is known to at one optimum grows with every slot, rightly or not; a search sees the others. Whose
        place is proven is told by all that was seen of it: a window may know less.
        """
        tracking, standings = self._following.tracking, self._roster.standings
        spread = tracking.height_spread
        for u, own in places.found.users.items():
            followed = standings[u].placed
            if u == places.found.gauge or u not in tracking.members or followed is None:
                continue
            off = float(places.placed(u).at(followed.place)[2] - followed.state[3])
            known = float(followed.covariance[2, 2] - spread[u])
            new = max(own.height_spread, float(own.covariance[2, 2]) - known) + off**2
            spread[u] = min(spread[u], new) if standings[u].proven else new
        if self._following.members is not None:
            self._following.place_members()
