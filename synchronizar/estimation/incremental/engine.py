"""Everybody's frame while poses and ranges come: people are followed, and looked for beside that.

Those whose places are known are followed by one graph (following.py): every range counts at once. Those whose places
are not known are looked for in all that came lately (search.py), beside the following, in a process of their own where
there is one. When is told by schedule.py, what is asked by asked.py. What a search finds is judged as the batch solve
judges (findings.py); who is registered is followed from then on, and still looked for until that has stood for a while.
Ranges that contradict a user who is followed end that within a second (judging.py), and so does a jump of its SLAM
until it is mended.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from synchronizar.arrays import Array, Indices, Mask
from synchronizar.data.jump import Jump
from synchronizar.data.registration import State
from synchronizar.data.user import User
from synchronizar.estimation.incremental.asked import snapshot_of
from synchronizar.estimation.incremental.cueing import Cueing
from synchronizar.estimation.incremental.findings import Findings
from synchronizar.estimation.incremental.following import Following
from synchronizar.estimation.incremental.judging import Judging
from synchronizar.estimation.incremental.kept import Kept, kept, restore_kept
from synchronizar.estimation.incremental.range_log import RangeLog
from synchronizar.estimation.incremental.range_verdicts import verdicts_on
from synchronizar.estimation.incremental.roster import Roster
from synchronizar.estimation.incremental.schedule import Schedule
from synchronizar.estimation.incremental.searcher import Searcher
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.stamp_guard import StampGuard
from synchronizar.quaternions import multiply_quaternions, yaw_quaternion
from synchronizar.threads import one_blas_thread

_Range = tuple[int, int, int, float, Mapping[str, float]]
"""Its running index, both users, m, further columns."""


class Engine:
    """Frames of users while poses and ranges come; users by their index. `Estimator` is its face, by names."""

    def __init__(
        self, users: tuple[User, ...], reference: int, parameters: Parameters | None = None, workers: int = 0
    ) -> None:
        """`users` sorted by name; the reference moves. `workers`: processes that search, 0 or 1."""
        self.parameters = parameters or Parameters()
        self.roster = Roster(users, reference, self.parameters)
        self.log = RangeLog(self.parameters)
        self.following = Following(self.roster, self.log)
        self.schedule = Schedule(self.roster, self.following)
        self.findings = Findings(self.roster, self.following)
        self._judging = Judging(self.roster, self.log, self.following, self.schedule)
        self._cueing = Cueing(self.roster, self.log, self.following)
        self._searcher = Searcher(workers)
        self._clock: StampGuard[None] = StampGuard(self.parameters)
        self._guard: StampGuard[_Range] = StampGuard(self.parameters)
        self._told = 0  # ranges

    @property
    def users(self) -> tuple[User, ...]:
        """In the order in which they came."""
        return self.roster.users

    @property
    def reference(self) -> int:
        """Whose frame the common one is."""
        return self.roster.reference

    def close(self) -> None:
        """End its process."""
        self._searcher.close()

    # What comes

    def add_pose(self, user: int, t: float, position: Sequence[float], quat_xyzw: Sequence[float]) -> None:
        """A device's own pose: s by its own clock, m, in its own frame."""
        stream = self.roster.streams[user]
        if stream is not None:
            x, y, z = position
            level = self.roster.level_of(user, z)
            stream.add(t, (x, y, z - level) if level else position, quat_xyzw)

    def add_range(self, t: float, a: int, b: int, distance: float, **optional: float) -> None:
        """A distance (m) by the ranges' clock (s); `optional` are further columns of `Ranges`.

        One that is stamped far away from the others waits until the next ones say whether time is there.
        """
        admitted = self._guard.admit(t, (self._told, a, b, distance, optional))
        self._told += 1
        if admitted.anew:  # the few that came before were stamped astray
            self.log.restore(self.log.rows[:0], 0)
            self.following.tracking.origin = np.nan
            for standing in self.roster.standings:
                standing.since = None
        for stamp, measured in admitted.items:
            self._add_range(stamp, *measured)

    def _add_range(self, t: float, serial: int, a: int, b: int, distance: float, optional: Mapping[str, float]) -> None:
        tracking = self.following.tracking
        if not np.isfinite(tracking.origin):
            tracking.origin = t
        if self.log.add(serial, t, a, b, distance, optional):
            for user in (a, b):
                standing = self.roster.standings[user]
                if standing.since is None:
                    standing.since = t

    def lost_tracking(self, user: int) -> None:
        """A device's SLAM has lost itself: what it tells from now on need not continue what it told before."""
        self._restart(user, "its SLAM lost track")

    def new_session(self, user: int) -> None:
        """A device's SLAM began anew, in another frame."""
        self._restart(user, "its SLAM began anew")

    def _restart(self, user: int, why: str) -> None:
        if self.users[user].static:
            return
        self.following.leave(user)
        self.following.tracking.drift.forget(user)
        self.roster.renew_stream(user)
        self.roster.look_anew(user, State.UNOBSERVABLE, f"{why}: it is looked for anew")
        self.roster.standings[user].contradicted = user == self.reference and self.solved
        self._searcher.abandon()

    def add_user(self, user: User) -> None:
        """One more user, the last by index."""
        self.roster.add_user(user)
        self.following.tracking.add_user(user)
        self._cueing.add_user()
        self._searcher.abandon()
        self.findings.candidates = ()

    # Time goes on

    @one_blas_thread()
    def advance(self, t: float) -> list[str]:
        """It is `t` (s, range clock): follow, take in what a search found, begin the next one.

        Returns what has happened, a sentence each. To be called ten times a second or more often. A time far away from
        the ones before counts when the next ones are there too.
        """
        admitted = self._clock.admit(t, None)
        self.roster.now = max([-np.inf if admitted.anew else self.roster.now, *(stamp for stamp, _ in admitted.items)])
        if self.roster.notice_slam():
            self._judging.judge_soon()
        self.following.advance()
        self._take_found()
        if not self._searcher.busy and self.schedule.due():
            self._search()
        self._judging.advance()
        self._cueing.advance()
        return self.roster.take_events()

    def complete(self, t: float) -> list[str]:
        """As `advance`, and search once more in all that has come."""
        for stream in self.roster.streams:
            if stream is not None:
                stream.settle()
        events = self.advance(t)
        if self.schedule.sought() and not self._searcher.busy:
            self._search()
            self._judging.advance()
        return [*events, *self.roster.events]

    def _search(self) -> None:
        """Begin a search, and take in what it found where it has ended at once."""
        self._judge_attitudes()
        sought, checking = self.schedule.begin()
        snapshot = snapshot_of(self.roster, self.following, self.log, sought, checking, self.findings.candidates)
        if len(snapshot.serial):
            self._searcher.begin(snapshot)
        self._take_found()

    def _judge_attitudes(self) -> None:
        """Whoever was placed by antennas that are not where its attitudes have them is looked for anew."""
        before = self.roster.users
        found = self.roster.judge_attitudes()
        if self.roster.users is not before:
            self.following.tracking.use_antennas(self.roster.users)
        for user in found:
            if user != self.reference and user in self.following.tracking.members:
                self.following.leave(user)
                self.roster.look_anew(
                    user, State.UNOBSERVABLE, "its attitudes cannot be believed: it is looked for anew"
                )

    def _take_found(self) -> None:
        """Take in what a search found, if one has ended."""
        _, found = self._searcher.poll()
        if found is not None and found.gauge in found.users:
            self.findings.take(found, self.schedule.sought())
            self._judging.judge_soon()  # who has joined may be less sure beside those who are followed than a search is

    # What is told

    @property
    def solved(self) -> bool:
        """Whether anything was found yet."""
        return self.findings.found is not None

    def state(self, user: int) -> State:
        """Of a user at this moment."""
        return self.roster.state(user, self.following.contradictions.suspected)[0]

    def reason(self, user: int) -> str:
        """Why the state is what it is."""
        return self.roster.state(user, self.following.contradictions.suspected)[1]

    def jumps(self, user: int) -> tuple[Jump, ...]:
        """Those of a user's SLAM that were found and mended."""
        stream = self.roster.streams[user]
        return () if stream is None else tuple(stream.jumps)

    def pose(self, user: int, position: Array, quat_xyzw: Array) -> tuple[Array, Array] | None:
        """A pose of SLAM's own (3,), (4,) in the common frame, SLAM followed since the user was placed; None: nowhere.

        The reference is at its own SLAM's pose before anything is solved.
        """
        stream, placed = self.roster.streams[user], self.roster.standings[user].placed
        if stream is None or (placed is None and (user != self.reference or self.following.tracking.members)):
            return None
        level = np.array([0.0, 0.0, self.roster.level_of(user)])
        place, attitude = stream.current_axes().repaired(position - level, quat_xyzw)
        if placed is None:
            return place + level, attitude
        return placed.at(place), multiply_quaternions(yaw_quaternion(float(placed.state[2])), attitude)

    def range_verdicts(self, serial: Indices) -> tuple[Mask, Array, Array, Array]:
        """Of ranges by running index (n,): usable, probability of line of sight, weight (1/m^2), residual (m)."""
        return verdicts_on(serial, self.findings.found, self.following.tracking)

    # To and from plain values

    def to_state(self) -> dict[str, Any]:
        """All that it knows, as `restore` takes it; a search that is going on is not waited for."""
        return {
            "ranges": (self.log.rows.copy(), self.log.taken, self._told),
            "guards": [(guard.last, guard.count, list(guard.held)) for guard in (self._clock, self._guard)],
            "roster": self.roster.to_state(),
            "following": self.following.to_state(),
            **{name: kept(part) for name, part in self._others().items()},
        }

    def _others(self) -> dict[str, Kept]:
        """Parts that are no more than some of their attributes."""
        return {
            "schedule": self.schedule,
            "findings": self.findings,
            "judging": self._judging,
            "cueing": self._cueing,
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """What `to_state` told of an engine of the same users. KeyError, ValueError or TypeError if it is malformed."""
        *ranges, self._told = state["ranges"]
        self.log.restore(*ranges)
        self._clock.last, self._clock.count, self._clock.held = state["guards"][0]
        self._guard.last, self._guard.count, self._guard.held = state["guards"][1]
        self.roster.restore(state["roster"])
        self.following.restore(state["following"])
        for name, part in self._others().items():
            restore_kept(part, state[name])
