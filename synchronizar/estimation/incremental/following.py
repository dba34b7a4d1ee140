"""Those who are followed: the graph over them, what it tells of each, and how they come into it and leave it."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, ClassVar

import numpy as np

from synchronizar.arrays import Array
from synchronizar.data.registration import State
from synchronizar.estimation.incremental.contradictions import Contradictions
from synchronizar.estimation.incremental.kept import kept, restore_kept
from synchronizar.estimation.incremental.members import Joint, Members
from synchronizar.estimation.incremental.range_log import RangeLog
from synchronizar.estimation.incremental.roster import Roster
from synchronizar.estimation.incremental.snapshot import Found
from synchronizar.estimation.incremental.standing import Placed
from synchronizar.estimation.incremental.tracking import JoiningUser, Tracking
from synchronizar.geometry import apply_frames, wrap_angle

_DRIFTING = (0, 1, 3, 4)  # x, y, yaw, log scale among what is known of a member


class Following:
    """Everybody whose place is known well enough for ranges to be linear in it."""

    KEPT: ClassVar[tuple[str, ...]] = ("shift", "spread", "nlos_share", "_begun", "_drift_unseen")

    def __init__(self, roster: Roster, log: RangeLog) -> None:
        self._roster, self._log = roster, log
        self.tracking = Tracking(roster.users, roster.streams, roster.parameters)
        self.contradictions = Contradictions(roster.parameters)
        self.members: Members | None = None
        """What the graph tells of them now; None: nobody is followed."""
        self.shift = np.zeros(3)
        """(3,) m: where the graph's origin lies in the common frame."""
        self.spread: dict[int, float] = {}
        """m, 1 sigma of the place of each who was judged."""
        self.nlos_share = 0.0
        """Of the members' latest ranges, when they were judged last."""
        self._drift_unseen = False
        self._begun: Placed | None = None
        """Where the reference was followed to be last; None before anybody was followed."""

    @property
    def gauge(self) -> int:
        """The user beside whom the others are judged: the reference while it is followed and not contradicted.

        Else who has the newest slot, one that moves before one that stands. The reference itself is looked for beside
        the others until it is registered again.
        """
        members, roster = self.tracking.members, self._roster
        others = [u for u in members if u != roster.reference]
        if not others or (roster.reference in members and not roster.standings[roster.reference].contradicted):
            return roster.reference
        return max(others, key=lambda u: (members[u].slot, not roster.users[u].static, -u))

    @property
    def surveyed(self) -> frozenset[int]:
        """The members that were surveyed and are where they were."""
        return frozenset(u for u in self.tracking.members if self.tracking.is_surveyed(u))

    def advance(self) -> None:
        """Take in the poses and ranges that have come, and estimate where all are."""
        rows = self._log.take()
        tracking = self.tracking
        if not tracking.members:
            return
        if len(rows):
            i, j = self._log.users(rows)
            followed = np.zeros(len(self._roster.users), dtype=bool)
            followed[list(tracking.members)] = True
            tracking.add(self._log.to_follow(rows[followed[i] & followed[j]]))
        try:
            tracking.advance(self._roster.now, self._roster.doubted())
            self._look(None if self.members is None else self.members.joint)
        except RuntimeError:  # gtsam: the graph is singular, which no prior lets happen; all are looked for anew
            self.give_up()
            return
        self.contradictions.add(tracking.take_innovations(self.spread), self._roster.now)
        self.place_members()

    def _look(self, before: Joint | None = None) -> None:
        """What the graph tells of all members; `before`: what it told last. Raises RuntimeError if it is singular."""
        self.members = Members(self.tracking, self._roster.reference, self.shift, before)
        if self.members.joint is not before:
            self._drift_unseen = True
        elif self._drift_unseen:  # what is done once a slot is not all done at once
            self._drift_unseen = False
            self._look_at_drift(self.members.joint)

    def _look_at_drift(self, joint: Joint) -> None:
        """What is known of everybody at the begin of the newest slots.

        Not where ranges are NLOS: these move people as drift does, and by more than covariances say.
        """
        if self.nlos_share > self._roster.parameters.search.doubtful_share:
            self.tracking.drift.begin()
            return
        users, slots = np.array(joint.at).T
        own = np.arange(len(users))[:, None, None]
        rows = np.array(_DRIFTING)
        covariances = joint.covariance[own, rows[:, None], own, rows]
        self.tracking.drift.look(users, slots, covariances, self.tracking.noise_of(users))

    def place_members(self) -> None:
        """Everybody who is followed is where the graph has it."""
        members, roster = self.members, self._roster
        assert members is not None
        for user in members.order:
            roster.standings[user].placed = members.placed(user)
        if roster.reference in members.order and not roster.standings[roster.reference].contradicted:
            self._begun = roster.standings[roster.reference].placed

    def common_from_graph(self, found: Found) -> Array | None:
        """(4,) x, y, z, yaw: the common frame from that of a search; None where its gauge is followed no more.

        Where nobody is followed the graph is going to have its origin where the search has.
        """
        gauge, own = found.gauge, found.users[found.gauge]
        members = self.tracking.members
        if not members and (survey := self._roster.users[self._roster.reference].position) is not None:
            self.shift = np.array(survey)
            return np.append(self.shift, 0.0)
        if not members:
            scale = float(np.exp(own.calibration[0]))
            if self._begun is None:
                first = found.anchor + np.array([0.0, 0.0, self._roster.level_of(gauge)])
                on_map = np.linalg.norm(first) > self._roster.parameters.priors.farthest_begin
                self.shift = first if on_map else scale * first
                return np.append(self.shift, 0.0)
            # The common frame stays where it was: where the reference was followed to be last, SLAM followed since.
            height = float(self._begun.state[3]) - scale * float(self._begun.place[2])
            place = self._begun.at(found.anchor)
            self.shift = np.array([place[0], place[1], height])
            return np.append(self.shift, float(self._begun.state[2]))
        if gauge not in members:
            return None
        slots = [n for n in found.poses[gauge].slots if self.tracking.has(gauge, n)]
        if not slots:
            return None
        slot = slots[-1]
        x, y, yaw, height = self.tracking.state_at(gauge, slot)[:4].tolist()
        there = own.states[found.poses[gauge].slots.index(slot)]
        turn = wrap_angle(float(yaw - there[3]))
        place = np.array([x, y, height]) + self.shift - apply_frames(np.array([0.0, 0.0, 0.0, turn]), there[:3])
        return np.append(place, turn)

    # Who is followed

    def join(self, joining: Mapping[int, JoiningUser], reference: int | None) -> None:
        """Follow more users, as a search found them; `reference` begins the common frame."""
        tracking = self.tracking
        tracking.join(joining, reference)
        tracking.drift.begin()
        members, new = list(tracking.members), list(joining)
        rows = self._log.rows
        i, j = self._log.users(rows)
        between = np.isin(i, members) & np.isin(j, members) & (np.isin(i, new) | np.isin(j, new))
        tracking.add(self._log.to_follow(rows[between]))
        try:
            tracking.advance(self._roster.now, set(), settle=True)
            self._look()
        except RuntimeError:
            self.give_up()
            return
        tracking.take_innovations({})
        self.place_members()

    def leave(self, user: int) -> None:
        """Follow a user no more."""
        if user not in self.tracking.members:
            return
        self.contradictions.forget(user)
        if len(self.tracking.members) == 2:  # nobody left beside whom to be
            self.give_up(but=user)
            return
        try:
            self.tracking.leave(user)
            self.tracking.drift.begin()
            self._look()
        except RuntimeError:
            self.give_up(but=user)
            return
        if self.tracking.moved() > self._roster.parameters.integrity.largest_error:
            # What is left tells another story than all together: not one of the rest is known by itself.
            self.give_up(but=user)

    def give_up(self, but: int | None = None) -> None:
        """Follow nobody any more: what the graph knew is lost. What becomes of one user, the caller says."""
        roster, before = self._roster, self.tracking
        for user in list(before.members):
            if user not in (roster.reference, but):
                roster.look_anew(user, State.UNOBSERVABLE, "it is looked for anew")
        self.tracking = Tracking(roster.users, roster.streams, roster.parameters)
        self.tracking.origin, self.tracking.noise, self.tracking.drift = before.origin, before.noise, before.drift
        self.tracking.drift.begin()
        self.tracking.assumed_clock, self.tracking.read_clock = before.assumed_clock, before.read_clock
        self.contradictions.suspected = frozenset()
        self.members = None

    def forget(self, begin: float, most: int) -> float:
        """What was before `begin` (s), so many slots at most; returns from when on (s) all is needed still."""
        tracking = self.tracking
        if not tracking.follower.slots:
            return begin
        before = min(tracking.slot_of(begin), next(iter(tracking.follower.slots)) + most)
        gone = tracking.forget(before)
        for user in gone:
            self._lose(user)
        if gone:
            self.members = None
            if len(tracking.members) > 1:
                self._look()
            elif tracking.members:
                self.give_up()
        return min(begin, tracking.begin_of(before))

    def _lose(self, user: int) -> None:
        """Nothing of a user has come for so long that it is followed no more."""
        self.contradictions.forget(user)
        roster = self._roster
        standing = roster.standings[user]
        reason = f"nothing of it has come for {roster.parameters.incremental.window:g} s"
        standing.begin_again(roster.now, State.DISCONNECTED, reason)
        standing.since = None
        if user != roster.reference:
            roster.tell(user)

    # To and from plain values

    def to_state(self) -> dict[str, Any]:
        """All that it knows, as `restore` takes it."""
        return kept(self) | {
            "innovations": self.contradictions.recent,
            "suspected": sorted(self.contradictions.suspected),
            "tracking": self.tracking.state(),
            "joint": None if self.members is None else self.members.joint,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """What `to_state` told of the same users. KeyError, ValueError or RuntimeError where it does not fit."""
        restore_kept(self, state)
        self.contradictions.restore(state["innovations"], frozenset(state["suspected"]))
        self.tracking.restore(state["tracking"])
        if self.tracking.members:
            self._look(state["joint"])
