"""When cues are told, and to whom: once a slot, to those whose places are not known well enough."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from synchronizar.arrays import Indices
from synchronizar.data.registration import State
from synchronizar.estimation.hypotheses import GaussianComponent, Hypothesis
from synchronizar.estimation.incremental.cues import Cue, cue_of
from synchronizar.estimation.incremental.following import Following
from synchronizar.estimation.incremental.range_log import RangeLog
from synchronizar.estimation.incremental.roster import Roster
from synchronizar.preprocessing.extent import extent_points_of

_CUED_AFTER = 0.35  # s after a slot's begin: what is done once a slot is not all done at once
_RECENT_WALK = 1.0  # s: in which somebody's way shows


class Cueing:
    """Which way those should walk whose places are not known well enough."""

    KEPT: ClassVar[tuple[str, ...]] = ("_cued",)

    def __init__(self, roster: Roster, log: RangeLog, following: Following) -> None:
        self._roster, self._log, self._following = roster, log, following
        self._cued = [-1 for _ in roster.users]

    def add_user(self) -> None:
        """One more user, the last by index."""
        self._cued.append(-1)

    def advance(self) -> None:
        """The cues of those whose turn it is: of all once a slot, one after the other."""
        tracking, roster = self._following.tracking, self._roster
        if not np.isfinite(tracking.origin):
            return
        turn = (1.0 - _CUED_AFTER) * roster.parameters.slam.keyframe_interval / len(roster.users)
        slots = [tracking.slot_of(roster.now - _CUED_AFTER - turn * u) for u in range(len(roster.users))]
        due = [u for u, slot in enumerate(slots) if slot != self._cued[u]]
        self._cued = slots
        if not due:
            return
        rows = self._log.rows
        i, j = self._log.users(rows[rows[:, 0] > roster.now - roster.parameters.incremental.recent])
        for user in due:
            roster.standings[user].cue = self._cue(user, i, j)

    def _cue(self, user: int, i: Indices, j: Indices) -> Cue | None:
        """Of a user, by who ranged to whom lately (n,); None where no walk would tell more, or nothing is known yet."""
        roster, parameters = self._roster, self._roster.parameters
        stream, placed = roster.streams[user], roster.standings[user].placed
        if stream is None or placed is None or user == self._following.gauge:
            return None
        if roster.state(user, self._following.contradictions.suspected)[0] is not State.UNOBSERVABLE:
            return None
        partners = np.unique(np.concatenate([j[i == user], i[j == user]])).tolist()
        places = [(roster.users[u].name, at) for u in partners if (at := roster.device_now(u)) is not None]
        recent = stream.tail(stream.newest - _RECENT_WALK)
        if not len(recent.t) or not places:
            return None
        if not np.diag(placed.covariance)[:4].max() < parameters.priors.place_sigma**2:
            return None  # nothing is known that a walk would add to
        here, began = placed.at(recent.position[-1]), placed.at(recent.position[0])
        velocity = (here - began)[:2] / max(float(np.ptp(recent.t)), 0.1)
        k = len(roster.users)
        frames, covariances = np.zeros((k, 4)), np.zeros((k, 4, 4))
        frames[user] = [*placed.state[:2], placed.state[3], placed.state[2]]
        covariances[user] = placed.covariance[:4, :4]
        walked = stream.tail(stream.newest - parameters.incremental.judged_walk).position
        walk = np.exp(placed.state[4]) * (extent_points_of(walked) - placed.place)
        best = Hypothesis(0.0, frames, covariances, [GaussianComponent(1.0, frames, covariances)])
        names, others = [name for name, _ in places], np.array([at for _, at in places])
        before = roster.standings[user].cue
        return cue_of(best, user, here, others, velocity, walk, names, before, parameters)
