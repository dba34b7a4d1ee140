"""Who is still where it is followed to be, and what of the past nothing needs any more."""

from __future__ import annotations

from typing import ClassVar

import numpy as np

from synchronizar.data.registration import State
from synchronizar.estimation.incremental.following import Following
from synchronizar.estimation.incremental.members import Members
from synchronizar.estimation.incremental.range_log import RangeLog
from synchronizar.estimation.incremental.roster import Roster
from synchronizar.estimation.incremental.schedule import Schedule

# s after a slot's begin: what is done once a slot is not all done at once.
_JUDGED_AFTER, _FORGOTTEN_AFTER = 0.15, 0.25
_MORE_FORGOTTEN = 2  # slots at once, beside those that went by


class Judging:
    """Verdicts on those who are followed, by their latest ranges and by the graph."""

    KEPT: ClassVar[tuple[str, ...]] = ("_judged", "_forgotten")

    def __init__(self, roster: Roster, log: RangeLog, following: Following, schedule: Schedule) -> None:
        self._roster, self._log, self._following, self._schedule = roster, log, following, schedule
        self._judged = self._forgotten = -1

    def judge_soon(self) -> None:
        """How sure places are is not to wait for the next slot."""
        self._judged = -1

    def advance(self) -> None:
        """At any time who is contradicted; once a slot what is forgotten, and who is still registered."""
        self._confirm()
        if self._following.members is not None and self._contradict():
            return
        tracking, now = self._following.tracking, self._roster.now
        if not np.isfinite(tracking.origin):
            return  # no range has come: there are no slots yet
        slot = tracking.slot_of(now - _FORGOTTEN_AFTER)
        if slot != self._forgotten:
            most, self._forgotten = abs(slot - self._forgotten) + _MORE_FORGOTTEN, slot
            self._forget(most)
        slot, members = tracking.slot_of(now - _JUDGED_AFTER), self._following.members
        if slot != self._judged and members is not None:
            self._judged = slot
            self._judge(members)

    def _confirm(self) -> None:
        """After a pause SLAM may go on in another frame: nobody relies on it until ranges have told."""
        roster, clock = self._roster, self._following.tracking.read_clock
        for user, (stream, standing) in enumerate(zip(roster.streams, roster.standings, strict=True)):
            if stream is not None and stream.resumed_at != standing.resumed_at:  # a new session may have another clock
                standing.resumed_at = stream.resumed_at
                standing.unconfirmed_since = stream.resumed_at - float(clock[user])
            since = standing.unconfirmed_since
            if since is not None and self._following.contradictions.confirms(user, since):
                standing.unconfirmed_since = None
            left, least = standing.left_at, roster.parameters.integrity.shift_steady
            if left is not None and roster.now > left + least and self._fits_gauge(user, left):
                standing.left_at = None

    def _fits_gauge(self, user: int, since: float) -> bool:
        """Whether a user's ranges since then tell that it is where it is beside the gauge."""
        following, found = self._following, self._following.contradictions
        return found.confirms(user, since) and found.is_with(user, since, following.gauge, following.surveyed)

    def _contradict(self) -> bool:
        """Whether the latest ranges contradict some: these are looked for in what comes from now on."""
        roster, following = self._roster, self._following
        trusted, suspected = self._trusted(), following.contradictions.suspected
        found = following.contradictions.found(roster.now, following.gauge, trusted, following.surveyed)
        if found is None:
            return False
        for user in found.users:
            following.leave(user)
            following.contradictions.forget(user)
            standing = roster.standings[user]
            standing.contradicted = user == roster.reference
            standing.doubted_at = roster.now
            standing.lifted |= found.lifted and user in trusted
            roster.look_anew(user, State.UNOBSERVABLE, found.reason)
        recent = roster.now - roster.parameters.integrity.shift_steady
        for user in following.tracking.members:  # what told of those who are gone may be its own doing
            if user in suspected or not self._fits_gauge(user, recent):
                roster.standings[user].left_at = roster.now
        return True

    def _trusted(self) -> frozenset[int]:
        """Who is registered, and was not contradicted lately: of these more is needed to say that they moved."""
        roster = self._roster
        since = roster.now - roster.parameters.integrity.doubted_duration
        told = {roster.reference, *(u for u, standing in enumerate(roster.standings) if standing.is_registered)}
        return frozenset(u for u in told if roster.standings[u].doubted_at < since)

    def _forget(self, most: int) -> None:
        """What nothing needs any more; so many slots at most, for a window that becomes short does so by and by."""
        clock = self._following.tracking.read_clock
        begin = self._following.forget(self._schedule.window_begin(), most)
        for u, stream in enumerate(self._roster.streams):
            if stream is not None:
                stream.forget(begin + float(clock[u]) - 2.0)
        self._log.forget(begin - 1.0)

    def _judge(self, members: Members) -> None:
        """The verdict on each member beside the gauge."""
        roster, following = self._roster, self._following
        m, gauge, tracking = roster.parameters.incremental, following.gauge, following.tracking
        rejected = tracking.rejected(roster.now - m.recent)
        following.nlos_share = float(rejected[list(tracking.members)].mean())
        for user in list(tracking.members):
            standing = roster.standings[user]
            if user == gauge or user not in members.order:
                continue
            extent = members.extent(user, tracking.members[user].stamp - m.judged_walk)
            verdict, near, _ = members.verdict(user, gauge, extent, float(rejected[user]), standing.is_registered)
            relative = members.relative(user, gauge)
            following.spread[user] = float(np.sqrt(max(np.linalg.eigvalsh(relative[:2, :2])[-1], 0.0)))
            standing.verdict, standing.progress = verdict, near
            if verdict.state is not State.REGISTERED or standing.registered_at is not None:
                # Only a search, which sees other placements too, registers anybody.
                roster.change(user, verdict.state, verdict.reason)
