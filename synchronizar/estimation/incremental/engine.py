"""Everybody's frame while poses and ranges come: people are followed, and looked for beside that.

Those whose places are known are followed by one graph (tracking.py): every range counts at once. Those whose places are
not known are looked for in all that came lately (search.py), beside the following, in a process of their own where
there is one. What a search finds is judged as the batch solve judges; who is registered is followed from then on, and
still looked for until that has stood for a while. Ranges that contradict a user who is followed end that within a
second (contradictions.py), and so does a jump of its SLAM until it is mended.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from synchronizar.arrays import Array, Indices, Mask
from synchronizar.data.jump import Jump
from synchronizar.data.recording import Recording
from synchronizar.data.registration import State
from synchronizar.data.track import Track
from synchronizar.data.user import User
from synchronizar.estimation.hypotheses import GaussianComponent, Hypothesis
from synchronizar.estimation.incremental.contradictions import Contradictions
from synchronizar.estimation.incremental.cues import cue_of
from synchronizar.estimation.incremental.members import Members
from synchronizar.estimation.incremental.range_log import RangeLog
from synchronizar.estimation.incremental.searcher import Searcher
from synchronizar.estimation.incremental.slot_ranges import SERIAL
from synchronizar.estimation.incremental.snapshot import Candidate, Found, FoundUser, SlotPoses, Snapshot
from synchronizar.estimation.incremental.standing import Placed, Standing
from synchronizar.estimation.incremental.tracking import JoiningUser, Tracking
from synchronizar.geometry import apply_frames, wrap_angle
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.extent import extent_points_of
from synchronizar.preprocessing.pose_stream import PoseStream, SetAside, Tail
from synchronizar.preprocessing.stamp_guard import StampGuard
from synchronizar.quaternions import multiply_quaternions, normalized_quaternions, yaw_of_quaternions, yaw_quaternion
from synchronizar.threads import one_blas_thread

_LONG_AGO = -1e9  # s: a track of one pose there covers no range
_NOWHERE = Track(np.array([_LONG_AGO]), np.zeros((1, 3)), np.array([[0.0, 0.0, 0.0, 1.0]]))
_RECENT_WALK = 1.0  # s: in which somebody's way shows
_WATCHED_AT = 0.9  # of the progress: while a user is watched
_FOLLOWED_AT = 0.25  # of the progress: who is known worse is not followed, for nothing is linear so far off
_FIRST_SEARCH = 1.0  # s after the first range
# s after a slot's begin: what is done once a slot is not all done at once.
_JUDGED_AFTER, _FORGOTTEN_AFTER, _CUED_AFTER = 0.15, 0.25, 0.35
_MORE_FORGOTTEN = 2  # slots at once, beside those that went by
_LEAST_PROGRESS = 0.01  # less is not told from none
_PARTED, _PARTED_SIGMAS = 0.25, 3.0  # of the largest error, of a search's: who is further off in height is elsewhere
_PROVING_INTERVAL = 2.0  # s between two searches while all who are sought are registered


_Range = tuple[int, int, int, float, Mapping[str, float]]
"""Its running index, both users, m, further columns."""


class Engine:
    """Frames of users while poses and ranges come; users by their index. `Estimator` is its face, by names."""

    def __init__(
        self, users: tuple[User, ...], reference: int, parameters: Parameters | None = None, workers: int = 0
    ) -> None:
        """`users` sorted by name; the reference moves. `workers`: processes that search, 0 or 1."""
        self.users, self.reference = users, reference
        self.parameters = parameters or Parameters()
        self.streams = [None if user.static else PoseStream(self.parameters) for user in users]
        self.log = RangeLog(self.parameters)
        self.tracking = Tracking(users, self.streams, self.parameters)
        self.standings = [Standing() for _ in users]
        self.now = -np.inf
        self.shift = np.zeros(3)
        """(3,) m: where the graph's origin lies in the common frame."""
        self.searched = -np.inf
        self.alternatives: list[tuple[float, dict[int, Array]]] = []
        self._begun: Placed | None = None
        """Where the reference was followed to be last; None before anybody was followed."""
        self._candidates: tuple[Candidate, ...] = ()
        self._found: Found | None = None
        self._clock: StampGuard[None] = StampGuard(self.parameters)
        self._guard: StampGuard[_Range] = StampGuard(self.parameters)
        self._told = 0  # ranges
        self._searcher = Searcher(workers)
        self._contradictions = Contradictions(self.parameters)
        self._members: Members | None = None
        self._spread: dict[int, float] = {}
        self._events: list[str] = []
        self._judged = -1
        self._forgotten = -1
        self._cued = [-1 for _ in users]
        self._nlos_share = 0.0
        self._checked = -np.inf

    def close(self) -> None:
        """End its process."""
        self._searcher.close()

    # What comes

    def add_pose(self, user: int, t: float, position: Sequence[float], quat_xyzw: Sequence[float]) -> None:
        """A device's own pose: s by its own clock, m, in its own frame."""
        stream = self.streams[user]
        if stream is not None:
            stream.add(t, position, quat_xyzw)

    def add_range(self, t: float, a: int, b: int, distance: float, **optional: float) -> None:
        """A distance (m) by the ranges' clock (s); `optional` are further columns of `Ranges`.

        One that is stamped far away from the others waits until the next ones say whether time is there.
        """
        admitted = self._guard.admit(t, (self._told, a, b, distance, optional))
        self._told += 1
        if admitted.anew:  # the few that came before were stamped astray
            self.log.restore(self.log.rows[:0], 0)
            self.tracking.origin = np.nan
            for standing in self.standings:
                standing.since = None
        for stamp, measured in admitted.items:
            self._add_range(stamp, *measured)

    def _add_range(self, t: float, serial: int, a: int, b: int, distance: float, optional: Mapping[str, float]) -> None:
        if not np.isfinite(self.tracking.origin):
            self.tracking.origin = t
        if self.log.add(serial, t, a, b, distance, optional):
            for user in (a, b):
                if self.standings[user].since is None:
                    self.standings[user].since = t

    def lost_tracking(self, user: int) -> None:
        """A device's SLAM has lost itself: what it tells from now on need not continue what it told before."""
        self._restart(user, "its SLAM lost track")

    def new_session(self, user: int) -> None:
        """A device's SLAM began anew, in another frame."""
        self._restart(user, "its SLAM began anew")

    def _restart(self, user: int, why: str) -> None:
        if self.streams[user] is None:
            return
        self._unfollow(user)
        self.streams[user] = PoseStream(self.parameters)
        self.standings[user].begin_again(self.now, State.UNOBSERVABLE, f"{why}: it is looked for anew")
        self.standings[user].contradicted = user == self.reference and self.solved
        self._searcher.abandon()
        self._tell(user)

    def add_user(self, user: User) -> None:
        """One more user, the last by index."""
        self.users = (*self.users, user)
        self.streams.append(None if user.static else PoseStream(self.parameters))
        self.standings.append(Standing())
        self._cued.append(-1)
        self.tracking.add_user(user)
        self._searcher.abandon()
        self._candidates = ()

    # Time goes on

    @one_blas_thread()
    def advance(self, t: float) -> list[str]:
        """It is `t` (s, range clock): follow, take in what a search found, begin the next one.

        Returns what has happened, a sentence each. To be called ten times a second or more often. A time far away from
        the ones before counts when the next ones are there too.
        """
        admitted = self._clock.admit(t, None)
        self.now = max([-np.inf if admitted.anew else self.now, *(stamp for stamp, _ in admitted.items)])
        self._notice_slam()
        self._follow()
        self._take_found()
        if not self._searcher.busy and self._search_due():
            self._begin_search()
            self._take_found()
        self._judge_members()
        self._tell_cues()
        events, self._events = self._events, []
        return events

    def complete(self, t: float) -> list[str]:
        """As `advance`, and search once more in all that has come."""
        for stream in self.streams:
            if stream is not None:
                stream.settle()
        events = self.advance(t)
        if self._sought() and not self._searcher.busy:
            self._begin_search()
            self._take_found()
            self._judge_members()
        return [*events, *self._events]

    def _tell(self, user: int) -> None:
        standing = self.standings[user]
        self._events.append(f"{self.users[user].name}: {standing.state}: {standing.reason}")

    def _notice_slam(self) -> None:
        """Jumps and doubts of devices' SLAM."""
        for user, stream in enumerate(self.streams):
            if stream is None:
                continue
            for event in stream.take_events():
                if isinstance(event, Jump):
                    self._judged = -1  # how sure its place is now is told at once
                    what = f"its SLAM jumped by {event.distance:.2f} m and {np.degrees(event.turn):.0f} deg: mended"
                    self._events.append(f"{self.users[user].name}: {what}")
                elif isinstance(event, SetAside):
                    self._events.append(f"{self.users[user].name}: {event.poses} {event.reason} poses are set aside")

    # Following

    def _follow(self) -> None:
        rows = self.log.take()
        tracking = self.tracking
        if not tracking.members:
            return
        if len(rows):
            i, j = self.log.users(rows)
            followed = np.zeros(len(self.users), dtype=bool)
            followed[list(tracking.members)] = True
            tracking.add(self.log.to_follow(rows[followed[i] & followed[j]]))
        doubted = {u for u, stream in enumerate(self.streams) if stream is not None and stream.suspect is not None}
        try:
            tracking.advance(self.now, doubted)
            self._members = Members(tracking, self.reference, self.shift)
        except RuntimeError:  # gtsam: the graph is singular, which no prior lets happen; all are looked for anew
            self._give_up()
            return
        self._contradictions.add(tracking.take_innovations(self._spread), self.now)
        self._read_members()

    def _read_members(self) -> None:
        """Where all are who are followed."""
        members = self._members
        assert members is not None
        for user in members.order:
            self.standings[user].placed = members.placed(user)
        if self.reference in members.order and not self.standings[self.reference].contradicted:
            self._begun = self.standings[self.reference].placed

    def _give_up(self, but: int | None = None) -> None:
        """Follow nobody any more: what the graph knew is lost. What becomes of one user, the caller says."""
        for user in list(self.tracking.members):
            if user not in (self.reference, but):
                self.standings[user].begin_again(self.now, State.UNOBSERVABLE, "it is looked for anew")
                self._tell(user)
        before = self.tracking
        self.tracking = Tracking(self.users, self.streams, self.parameters)
        self.tracking.origin, self.tracking.noise = before.origin, before.noise
        self.tracking.assumed_clock = before.assumed_clock
        self._contradictions.suspected = frozenset()
        self._members = None

    def _unfollow(self, user: int) -> None:
        """Follow a user no more."""
        if user not in self.tracking.members:
            return
        self._contradictions.forget(user)
        if len(self.tracking.members) == 2:  # nobody left beside whom to be
            self._give_up(but=user)
            return
        try:
            self.tracking.leave(user)
            self._members = Members(self.tracking, self.reference, self.shift)
        except RuntimeError:
            self._give_up(but=user)

    @property
    def gauge(self) -> int:
        """The user beside whom the others are judged: the reference while it is followed and not contradicted.

        Else who has the newest slot, one that moves before one that stands. The reference itself is looked for beside
        the others until it is registered again.
        """
        members = self.tracking.members
        others = [u for u in members if u != self.reference]
        if not others or (self.reference in members and not self.standings[self.reference].contradicted):
            return self.reference
        return max(others, key=lambda u: (members[u].slot, not self.users[u].static, -u))

    # Searching

    def _sought(self) -> list[int]:
        """Users that range and are not proven."""
        return [u for u, s in enumerate(self.standings) if s.since is not None and not s.proven and u != self.gauge]

    def _search_due(self) -> bool:
        sought = self._sought()
        m = self.parameters.incremental
        if not sought:
            doubtful = self._nlos_share > self.parameters.search.doubtful_share
            interval = m.doubtful_interval if doubtful else m.check_interval
            return bool(self.tracking.members) and self.now >= max(self.searched, self._checked) + interval
        first = min(s for u in sought if (s := self.standings[u].since) is not None)
        if self.now < first + _FIRST_SEARCH:
            return False
        growth = m.search_growth * (self.now - first)
        if all(self.standings[u].is_registered for u in sought):
            return self.now >= self.searched + max(_PROVING_INTERVAL, growth)
        times = [self._registered_from(u) for u in sought]
        near = max(t for t in times if t <= min(times) + m.search_interval_near)
        if self.now < near <= self.now + m.search_interval_near:
            return False  # one that is begun in a moment finds more
        soon = max(near, self.searched + max(m.search_interval_near, growth))
        return self.now >= min(soon, self.searched + max(m.search_interval, growth))

    def _registered_from(self, user: int) -> float:
        """s: from when on a search may find a user registered, by what is known of it; infinite if it already is."""
        standing, m = self.standings[user], self.parameters.integrity
        if standing.is_registered or standing.since is None or standing.verdict is None:
            return np.inf
        least = standing.since + m.least_duration
        if standing.verdict.state is State.REGISTERED:
            watched = -np.inf if standing.steady_since is None else standing.steady_since + m.watched_duration
            return max(least, watched)
        # While a user begins to walk, its sigmas fall with about the square of time.
        taken = (self.searched - standing.since) * (max(standing.progress, _LEAST_PROGRESS) ** -0.5 - 1.0)
        return float(max(least, self.searched + 0.5 * taken))

    def _window_begin(self) -> float:
        """s: the earliest moment that following and searches still need."""
        m = self.parameters
        begin = self.now - m.incremental.window
        since = [self.standings[u].since for u in self._sought()]
        known = any(self.standings[u].proven for u in self.tracking.members)
        longest = 2.0 * m.incremental.window if known else m.search.first_stretch
        return min([begin, *(max(s, self.now - longest) for s in since if s is not None)])

    def _begin_search(self) -> None:
        sought = self._sought()
        checking = not sought
        gauge = self.gauge
        if checking:
            sought = [u for u in self.tracking.members if u != gauge]
            self._checked = self.now
        self.searched = self.now
        begin = self._search_begin(sought)
        snapshot = self._snapshot(begin, gauge, sought, checking)
        if len(snapshot.serial):
            self._searcher.begin(snapshot)

    def _search_begin(self, sought: list[int]) -> float:
        if self.tracking.members:
            return self.tracking.begin_of(next(iter(self.tracking.follower.slots)))
        first = min((s for u in sought if (s := self.standings[u].since) is not None), default=self.now)
        return max(first, self.now - self.parameters.search.first_stretch)

    def _snapshot(self, begin: float, gauge: int, sought: list[int], checking: bool) -> Snapshot:
        tracks, segments, poses, first = {}, {}, {}, np.full(len(self.users), -np.inf)
        # A recording is sorted by name, and users are in the order in which they came.
        users = tuple(replace(user, name=f"{u:08d}") for u, user in enumerate(self.users))
        slots = list(range(self.tracking.slot_of(begin), self.tracking.slot_of(self.now) + 1))
        for u, (user, stream) in enumerate(zip(users, self.streams, strict=True)):
            if stream is None:
                poses[u] = SlotPoses(slots, np.zeros(len(slots) + 1), np.zeros((len(slots) + 1, 3)))
                continue
            since = self.standings[u].since
            # Of who is looked for anew only what came since then: before, its SLAM's frame was another one.
            own_begin = begin if checking or u not in sought or since is None else max(begin, since)
            stamp = own_begin + float(self.tracking.assumed_clock[u])
            tail = stream.tail(stamp)
            if not len(tail.t):
                tracks[user.name], segments[user.name] = _NOWHERE, np.zeros(1, dtype=np.int32)
                first[u] = np.inf
                continue
            tracks[user.name], segments[user.name] = _track_from(stream, stamp, tail)
            if own_begin > begin or (u != gauge and u not in self.tracking.members):
                first[u] = float(tail.t[0]) - float(self.tracking.assumed_clock[u])
            stamps = np.array([self.tracking.begin_of(n) for n in slots]) + self.tracking.assumed_clock[u]
            known = stream.at(stamps)
            there = np.flatnonzero(known.valid & (stamps >= tail.t[0]))
            poses[u] = _slot_poses([slots[n] for n in there.tolist()], stamps[there], known.position[there], tail)
            begins = self.tracking.slot_of(float(tail.t[0]) - float(self.tracking.assumed_clock[u]))
            if begins < poses[u].slots[0] if poses[u].slots else begins in slots:
                # It comes in the middle of a slot: its first one begins where its poses do.
                poses[u] = _slot_poses(
                    [begins, *poses[u].slots],
                    np.append(tail.t[0], stamps[there]),
                    np.concatenate([tail.position[:1], known.position[there]]),
                    tail,
                )
        rows = self.log.rows
        rows = rows[np.lexsort([rows[:, -1], rows[:, 0]])]
        a, b = self.log.users(rows)
        rows = rows[rows[:, 0] > np.maximum(begin, np.maximum(first[a], first[b]))]
        return Snapshot(
            self.now,
            Recording(users, tracks, self.log.ranges(rows)),
            rows[:, -1].astype(np.int32),
            segments,
            gauge,
            tuple(sought),
            self._candidates,
            {} if checking else self._known(sought),
            poses,
            tuple(u for u, s in enumerate(self.standings) if s.is_registered),
            self.parameters,
        )

    def _known(self, sought: list[int]) -> dict[int, Array]:
        """(4,) x, y, z, yaw of who is followed and not sought: a frame from its repaired SLAM's, lengths in m."""
        out = {}
        for u, tracked in self.tracking.members.items():
            if u not in sought:
                x, y, yaw, height, log_scale = tracked.state[:5].tolist()
                arm = apply_frames(np.array([0.0, 0.0, 0.0, yaw]), np.exp(log_scale) * tracked.place)
                out[u] = np.append(np.array([x, y, height]) - arm, yaw)
        return out

    def _take_found(self) -> None:
        """Judge what a search found, and follow those who are registered by it."""
        ended, found = self._searcher.poll()
        if not ended or found is None or found.gauge not in found.users:
            return
        common = self._common_from_graph(found)
        if common is None:
            return
        self._candidates = found.candidates
        self.tracking.noise = found.noise.copy()
        self._found = found
        self.alternatives = []
        sought = self._sought()
        joining: dict[int, JoiningUser] = {}
        for u in found.users:
            if u == found.gauge or (self.standings[u].since or 0.0) > found.t:  # begun again since then
                continue
            if u in sought:
                self._judge_found(u, found, common)
                own = found.users[u]
                vague = own.verdict.state is State.AMBIGUOUS or not own.single or own.progress < _FOLLOWED_AT
                if not vague and u not in self.tracking.members and (joined := self._joining(u, found, common)):
                    joining[u] = joined
            elif u in self.tracking.members:
                self._check_member(u, found, common)
        self._alternatives_of(found, common)
        # Who is not registered yet is followed too, for the others are beside it; but somebody must be, to begin with.
        if joining and (self.tracking.members or any(self.standings[u].is_registered for u in joining)):
            self._join(joining, found, common)
        self._take_heights(found, common)

    def _take_heights(self, found: Found, common: Array) -> None:
        """How far the heights that a search holds possible lie from where its users are followed.

        What a height is known to at one optimum grows with every slot, rightly or not; a search sees the others. Whose
        place is proven is told by all that was seen of it: a window may know less.
        """
        spread = self.tracking.height_spread
        for u, own in found.users.items():
            followed = self.standings[u].placed
            if u == found.gauge or u not in self.tracking.members or followed is None:
                continue
            off = float(self._at(self._placed(u, own, found, common), followed.place)[2] - followed.state[3])
            known = float(followed.covariance[2, 2] - spread[u])
            new = max(own.height_spread, float(own.covariance[2, 2]) - known) + off**2
            spread[u] = min(spread[u], new) if self.standings[u].proven else new
        if self._members is not None:
            self._read_members()

    def _common_from_graph(self, found: Found) -> Array | None:
        """(4,) x, y, z, yaw: the common frame from that of a search; None where its gauge is followed no more."""
        gauge, own = found.gauge, found.users[found.gauge]
        members = self.tracking.members
        if not members:
            scale = float(np.exp(own.calibration[0]))
            if self._begun is None:
                self.shift = scale * found.anchor
                return np.append(self.shift, 0.0)
            # The common frame stays where it was: where the reference was followed to be last, SLAM followed since.
            height = float(self._begun.state[3]) - scale * float(self._begun.place[2])
            place = self._at(self._begun, found.anchor)
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

    def _judge_found(self, user: int, found: Found, common: Array) -> None:
        """The new state of a user who was sought."""
        standing, own = self.standings[user], found.users[user]
        before = standing.placed
        placed = self._placed(user, own, found, common)
        state, reason = own.verdict.state, own.verdict.reason
        follows = user in self.tracking.members
        standing.progress = own.progress
        elsewhere = follows and (
            (
                self._elsewhere(user, placed)
                and self._gain_elsewhere(user, found) > self.parameters.integrity.cost_excluded
            )
            or self._at_other_height(user, own, placed)
        )
        if state is State.REGISTERED and elsewhere:
            self._unfollow(user)
            follows = False
        m = self.parameters.integrity
        doubted = found.t - standing.doubted_at < m.doubted_duration
        if state is State.REGISTERED and doubted and own.rejected > m.doubted_share:
            state, reason = State.UNOBSERVABLE, f"{own.rejected:.0%} of its latest ranges do not fit"
            if own.rejected > m.doubted_share + self._nlos_share:  # more than NLOS among the others: it lasts
                standing.doubted_at = found.t
        if state is State.REGISTERED and not (standing.is_registered or self._is_steady(standing, own, before, placed)):
            standing.progress *= _WATCHED_AT
            state, reason = State.UNOBSERVABLE, "its place is known, if it stays there: it is watched on"
        if state is State.REGISTERED:
            if standing.registered_at is None:
                standing.registered_at = found.t
            proven = found.t - standing.registered_at >= self.parameters.integrity.proven_duration
            standing.proven = proven and own.single
            standing.contradicted = False
        else:
            standing.registered_at, standing.proven = None, False
            if follows and (own.verdict.state is State.AMBIGUOUS or not own.single or elsewhere):
                self._unfollow(user)
                follows = False
            if state is not State.UNOBSERVABLE or own.verdict.state is not State.REGISTERED:
                standing.steady_since = None
        if not follows:
            standing.placed, standing.verdict = placed, own.verdict
        changed = state is not standing.state
        standing.state, standing.reason = state, reason
        if changed:
            self._tell(user)

    def _placed(self, user: int, own: FoundUser, found: Found, common: Array) -> Placed:
        """A user as a search found it, in the common frame."""
        turn = np.eye(6)
        c, s = np.cos(common[3]), np.sin(common[3])
        turn[:2, :2] = [[c, -s], [s, c]]
        place = apply_frames(common, own.place[:3])
        yaw = wrap_angle(float(own.place[3] + common[3]))
        state = np.array([place[0], place[1], yaw, place[2], *own.calibration])
        covariance = turn @ own.covariance @ turn.T
        return Placed(found.poses[user].places[-1], state, covariance, own.calibration_sigma)

    def _elsewhere(self, user: int, placed: Placed) -> bool:
        """Whether a search has a user somewhere else than it is followed to be."""
        followed = self.standings[user].placed
        if followed is None:
            return False
        there = self._at(placed, followed.place)
        m = self.parameters.integrity
        turn = abs(wrap_angle(float(placed.state[2] - followed.state[2])))
        here = np.array([*followed.state[:2], followed.state[3]])
        apart = float(np.linalg.norm(there - here))
        return apart > 0.5 * m.largest_error or turn > 0.5 * m.largest_yaw_error

    def _at_other_height(self, user: int, own: FoundUser, placed: Placed) -> bool:
        """Whether a search leaves no doubt that a user is higher or lower than it is followed to be."""
        followed = self.standings[user].placed
        if followed is None or own.verdict.state is not State.REGISTERED:
            return False
        off = abs(float(self._at(placed, followed.place)[2] - followed.state[3]))
        least = _PARTED * self.parameters.integrity.largest_error
        return off > max(least, _PARTED_SIGMAS * float(np.sqrt(own.covariance[2, 2])))

    def _at(self, placed: Placed, place: Array) -> Array:
        """(3,) m: where a place (3,) in a user's repaired SLAM frame is in the common one."""
        x, y, yaw, height, log_scale = placed.state[:5].tolist()
        frame = np.array([x, y, height, yaw])
        return np.asarray(apply_frames(frame, np.exp(log_scale) * (place - placed.place)))

    def _is_steady(self, standing: Standing, own: FoundUser, before: Placed | None, placed: Placed) -> bool:
        """Whether who seems registered has ranged for long enough, and stayed in its place where ranges are NLOS."""
        m = self.parameters.integrity
        assert standing.since is not None
        long_enough = self.now - standing.since >= m.least_duration
        if own.rejected <= m.watched_share:
            return long_enough
        if standing.steady_since is None or before is None:
            standing.steady_since = self.now
        else:
            apart = float(np.linalg.norm(self._at(before, placed.place) - self._at(placed, placed.place)))
            turn = abs(wrap_angle(float(placed.state[2] - before.state[2])))
            if apart > 0.5 * m.largest_error or turn > 0.5 * m.largest_yaw_error:
                standing.steady_since = self.now
        return long_enough and self.now - standing.steady_since >= m.watched_duration

    def _check_member(self, user: int, found: Found, common: Array) -> None:
        """A user who is followed was looked for anew: whether it may be somewhere else."""
        own = found.users[user]
        placed = self._placed(user, own, found, common)
        if not self._elsewhere(user, placed) or own.verdict.state is State.UNOBSERVABLE:
            return
        if self._gain_elsewhere(user, found) > self.parameters.integrity.cost_excluded_nlos:
            self._unfollow(user)
            reason = "another placement explains its ranges better"
            self.standings[user].begin_again(self.now, State.AMBIGUOUS, reason)
            self._tell(user)

    def _gain_elsewhere(self, user: int, found: Found) -> float:
        """Log likelihood that a user's latest ranges gain where a search has it, beside where it is followed to be."""
        followed = self.tracking.costs_of(user, found.ranges.serial, -found.ranges.residual)
        return float((followed[0] - followed[1]).sum())

    def _joining(self, user: int, found: Found, common: Array) -> JoiningUser | None:
        """A user's slots, as a search found it, in the graph's frame."""
        own, poses = found.users[user], found.poses[user]
        if not poses.slots:
            return None
        at = np.column_stack([apply_frames(np.broadcast_to(common, own.states.shape), own.states[:, :3]) - self.shift])
        yaw = wrap_angle(own.states[:, 3] + common[3])
        clock = 0.0 if self.users[user].static else float(own.calibration[2])
        rest = np.tile([own.calibration[0], own.calibration[1], 0.0], (len(at), 1))
        states = np.column_stack([at[:, :2], yaw, at[:, 2], rest])
        return JoiningUser(poses.slots, poses.stamps[:-1], poses.places[:-1], states, clock, own.height_weight)

    def _join(self, joining: dict[int, JoiningUser], found: Found, common: Array) -> None:
        """Follow more users."""
        tracking = self.tracking
        begins = None
        if not tracking.members:
            gauge = self._joining(found.gauge, found, common)
            if gauge is None:
                return
            joining = {found.gauge: gauge, **joining}
            begins = found.gauge
            self.standings[begins].contradicted = False
        tracking.join(joining, begins)
        members = list(tracking.members)
        rows = self.log.rows
        i, j = self.log.users(rows)
        new = list(joining)
        between = np.isin(i, members) & np.isin(j, members) & (np.isin(i, new) | np.isin(j, new))
        tracking.add(self.log.to_follow(rows[between]))
        try:
            tracking.advance(self.now, set(), settle=True)
            self._members = Members(tracking, self.reference, self.shift)
        except RuntimeError:
            self._give_up()
            return
        tracking.take_innovations({})
        self._read_members()

    def _alternatives_of(self, found: Found, common: Array) -> None:
        """The joint placements of a search, where there is more than one."""
        if len(found.alternatives) < 2:
            return
        best = found.alternatives[0][0]
        for cost, last in found.alternatives:
            frames = {}
            for u in found.users:
                place = np.append(apply_frames(common, last[u, :3]), wrap_angle(float(last[u, 3] + common[3])))
                frames[u] = self._own_frame(u, place, float(found.users[u].calibration[0]), found.poses[u].places[-1])
            self.alternatives.append((max(cost - best, 0.0), frames))

    # Verdicts on those who are followed

    def _judge_members(self) -> None:
        """Once a slot: who is still registered among those who are followed; and at any time who is contradicted."""
        tracking, members = self.tracking, self._members
        if members is None:
            return
        gauge = self.gauge
        contradicted = self._contradictions.found(self.now, gauge, self._trusted())
        if contradicted is not None:
            users, reason = contradicted
            for user in users:
                self._contradict(user, reason)
            return
        slot = tracking.slot_of(self.now - _FORGOTTEN_AFTER)
        if slot != self._forgotten:
            most, self._forgotten = abs(slot - self._forgotten) + _MORE_FORGOTTEN, slot
            self._forget(most)
        slot, members = tracking.slot_of(self.now - _JUDGED_AFTER), self._members
        if slot == self._judged or members is None:
            return
        self._judged = slot
        gauge = self.gauge
        recent = tracking.rejected(self.now - self.parameters.incremental.recent)
        self._nlos_share = float(recent[list(tracking.members)].mean())
        for user in list(tracking.members):
            standing = self.standings[user]
            if user == gauge or user not in members.order:
                continue
            tracked = tracking.members[user]
            extent = members.extent(user, tracked.stamp - self.parameters.incremental.judged_walk)
            verdict, near, _ = members.verdict(user, gauge, extent, float(recent[user]), standing.is_registered)
            relative = members.relative(user, gauge)
            self._spread[user] = float(np.sqrt(max(np.linalg.eigvalsh(relative[:2, :2])[-1], 0.0)))
            standing.verdict, standing.progress = verdict, near
            state, reason = verdict.state, verdict.reason
            if state is State.REGISTERED and standing.registered_at is None:
                continue  # only a search, which sees other placements too, registers anybody
            changed = state is not standing.state
            standing.state, standing.reason = state, reason
            if changed:
                self._tell(user)

    def _trusted(self) -> frozenset[int]:
        """Who is registered, and was not contradicted lately: of these more is needed to say that they moved."""
        since = self.now - self.parameters.integrity.doubted_duration
        told = {self.reference, *(u for u, standing in enumerate(self.standings) if standing.is_registered)}
        return frozenset(u for u in told if self.standings[u].doubted_at < since)

    def _tell_cues(self) -> None:
        """Once a slot, one after the other: which way those should walk whose places are not known well enough."""
        if not np.isfinite(self.tracking.origin):
            return
        turn = (1.0 - _CUED_AFTER) * self.parameters.slam.keyframe_interval / len(self.users)
        slots = [self.tracking.slot_of(self.now - _CUED_AFTER - turn * u) for u in range(len(self.users))]
        due = [u for u, slot in enumerate(slots) if slot != self._cued[u]]
        self._cued = slots
        if not due:
            return
        rows = self.log.rows
        i, j = self.log.users(rows[rows[:, 0] > self.now - self.parameters.incremental.recent])
        for user in due:
            standing = self.standings[user]
            before, standing.cue = standing.cue, None
            stream, placed = self.streams[user], standing.placed
            if stream is None or placed is None or self.state(user) is not State.UNOBSERVABLE or user == self.gauge:
                continue
            partners = np.unique(np.concatenate([j[i == user], i[j == user]])).tolist()
            places = [(self.users[u].name, at) for u in partners if (at := self._now(u)) is not None]
            recent = stream.tail(stream.newest - _RECENT_WALK)
            if not len(recent.t) or not places:
                continue
            if not np.diag(placed.covariance)[:4].max() < self.parameters.priors.place_sigma**2:
                continue  # nothing is known that a walk would add to
            here, began = self._at(placed, recent.position[-1]), self._at(placed, recent.position[0])
            velocity = (here - began)[:2] / max(float(np.ptp(recent.t)), 0.1)
            frames, covariances = np.zeros((len(self.users), 4)), np.zeros((len(self.users), 4, 4))
            frames[user] = [*placed.state[:2], placed.state[3], placed.state[2]]
            covariances[user] = placed.covariance[:4, :4]
            since = stream.newest - self.parameters.incremental.judged_walk
            walk = np.exp(placed.state[4]) * (extent_points_of(stream.tail(since).position) - placed.place)
            best = Hypothesis(0.0, frames, covariances, [GaussianComponent(1.0, frames, covariances)])
            names, others = [name for name, _ in places], np.array([at for _, at in places])
            standing.cue = cue_of(best, user, here, others, velocity, walk, names, before, self.parameters)

    def _now(self, user: int) -> Array | None:
        """(3,) m: where a user's device is now; None where that is not known."""
        stream, placed = self.streams[user], self.standings[user].placed
        last = None if stream is None else stream.last()
        if placed is None:
            return last.position[0] if last is not None and user == self.reference else None
        return self._at(placed, placed.place if last is None else last.position[0])

    def _contradict(self, user: int, reason: str) -> None:
        """A user's latest ranges contradict it: it is looked for in what comes from now on."""
        self._unfollow(user)
        self._contradictions.forget(user)
        self.standings[user].contradicted = user == self.reference
        self.standings[user].doubted_at = self.now
        self.standings[user].begin_again(self.now, State.UNOBSERVABLE, reason)
        self._tell(user)

    def _forget(self, most: int) -> None:
        """What nothing needs any more; so many slots at most, for a window that becomes short does so by and by."""
        begin = self._window_begin()
        tracking = self.tracking
        if tracking.members:
            before = min(tracking.slot_of(begin), next(iter(tracking.follower.slots)) + most)
            gone = tracking.forget(before)
            begin = min(begin, tracking.begin_of(before))
            for user in gone:
                self._lose(user)
        else:
            gone = []
        if gone:
            self._members = None
            if len(tracking.members) > 1:
                self._members = Members(tracking, self.reference, self.shift)
            elif tracking.members:
                self._give_up()
        for u, stream in enumerate(self.streams):
            if stream is not None:
                stream.forget(begin + float(tracking.assumed_clock[u]) - 2.0)
        self.log.forget(begin - 1.0)

    def _lose(self, user: int) -> None:
        """Nothing of a user has come for so long that it is followed no more."""
        self._contradictions.forget(user)
        standing = self.standings[user]
        reason = f"nothing of it has come for {self.parameters.incremental.window:g} s"
        standing.begin_again(self.now, State.DISCONNECTED, reason)
        standing.since = None
        if user != self.reference:
            self._tell(user)

    # What is told

    @property
    def solved(self) -> bool:
        """Whether anything was found yet."""
        return self._found is not None

    def state(self, user: int) -> State:
        """Of a user at this moment."""
        standing, stream = self.standings[user], self.streams[user]
        if user == self.reference and not standing.contradicted:
            return State.REGISTERED
        if self.standings[self.reference].contradicted and standing.is_registered:
            return State.UNOBSERVABLE
        if standing.is_registered and stream is not None and stream.suspect is not None:
            return State.UNOBSERVABLE
        if standing.is_registered and self._is_suspected(user):
            return State.UNOBSERVABLE
        return standing.state

    def _is_suspected(self, user: int) -> bool:
        """Whether its latest ranges make it doubtful where a user is; where the reference is, nobody is sure."""
        return not self._contradictions.suspected.isdisjoint((user, self.reference))

    def reason(self, user: int) -> str:
        """Why the state is what it is."""
        standing, stream = self.standings[user], self.streams[user]
        if user == self.reference and not standing.contradicted:
            return "the reference: its frame is the common one"
        if self.standings[self.reference].contradicted and standing.is_registered:
            return "the reference's own track is contradicted"
        if standing.is_registered and stream is not None and stream.suspect is not None:
            return f"its SLAM may have {'stopped' if stream.suspect.kind == 'frozen' else 'jumped'}"
        if standing.is_registered and self._is_suspected(user):
            return "its latest ranges may say that it is somewhere else"
        return standing.reason

    def jumps(self, user: int) -> tuple[Jump, ...]:
        """Those of a user's SLAM that were found and mended."""
        stream = self.streams[user]
        return () if stream is None else tuple(stream.jumps)

    def own_frame(self, user: int, placed: Placed) -> Array:
        """(4,) x, y, z, yaw: common_from_user of a placed user, for its newest poses."""
        x, y, yaw, height, log_scale = placed.state[:5].tolist()
        return self._own_frame(user, np.array([x, y, height, yaw]), log_scale, placed.place)

    def pose(self, user: int, position: Array, quat_xyzw: Array) -> tuple[Array, Array] | None:
        """A pose of SLAM's own (3,), (4,) in the common frame, SLAM followed since the user was placed; None: nowhere.

        The reference is at its own SLAM's pose before anything is solved.
        """
        stream, placed = self.streams[user], self.standings[user].placed
        if stream is None or (placed is None and (user != self.reference or self.tracking.members)):
            return None
        place, attitude = stream.current_axes().repaired(position, quat_xyzw)
        if placed is None:
            return place, attitude
        return self._at(placed, place), multiply_quaternions(yaw_quaternion(float(placed.state[2])), attitude)

    def range_verdicts(self, serial: Indices) -> tuple[Mask, Array, Array, Array]:
        """Of ranges by running index (n,): usable, probability of line of sight, weight (1/m^2), residual (m)."""
        n = len(serial)
        usable, inlier, weight, residual = np.zeros(n, dtype=bool), np.zeros(n), np.zeros(n), np.full(n, np.nan)
        if not n:
            return usable, inlier, weight, residual
        first = int(serial.min())
        place = np.full(int(serial.max()) - first + 1, -1)
        place[serial - first] = np.arange(n)
        if self._found is not None:
            of = self._found.ranges
            at, there = _places_of(of.serial, place, first)
            usable[at], inlier[at], weight[at] = True, of.inlier_probability[there], of.weight[there]
            residual[at] = of.residual[there]
        rows = self.tracking.ranges.rows
        if len(rows):
            followed, off, bring = self.tracking.range_verdicts()
            at, there = _places_of(rows[:, SERIAL].astype(np.int32), place, first)
            usable[at], inlier[at], weight[at], residual[at] = True, followed[there], bring[there], off[there]
        return usable, inlier, weight, residual

    def _own_frame(self, user: int, place: Array, log_scale: float, at: Array) -> Array:
        """(4,) x, y, z, yaw: common_from_user of a user whose device is at `place` (4,), SLAM's `at` (3,) repaired."""
        stream = self.streams[user]
        turned, offset = 0.0, np.zeros(3)
        if stream is not None:
            axes = stream.current_axes()
            turned, offset = float(yaw_of_quaternions(axes.quat_xyzw[None])[0]), axes.offset
        arm = apply_frames(np.array([0.0, 0.0, 0.0, place[3]]), np.exp(log_scale) * (at - offset))
        return np.append(place[:3] - arm, wrap_angle(float(place[3] + turned)))

    # To and from plain values

    def to_state(self) -> dict[str, Any]:
        """All that it knows, as `restore` takes it; a search that is going on is not waited for."""
        return {name: getattr(self, name) for name in _KEPT} | {
            "streams": [None if stream is None else stream.state() for stream in self.streams],
            "ranges": (self.log.rows.copy(), self.log.taken),
            "guards": [(guard.last, guard.count, list(guard.held)) for guard in (self._clock, self._guard)],
            "innovations": self._contradictions.recent,
            "suspected": sorted(self._contradictions.suspected),
            "tracking": self.tracking.state(),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """What `to_state` told of an engine of the same users. KeyError, ValueError or TypeError if it is malformed."""
        for name in _KEPT:
            setattr(self, name, state[name])
        for u, of_user in enumerate(state["streams"]):
            self.streams[u] = None if of_user is None else PoseStream.from_state(self.parameters, of_user)
        self.log.restore(*state["ranges"])
        self._clock.last, self._clock.count, self._clock.held = state["guards"][0]
        self._guard.last, self._guard.count, self._guard.held = state["guards"][1]
        self._contradictions.restore(state["innovations"], frozenset(state["suspected"]))
        self.tracking.restore(state["tracking"])
        if self.tracking.members:
            self._members = Members(self.tracking, self.reference, self.shift)


_KEPT = (
    *("standings", "now", "shift", "searched", "alternatives", "_candidates", "_found"),
    *("_told", "_spread", "_events", "_judged", "_forgotten", "_checked", "_begun", "_cued", "_nlos_share"),
)


def _slot_poses(slots: list[int], stamps: Array, places: Array, tail: Tail) -> SlotPoses:
    """Slots, and where a device is at their begins; its last pose besides."""
    return SlotPoses(slots, np.append(stamps, tail.t[-1]), np.concatenate([places, tail.position[-1:]]))


def _track_from(stream: PoseStream, stamp: float, tail: Tail) -> tuple[Track, Indices]:
    """A track from a stamp on, and the segments of its poses; it begins there where the pose is known."""
    t, position, quat, segment = tail.t, tail.position, tail.quat_xyzw, tail.segment
    first = stream.at(np.array([stamp]))
    if first.valid[0] and t[0] > stamp:
        t, segment = np.append(stamp, t), np.append(segment[0], segment)
        position, quat = np.concatenate([first.position, position]), np.concatenate([first.quat_xyzw, quat])
    return Track(t, position, normalized_quaternions(quat)), segment


def _places_of(known: Indices, place: Indices, first: int) -> tuple[Indices, Indices]:
    """The places of those of `known` that have one, and which these are; `place` of running index `first` is at 0."""
    there = np.flatnonzero((known >= first) & (known < first + len(place)))
    at = place[known[there] - first].astype(np.int32)
    return at[at >= 0], there[at >= 0].astype(np.int32)
