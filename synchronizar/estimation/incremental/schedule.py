"""Who is looked for, and when: searches cost the more the longer they look back, and find the more."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from synchronizar.data.registration import State
from synchronizar.estimation.incremental.following import Following
from synchronizar.estimation.incremental.roster import Roster

_LEAST_PROGRESS = 0.01  # less is not told from none


class Schedule:
    """When the next search begins."""

    KEPT: ClassVar[tuple[str, ...]] = ("searched", "checked")

    def __init__(self, roster: Roster, following: Following) -> None:
        self._roster, self._following = roster, following
        self.searched = -np.inf
        """s: when the last search began."""
        self.checked = -np.inf
        """s: when the last one began that looked for those who are proven."""

    def sought(self) -> list[int]:
        """Users that range and are not proven."""
        gauge, standings = self._following.gauge, self._roster.standings
        return [u for u, s in enumerate(standings) if s.since is not None and not s.proven and u != gauge]

    def due(self) -> bool:
        """Whether a search is to begin now."""
        sought = self.sought()
        roster, following = self._roster, self._following
        m, now = roster.parameters.incremental, roster.now
        if not sought:
            doubtful = following.nlos_share > roster.parameters.search.doubtful_share
            interval = m.doubtful_interval if doubtful else m.check_interval
            return bool(following.tracking.members) and now >= max(self.searched, self.checked) + interval
        first = min(s for u in sought if (s := roster.standings[u].since) is not None)
        if now < first + m.search_first:
            return False
        growth = m.search_growth * (now - first)
        if all(roster.standings[u].is_registered for u in sought):
            return now >= self.searched + max(m.search_proving, growth)
        times = [self._registered_from(u) for u in sought]
        near = max(t for t in times if t <= min(times) + m.search_interval_near)
        if now < near <= now + m.search_interval_near:
            return False  # one that is begun in a moment finds more
        soon = max(near, self.searched + max(m.search_interval_near, growth))
        return now >= min(soon, self.searched + max(m.search_interval, growth))

    def _registered_from(self, user: int) -> float:
        """s: from when on a search may find a user registered, by what is known of it; infinite if it already is."""
        standing, m = self._roster.standings[user], self._roster.parameters.integrity
        if standing.is_registered or standing.since is None or standing.verdict is None:
            return np.inf
        least = standing.since + m.least_duration
        if standing.verdict.state is State.REGISTERED:
            watched = -np.inf if standing.steady_since is None else standing.steady_since + m.watched_duration
            return max(least, watched)
        # While a user begins to walk, its sigmas fall with about the square of time.
        taken = (self.searched - standing.since) * (max(standing.progress, _LEAST_PROGRESS) ** -0.5 - 1.0)
        return float(max(least, self.searched + 0.5 * taken))

    def begin(self) -> tuple[list[int], bool]:
        """Whom the search looks for that begins now, and whether they are followed: where nobody is sought, all are."""
        sought, gauge, now = self.sought(), self._following.gauge, self._roster.now
        self.searched = now
        if sought:
            return sought, False
        self.checked = now
        return [u for u in self._following.tracking.members if u != gauge], True

    def window_begin(self) -> float:
        """s: the earliest moment that following and searches still need."""
        m, roster = self._roster.parameters, self._roster
        begin = roster.now - m.incremental.window
        sought, members = [roster.standings[u] for u in self.sought()], self._following.tracking.members
        many = len(members) > m.incremental.search_whole_most
        if many:
            sought = [standing for standing in sought if not standing.is_registered]
        known = many or any(roster.standings[u].proven for u in members)
        longest = 2.0 * m.incremental.window if known else m.search.first_stretch
        return min([begin, *(max(s.since, roster.now - longest) for s in sought if s.since is not None)])
