"""Whether the latest ranges contradict where users are followed to be: innovation tests over short stretches of time.

An innovation is a range's residual before the range was used. NLOS makes ranges too long; nothing makes them too short.
A user that is not where it is taken for is nearer to some of the others than that, and its ranges to them are too short
by more than noise. So many too short ones, or next to nothing but misfits, have no other cause.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from synchronizar._core import worst_misfit
from synchronizar.arrays import Array
from synchronizar.estimation.incremental.innovations import Innovations
from synchronizar.estimation.incremental.shifts import shifted
from synchronizar.parameters import Parameters

_UPRIGHT = 3.0  # a shift is one upwards, or down, where it is so many times as far as in the plane


class Contradicted(NamedTuple):
    """Users whose latest ranges contradict them."""

    users: list[int]
    reason: str
    lifted: bool = False
    """Whether by one shift, upwards or down. How far it has gone says nothing of how far it goes."""


class Contradictions:
    """The innovations of the recent past, and who is contradicted by them."""

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        self._recent = Innovations.none()
        self.suspected: frozenset[int] = frozenset()
        """Who may be somewhere else, though that is not sure."""

    def add(self, new: Innovations, now: float) -> None:
        """More of them."""
        longest = max(self._parameters.integrity.innovation_windows)
        kept = self._recent.t > now - longest
        self._recent = Innovations(np.concatenate([self._recent.rows[kept], new.rows]))

    def forget(self, user: int) -> None:
        """Those of a user."""
        self._recent = self._recent.part((self._recent.users != user).all(axis=1))
        self.suspected -= {user}

    @property
    def recent(self) -> Innovations:
        """Those that are remembered."""
        return self._recent

    def restore(self, recent: Innovations, suspected: frozenset[int]) -> None:
        """Remember just these."""
        self._recent, self.suspected = recent, suspected

    def confirms(self, user: int, since: float) -> bool:
        """Whether a user's ranges since then tell that it is where it is followed to be: as many as tell anything."""
        own = (self._recent.t >= since) & (self._recent.users == user).any(axis=1)
        fits = np.abs(self._recent.whitened[own]) < self._parameters.integrity.innovation_sigmas
        return len(fits) >= self._parameters.integrity.innovation_fewest and float(fits.mean()) > 0.5

    def is_with(self, user: int, since: float, gauge: int, surveyed: frozenset[int]) -> bool:
        """Whether a chain of pairs whose ranges since then fit leads from a user to the gauge, or a surveyed radio."""
        groups = self._groups(since)
        fixed = surveyed or {gauge}
        return any(user in group and not fixed.isdisjoint(group) for group in groups)

    def found(
        self, now: float, gauge: int, trusted: frozenset[int], surveyed: frozenset[int] = frozenset()
    ) -> Contradicted | None:
        """The users whose latest ranges contradict them, and why; None: there are none.

        Of those who are `trusted` more is needed. One shift of some against the others tells the soonest. Besides, a
        user's ranges ring the alarm. Who is wrong then is told by who still fits whom: those who fit the gauge, by a
        chain of pairs that fit, are right, unless that is nobody but the gauge while others fit one another. Where
        radios were `surveyed`, those are right who fit most of them.
        """
        moved = self._moved(now, gauge, trusted, surveyed)
        if moved is not None:
            return moved
        rung = self._alarm(now)
        if rung is None:
            return None
        user, reason, window = rung
        groups = self._groups(now - window)
        with_gauge = next((group for group in groups if gauge in group), [gauge])
        wrong = [u for group in groups if group is not with_gauge for u in group]
        if len(with_gauge) == 1 and any(len(group) > 1 for group in groups):
            largest = max(groups, key=len)
            wrong = [u for group in groups if group is not largest for u in group]
        if surveyed:
            beside = max(groups, key=lambda group: (len(surveyed.intersection(group)), len(group)))
            wrong = [u for group in groups if group is not beside for u in group]
        if not wrong:  # all fit by some chain: it is the one that rang
            wrong = [user if user != gauge or surveyed else self._worst_beside(gauge, now - window)]
        return Contradicted(wrong, reason)

    def _moved(self, now: float, gauge: int, trusted: frozenset[int], surveyed: frozenset[int]) -> Contradicted | None:
        """The users whose latest ranges one shift explains so much better that they are there; who may be is noted."""
        m = self._parameters.integrity
        likely: dict[frozenset[int], tuple[float, Array]] = {}
        for found in shifted(self._recent, now, self._parameters):
            wrong = self._wrong(found.users, gauge, surveyed)
            gain = found.gain - m.shift_cost * len(wrong & trusted)
            long_enough = float(np.linalg.norm(found.shift)) > m.shift_least
            if long_enough and gain > (likely[wrong][0] if wrong in likely else 0.0):
                likely[wrong] = gain, found.shift
        best = max((gain for gain, _ in likely.values()), default=0.0)
        # Who is suspected stays so until much less speaks against it.
        enough = m.shift_gain_suspected * (0.5 if self.suspected else 1.0)
        rivals = {wrong for wrong, (gain, _) in likely.items() if gain > best - m.shift_gain_apart}
        self.suspected = frozenset().union(*rivals) if best > enough else frozenset()
        if best < m.shift_gain or (len(rivals) > 1 and best < 2.0 * m.shift_gain):
            return None
        wrong = max(rivals, key=lambda each: likely[each][0])
        shift = likely[wrong][1]
        upright = abs(float(shift[2])) > _UPRIGHT * float(np.hypot(*shift[:2]))
        reason = f"its latest ranges say that it is {float(np.linalg.norm(shift)):.1f} m from there"
        return Contradicted(sorted(wrong), reason, upright)

    def _wrong(self, moved: frozenset[int], gauge: int, surveyed: frozenset[int]) -> frozenset[int]:
        """Who is wrong where some moved against the others: who is not with the gauge, unless the gauge is alone.

        Where radios were surveyed, who is not with most of them.
        """
        others = frozenset(np.unique(self._recent.users).tolist()) - moved
        if surveyed:
            return moved if len(moved & surveyed) <= len(others & surveyed) else others
        own, rest = (moved, others) if gauge in moved else (others, moved)
        return own if len(own) == 1 and len(rest) > 1 else rest

    def _alarm(self, now: float) -> tuple[int, str, float] | None:
        """The user that fits worst over some stretch of time, where that is more than chance; and how long that is."""
        m = self._parameters.integrity
        stretches = [(now - window, window > min(m.innovation_windows)) for window in m.innovation_windows]
        counts, shares = (m.innovation_fewest, m.innovation_many), (m.innovation_short_share, m.largest_rejected)
        found = worst_misfit(self._recent.rows, stretches, m.innovation_sigmas, *counts, *shares)
        if found is None:
            return None
        stretch, user, share = found
        window = m.innovation_windows[stretch]
        return user, f"{share:.0%} of its ranges in the last {window:g} s do not fit", window

    def _groups(self, since: float) -> list[list[int]]:
        """The users of the ranges since then, in groups that chains of pairs connect whose ranges fit."""
        pairs, shares = self._shares(since)
        group = {u: u for pair in pairs for u in pair}

        def head(u: int) -> int:
            while group[u] != u:
                u = group[u]
            return u

        for (a, b), share in zip(pairs, shares, strict=True):
            if share <= self._parameters.integrity.innovation_pair_share:
                group[head(a)] = head(b)
        found: dict[int, list[int]] = {}
        for u in sorted(group):
            found.setdefault(head(u), []).append(u)
        return list(found.values())

    def _shares(self, since: float) -> tuple[list[tuple[int, int]], list[float]]:
        """Pairs of users, and the share of their ranges since then that are off."""
        late = self._recent.t > since
        if not late.any():
            return [], []
        both = self._recent.users[late]
        off = np.abs(self._recent.whitened[late]) > self._parameters.integrity.innovation_pair_sigmas
        pairs, of = np.unique(both, axis=0, return_inverse=True)
        shares = np.bincount(of.ravel(), off) / np.bincount(of.ravel())
        return [(int(a), int(b)) for a, b in pairs.tolist()], shares.tolist()

    def _worst_beside(self, gauge: int, since: float) -> int:
        """Whose ranges to the gauge fit worst."""
        pairs, shares = self._shares(since)
        own = [(share, a + b - gauge) for (a, b), share in zip(pairs, shares, strict=True) if gauge in (a, b)]
        return max(own)[1]
