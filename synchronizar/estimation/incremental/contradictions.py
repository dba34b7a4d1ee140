"""Whether the latest ranges contradict where users are followed to be: innovation tests over short stretches of time.

An innovation is a range's residual before the range was used. NLOS makes ranges too long; nothing makes them too short.
A user that is not where it is taken for is nearer to some of the others than that, and its ranges to them are too short
by more than noise. So many too short ones, or next to nothing but misfits, have no other cause.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from synchronizar.arrays import Array, Indices
from synchronizar.parameters import Parameters


class Innovations(NamedTuple):
    """n ranges before they were used."""

    t: Array
    """s."""
    i: Indices
    j: Indices
    whitened: Array
    """Predicted minus measured over what is expected, 1 sigma: positive where the range is too short."""


class Contradictions:
    """The innovations of the recent past, and who is contradicted by them."""

    def __init__(self, parameters: Parameters) -> None:
        self._parameters = parameters
        none = np.zeros(0)
        self._recent = Innovations(none, none.astype(np.int32), none.astype(np.int32), none)

    def add(self, new: Innovations, now: float) -> None:
        """More of them."""
        longest = max(self._parameters.integrity.innovation_windows)
        kept = self._recent.t > now - longest
        columns: Any = zip(self._recent, new, strict=True)
        self._recent = Innovations(*(np.concatenate([old[kept], more]) for old, more in columns))

    def forget(self, user: int) -> None:
        """Those of a user."""
        kept = (self._recent.i != user) & (self._recent.j != user)
        self._recent = Innovations(*(column[kept] for column in self._recent))

    @property
    def recent(self) -> Innovations:
        """Those that are remembered."""
        return self._recent

    def restore(self, recent: Innovations) -> None:
        """Remember just these."""
        self._recent = recent

    def found(self, now: float, gauge: int) -> tuple[int, str] | None:
        """The user whose ranges contradict it most, and why; of two that only range to each other not the gauge."""
        worst: tuple[float, int, str] | None = None
        for window in self._parameters.integrity.innovation_windows:
            for excess, user, reason in self._over(window, now, gauge):
                if worst is None or excess > worst[0]:
                    worst = excess, user, reason
        return None if worst is None else worst[1:]

    def _over(self, window: float, now: float, gauge: int) -> list[tuple[float, int, str]]:
        m = self._parameters.integrity
        late = self._recent.t > now - window
        i, j, whitened = self._recent.i[late], self._recent.j[late], self._recent.whitened[late]
        if len(whitened) < m.innovation_fewest:
            return []
        short = (whitened > m.innovation_sigmas).astype(float)
        off = (np.abs(whitened) > m.innovation_sigmas).astype(float)
        size = int(max(i.max(), j.max())) + 1
        count, shorts, offs = (
            np.bincount(i, weights, size) + np.bincount(j, weights, size) for weights in (np.ones(len(i)), short, off)
        )
        out = []
        for user in np.flatnonzero(count >= m.innovation_fewest).tolist():
            too_short, misfits = shorts[user] / count[user], offs[user] / count[user]
            # By chance a few are too short: three standard deviations of a binomial count beyond the tolerated share.
            allowed = m.innovation_short_share
            limit = allowed + 3.0 * np.sqrt(allowed * (1.0 - allowed) / count[user])
            enough = window > min(m.innovation_windows) and count[user] >= m.innovation_many
            excess = max(too_short / limit, misfits / m.largest_rejected if enough else 0.0)
            if excess > 1.0:
                share = f"{max(too_short, misfits):.0%} of its ranges in the last {window:g} s do not fit"
                out.append((excess - (0.5 if user == gauge else 0.0) * 1e-3, user, share))
        return out
