"""Everybody's frame while people walk: the same graph as the batch solve's, over the recent past, told at any time.

Poses and ranges are added as they come; `advance` goes on with what is to be solved. What is too old for the window is
carried as a Gaussian (carried.py) from where everybody was at its begin, which is always a moment that had been
solved up to then: no range counts twice. While somebody's place is not known the window reaches back to that user's
first range, two minutes at most, and the global search of the batch solve looks for it again and again; what was found
before is never the only start. Those that are known are followed from the last solution, a portion of the work at each
update, and checked for other placements now and then.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from pathlib import Path

import numpy as np

from synchronizar.arrays import Array
from synchronizar.cooperative import Cooperative, finish
from synchronizar.data.recording import Recording
from synchronizar.data.registration import Registration, State
from synchronizar.data.user import User
from synchronizar.estimation.answer import OwnFrames, registration_of
from synchronizar.estimation.assessment import assess_calibrated
from synchronizar.estimation.hypotheses import places
from synchronizar.estimation.incremental.cues import Cue, cue_of
from synchronizar.estimation.incremental.solution import Solution
from synchronizar.estimation.incremental.stream import Stream, Stretch
from synchronizar.estimation.incremental.window import Window
from synchronizar.estimation.incremental.window_state import Checkpoint, Memory, beginning, load, save
from synchronizar.geometry import YawFrame, moved_frames, rotation_2d, wrap_angle
from synchronizar.graph.marginal_prior import MarginalPrior
from synchronizar.graph.marginals import Errors, Marginals, errors_of, marginalized, marginals_of
from synchronizar.graph.pose_graph import LocalOptimum
from synchronizar.graph.problem import Problem
from synchronizar.graph.states import SCALE
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.relocalizations import RepairedTrack, repair_relocalizations
from synchronizar.quaternions import multiply_quaternions, yaw_of_quaternions

_NO_MORE = object()
_SAID = ("states", "known", "since", "steady", "registered")
_IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])
_RECENT_WALK = 1.0  # s: in which somebody's way shows
_WATCHED_AT = 0.9  # of the progress: while a user is watched
_PARTING = 0.25  # of the largest error: minima that are further apart at some corner of a walk may part
_SETTLED_ENOUGH = 20  # ranges: fewer tell nothing worth a search


class Engine:
    """Frames of users while poses and ranges come; users by their index. `Estimator` is its face, by names."""

    def __init__(self, users: tuple[User, ...], reference: str, parameters: Parameters | None = None) -> None:
        """`users` sorted by name. KeyError where `reference` is none of them; it must not stand still."""
        moving = {u.name: n for n, u in enumerate(users) if not u.static}
        self._begin_with(Stream(users), beginning(len(users), moving[reference]), parameters or Parameters())

    def _begin_with(self, stream: Stream, memory: Memory, parameters: Parameters) -> None:
        self.users, self.stream, self.memory, self.parameters = stream.users, stream, memory, parameters
        self.solution: Solution | None = None
        self._cues: dict[int, Cue] = {}
        self._untold: list[str] = []
        self._work: Cooperative[None] | None = None
        self._searched, self._searching = -np.inf, True
        self._near = np.zeros(len(self.users))

    def save(self, path: str | Path) -> None:
        """Write all that it knows to a file. Raises InputError where that cannot be."""
        self._finish()
        save(path, self.stream, self.memory)

    @classmethod
    def load(cls, path: str | Path, parameters: Parameters | None = None) -> Engine:
        """Go on from a file that `save` wrote. Raises InputError where it is none."""
        out = cls.__new__(cls)
        out._begin_with(*load(path), parameters or Parameters())
        if np.isfinite(out.memory.solved):
            # For its solution alone: what was said of everybody stands until the next solve is due.
            said = {name: copy(getattr(out.memory, name)) for name in _SAID}
            out._begin_to_solve(True)
            out._finish()
            for name, of_all in said.items():
                setattr(out.memory, name, of_all)
            out._untold = []
        return out

    def add_pose(self, user: str, t: float, position: Array, quat_xyzw: Array) -> None:
        """A device's own pose: s by its own clock, (3,) m and (4,) x y z w in its own frame."""
        self.stream.add_pose(user, t, position.tolist(), quat_xyzw.tolist())

    def add_range(self, t: float, a: str, b: str, distance: float, **optional: float) -> None:
        """A distance (m) by the ranges' clock (s); `optional` are further columns of `Ranges`."""
        for user in self.stream.add_range(t, a, b, distance, optional):
            self.memory.since.setdefault(user, t)

    def advance(self, t: float) -> list[str]:
        """It is `t` (s, range clock): go on with what is to be solved. Returns what has happened, a sentence each.

        A solve that goes on from the last one is done in some thirty portions of a few milliseconds each; a search
        for those whose place is not known is done at once. To be called ten times a second or more often.
        """
        self._at(t)
        if self._searching:
            self._finish()
        else:
            self._portion()
        return self._tell()

    def complete(self, t: float) -> list[str]:
        """As `advance`, and solve for all that has come, due or not."""
        self._at(t)
        self._finish()
        if self.stream.added != self.memory.seen:
            self._begin_to_solve(True)
            self._finish()
        return self._tell()

    def _at(self, t: float) -> None:
        self.memory.now = max(self.memory.now, t)
        if self.stream.added == self.memory.seen or self.memory.now < self._due():
            return
        if self._work is None or self._search_due():
            self._finish()
            self._begin_to_solve(self._search_due() or self._check_due())

    def _begin_to_solve(self, searching: bool) -> None:
        self._searching = searching
        if self._searching:
            self._searched = self.memory.now
        self.memory.seen, self.memory.solved = self.stream.added, self.memory.now
        self._work = self._solving(self._searching)

    def _portion(self) -> None:
        if self._work is not None and next(self._work, _NO_MORE) is _NO_MORE:
            self._work = None

    def _finish(self) -> None:
        work, self._work = self._work, None
        if work is not None:
            finish(work)

    def _tell(self) -> list[str]:
        """What has happened and was not told yet."""
        untold, self._untold = self._untold, []
        return untold

    def state(self, user: int) -> State:
        """Of a user at this moment."""
        return self.memory.states.get(user, State.REGISTERED if user == self.memory.reference else State.DISCONNECTED)

    @property
    def reference(self) -> int:
        """Whose frame the common one is."""
        return self.memory.reference

    def is_registered(self, user: int) -> bool:
        """Whether a user has a placement that can be relied on."""
        return self.solution is not None and self.state(user) is State.REGISTERED

    def progress(self, user: int) -> float:
        """0 .. 1 of how near a user is to being registered."""
        if self.state(user) is State.REGISTERED:
            return 1.0
        return float(np.nan_to_num(self._near[user]))

    def cue(self, user: int) -> Cue | None:
        """Which way a user who is not registered should walk; None where that would not help."""
        return self._cues.get(user)

    def _cue(self, user: int, before: Cue | None) -> Cue | None:
        solution, frame = self.solution, self.frame(user)
        if solution is None or frame is None or self.users[user].static or self.state(user) is not State.UNOBSERVABLE:
            return None
        measurements, frames = solution.graph.measurements, solution.last_poses
        mine = (measurements.i == user) | (measurements.j == user)
        partners = [u for u in np.unique([measurements.i[mine], measurements.j[mine]]).tolist() if u != user]
        now = [self.stream.last_pose(u) for u in partners]
        others = np.array(
            [
                frames[u, :3] if pose is None else solution.pose(u, pose[1:4], _IDENTITY)[0]
                for u, pose in zip(partners, now, strict=True)
            ]
        )
        recent = self.stream.poses_since(user, _RECENT_WALK)
        ends = np.array([solution.pose(user, row[1:4], _IDENTITY)[0] for row in recent[[0, -1]]])
        velocity = (ends[1] - ends[0])[:2] / max(float(recent[-1, 0] - recent[0, 0]), 0.1)
        placement = solution.told.hypotheses[0]
        turned = placement._replace(frames=frames, covariances=_turned(placement.covariances, solution.common[3]))
        names = [self.users[u].name for u in partners]
        return cue_of(
            turned, user, ends[1], others, velocity, solution.told.extent[user], names, before, self.parameters
        )

    def _registered(self) -> set[int]:
        return {u for u, state in self.memory.states.items() if state is State.REGISTERED}

    # When, and since when

    def _unknown(self) -> list[int]:
        """Users that range and whose place is not known."""
        return [u for u in self.memory.since if u not in self.memory.known]

    def _due(self) -> float:
        """When the next solve is: each keyframe; while nobody is known, when the next search is."""
        follow = self.memory.solved + self.parameters.slam.keyframe_interval
        if not self._unknown():
            return follow
        followed = self.solution is not None and len(self.memory.known) > 1
        return min(follow, self._next_search()) if followed else self._next_search()

    def _search_due(self) -> bool:
        return bool(self._unknown()) and self.memory.now >= self._next_search()

    def _check_due(self) -> bool:
        """Whether those that are known are to be looked at anew, with what else might explain their ranges."""
        return not self._unknown() and self.memory.now >= self._searched + self.parameters.incremental.check_interval

    def _next_search(self) -> float:
        """Those whose place is not known are looked for ever more seldom."""
        looked = self._searched - min(self.memory.since[u] for u in self._unknown())
        return self._searched + max(
            self.parameters.incremental.search_interval, self.parameters.incremental.search_growth * looked
        )

    def _move_window(self) -> None:
        """Begin the window as late as all that must be in it allows, and never earlier than before."""
        m, memory = self.parameters, self.memory
        latest = memory.now - m.incremental.window
        for u in self._unknown():
            latest = min(latest, max(memory.since[u], memory.now - m.search.first_stretch))
        needed = memory.known & memory.since.keys() - {memory.gauge}
        able = [n for n, c in enumerate(memory.checkpoints) if c.t <= latest and all(c.has(user) for user in needed)]
        if able and able[-1] > 0:
            begun, memory.checkpoints = memory.begin, memory.checkpoints[able[-1] :]
            if self.solution is not None and self.solution.checkpoint is begun:
                # Where everybody's frame lies is known better than it was then, its scale above all.
                common = self.solution.anchor_at(memory.gauge, float(memory.begin.begin[memory.gauge]))
                memory.checkpoints[0] = replace(memory.begin, common=common)

    # The solve

    def _solving(self, searching: bool) -> Cooperative[None]:
        """All that came until now.

        Those whose place is not known are judged where all is `searching` for them; between searches they stay
        where the last one found them, and so does the window, for nothing of theirs is carried.
        """
        memory, m, now = self.memory, self.parameters, self.memory.now
        if searching or not self._unknown():
            self._move_window()
        self._hand_over()
        begin = memory.begin
        stretch = self.stream.stretch(begin.begin, begin.axes, begin.lift)
        repaired_tracks = {}
        for name, track in stretch.recording.tracks.items():
            yield
            repaired_tracks[name] = repair_relocalizations(track, m)
        repaired = replace(stretch.recording, tracks={name: of.track for name, of in repaired_tracks.items()})
        problem = Problem.of(repaired, memory.gauge, m)
        self._part(problem.active_users)
        last = None if searching and self._unknown() else self._last()
        if last is not None:
            problem = problem.among(last.graph.active_users)
        active_users = problem.active_users
        if len(problem.measurements) < _SETTLED_ENOUGH:
            return
        marginal_prior = _of(begin.marginal_prior, active_users, memory.known)
        window = Window(problem, repaired_tracks, marginal_prior, memory.noise, memory.range_weight)
        yield
        minima, noise = yield from window.minima(last, searching)
        yield
        memory.noise, memory.range_weight = noise, float(minima[0].em_weights.range_weight.mean())
        best = minima[0]
        errors = yield from errors_of(best.graph, best.states, best.em_weights)
        sure = marginals_of(best.graph, best.states, errors)
        before = self.solution
        self.solution = self._told(begin, stretch, repaired, repaired_tracks, minima, noise, sure)
        yield
        self._judge(active_users if searching else [u for u in active_users if u in memory.known], now, before)
        self._remember(stretch, errors, now)
        self._cues, cues = {}, self._cues
        for u in active_users:
            cue = self._cue(u, cues.get(u))
            if cue is not None:
                self._cues[u] = cue

    def _last(self) -> LocalOptimum | None:
        """The last solution goes on where the window begins where that one's began."""
        last = self.solution
        return last.minima[0] if last is not None and last.checkpoint is self.memory.begin else None

    def _hand_over(self) -> None:
        """Where the user that windows are told about ranges no more, another takes its place; the frame stays."""
        late = self.stream.ranges_since(self.memory.now - self.parameters.incremental.window)[:, 1:].astype(int)
        heard = np.bincount(late.ravel(), minlength=len(self.users))
        marginal_prior = self.memory.begin.marginal_prior
        if heard[self.memory.gauge] or marginal_prior is None:
            return
        able = [u for u in marginal_prior.free if u in self.memory.known and heard[u] and not self.users[u].static]
        if able:
            heir = max(able, key=lambda u: heard[u])
            memory = self.memory
            memory.checkpoints = [c.beside(heir) for c in memory.checkpoints if c.has(heir)]
            memory.gauge = heir

    def _part(self, active_users: list[int]) -> None:
        """Those who were known and to whom no chain of ranges leads any more: they are looked for when they return."""
        gone = [
            u for u, state in self.memory.states.items() if state is not State.DISCONNECTED and u not in active_users
        ]
        if (
            self.memory.gauge != self.memory.reference
            and self.memory.reference not in self.memory.states
            and self.memory.reference not in active_users
        ):
            gone.append(self.memory.reference)
        for u in gone:
            self.memory.states[u] = State.DISCONNECTED
            self.memory.known.discard(u)
            for times in (self.memory.since, self.memory.steady, self.memory.registered):
                times.pop(u, None)
            self._untold.append(f"{self.users[u].name}: {State.DISCONNECTED}: no chain of ranges leads to it any more")

    def _told(
        self,
        begin: Checkpoint,
        stretch: Stretch,
        repaired: Recording,
        repaired_tracks: dict[str, RepairedTrack],
        minima: list[LocalOptimum],
        noise: Array,
        sure: Marginals,
    ) -> Solution:
        axes, lift = begin.axes.copy(), begin.lift.copy()
        for u, user in enumerate(self.users):
            if not user.static:
                axes[u] = multiply_quaternions(repaired_tracks[user.name].repaired_from_slam[-1], begin.axes[u])
                if not np.isnan(stretch.end[u]):
                    lift[u] = repaired_tracks[user.name].track.position[-1, 2] - stretch.last[u, 2]
        common = begin.common
        if begin.marginal_prior is None:
            best = minima[0]
            scale = float(np.exp(best.states.calibration[self.memory.gauge, SCALE]))
            common = np.append(scale * best.graph.keyframes[self.memory.gauge].anchor, 0.0)
        told = assess_calibrated(minima, self._registered(), sure)
        return Solution(begin, stretch, minima, told, common, axes, lift, noise, repaired)

    def _judge(self, active_users: list[int], now: float, before: Solution | None) -> None:
        """New states, and what changed; `before` is the solution before this one."""
        assert self.solution is not None
        self._near[active_users] = self.solution.told.progress[active_users]
        said, rejected = self.solution.told.verdicts, self._rejected(now)
        for u in active_users:
            verdict = said[u]
            if verdict is None or u == self.memory.gauge:
                continue
            state, reason = verdict.state, verdict.reason
            if u in self.memory.known and rejected[u] > self.parameters.integrity.largest_rejected:
                self.memory.known.discard(u)
                self.memory.since[u] = now
                self.memory.steady.pop(u, None)
                state, reason = State.UNOBSERVABLE, f"{rejected[u]:.0%} of its last ranges do not fit"
            elif state is not State.REGISTERED:
                self.memory.steady.pop(u, None)
            elif self.state(u) is State.REGISTERED or self._is_steady(u, rejected[u], now, before):
                since = self.memory.registered.setdefault(u, now)
                proven = u in self.memory.known or now - since >= self.parameters.integrity.proven_duration
                (self.memory.known.add if proven and self._is_single(u) else self.memory.known.discard)(u)
            else:
                self._near[u] *= _WATCHED_AT
                state, reason = State.UNOBSERVABLE, "its place is known, if it stays there: it is watched on"
            if state is not State.REGISTERED:
                self.memory.registered.pop(u, None)
            if state is not self.state(u):
                self._untold.append(f"{self.users[u].name}: {state}: {reason}")
            self.memory.states[u] = state

    def _is_steady(self, user: int, rejected: float, now: float, before: Solution | None) -> bool:
        """Whether who seems registered has ranged for long enough, and stayed in its place where ranges are late."""
        solution, last, m = self.solution, self.stream.last_pose(user), self.parameters
        assert solution is not None
        if now - self.memory.since[user] < m.integrity.least_duration:
            return False
        if rejected <= m.integrity.watched_share:
            return True
        since = self.memory.steady.setdefault(user, now)
        if last is not None and before is not None:
            here, there = (s.pose(user, last[1:4], _IDENTITY)[0] for s in (solution, before))
            turn = abs(wrap_angle(float(solution.last_poses[user, 3] - before.last_poses[user, 3])))
            if not (
                np.linalg.norm(here - there) < 0.5 * m.integrity.largest_error
                and turn < 0.5 * m.integrity.largest_yaw_error
            ):
                since = self.memory.steady[user] = now
        return now - since >= m.integrity.watched_duration

    def _is_single(self, user: int) -> bool:
        """Whether one minimum alone is left for a user: of two that are still near only searches see both part."""
        assert self.solution is not None
        told = self.solution.told
        where = np.array([places(m.frames, told.extent)[user, :, :2] for m in told.hypotheses[0].components_of(user)])
        return bool(np.linalg.norm(where - where[0], axis=2).max() < _PARTING * self.parameters.integrity.largest_error)

    def _rejected(self, now: float) -> Array:
        """(k,) the share of each user's latest ranges that are taken for late or worse."""
        assert self.solution is not None
        measurements, inlier_probability = self.solution.graph.measurements, self.solution.told.inlier_probability
        late = measurements.t > now - self.parameters.incremental.recent
        out = np.zeros(len(self.users))
        for u in range(len(self.users)):
            mine = late & ((measurements.i == u) | (measurements.j == u))
            if mine.sum() >= _SETTLED_ENOUGH:
                out[u] = float((inlier_probability[mine] < 0.5).mean())
        return out

    def _remember(self, stretch: Stretch, errors: Errors, now: float) -> None:
        """A checkpoint, and what no window can reach any more forgotten."""
        solution = self.solution
        assert solution is not None
        best = solution.minima[0]
        unknown = {u for u in best.graph.active_users if u not in self.memory.known}
        own_height = stretch.last[:, 2] + solution.lift
        marginal_prior = marginalized(best.graph, best.states, errors, own_height).without(unknown)
        marginal_prior = marginal_prior.aged(
            self.parameters.devices.clock_walk**2 * float(np.ptp(best.graph.measurements.t))
        )
        reference = moved_frames(solution.common, best.frames)[self.memory.gauge]
        reference[2] -= solution.scale(self.memory.gauge) * own_height[self.memory.gauge]
        spread = solution.covariances[self.memory.gauge, :4, :4]
        begin = np.where(np.isnan(stretch.end), self.memory.begin.begin, stretch.end)
        self.memory.checkpoints.append(
            Checkpoint(now, begin, solution.axes, solution.lift, marginal_prior, reference, spread)
        )
        if np.isfinite(self.memory.begin.t):
            self.stream.forget(self.memory.begin.begin, self.memory.begin.t - 1.0)

    # What is told

    def registration(self) -> Registration:
        """The last solution, about the users' own origins where their last poses are. ValueError before the first.

        `ranges` are those of the window, by time.
        """
        solution = self.solution
        if solution is None:
            raise ValueError("nothing was solved yet")
        verdicts = list(solution.told.verdicts)
        for u, verdict in enumerate(verdicts):
            if verdict is not None and u in self.memory.states:
                verdicts[u] = verdict._replace(state=self.memory.states[u])
            if verdict is not None and u == self.memory.gauge != self.memory.reference:
                verdicts[u] = verdict._replace(reason="the others are placed beside it")
        assessed = solution.told._replace(verdicts=verdicts, covariances=solution.covariances, joint=None)
        scale = np.array([solution.scale(u) for u in range(len(self.users))])
        turned = yaw_of_quaternions(solution.axes)
        own = OwnFrames(scale, turned, solution.stretch.last, solution.common, np.zeros(3))
        reference, count = self.users[self.memory.reference].name, len(solution.stretch.recording.ranges)
        out = registration_of(assessed, own, reference, count, {"load": 0.0, "initialise": 0.0, "solve": 0.0})
        users = {
            user.name: replace(out.users[user.name], slam_noise=(float(place), float(heading)))
            for user, (place, heading) in zip(self.users, solution.noise, strict=True)
            if not user.static and out.users[user.name].state is not State.DISCONNECTED
        }
        return replace(out, users={**out.users, **users})

    def frame(self, user: int) -> YawFrame | None:
        """`common_from_user` at the user's last pose; None where it has no placement."""
        if (
            self.solution is None
            or np.isnan(self.solution.last_poses[user, 0])
            or self.state(user) is State.DISCONNECTED
        ):
            return None
        last = self.stream.last_pose(user)
        position = np.zeros(3) if last is None else last[1:4]
        place, _ = self.solution.pose(user, position, _IDENTITY)
        yaw = wrap_angle(
            float(self.solution.last_poses[user, 3]) + float(yaw_of_quaternions(self.solution.axes[user : user + 1])[0])
        )
        scale = self.solution.scale(user)
        x, y, z = (place - YawFrame(yaw=yaw, scale=scale) @ position).tolist()
        known = self.users[user]
        return YawFrame(x, y, z, yaw, scale, "z" if known.static else known.up)


def _of(marginal_prior: MarginalPrior | None, active_users: list[int], known: set[int]) -> MarginalPrior | None:
    """What is carried of those that are there and whose places are still believed."""
    if marginal_prior is None:
        return None
    return marginal_prior.without({u for u in marginal_prior.users if u not in active_users or u not in known})


def _turned(covariances: Array, yaw: float) -> Array:
    """Covariances (k, 4, 4) of x, y, z, yaw in axes that are turned."""
    turn = np.eye(4)
    turn[:2, :2] = rotation_2d(yaw)
    return np.asarray(turn @ covariances @ turn.T)
