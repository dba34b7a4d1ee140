"""Users whose places are known are followed: slots and ranges put into the graph as they come."""

from __future__ import annotations

from collections.abc import Collection, Hashable, Mapping
from typing import Any, ClassVar, NamedTuple

import numpy as np

from synchronizar._core import mixture_terms
from synchronizar.arrays import Array, Indices, Mask
from synchronizar.data.user import User
from synchronizar.estimation.incremental.innovations import Innovations
from synchronizar.estimation.incremental.kept import kept, restore_kept
from synchronizar.estimation.incremental.range_weighing import RangeWeighing
from synchronizar.estimation.incremental.seen_drift import SeenDrift
from synchronizar.estimation.incremental.slot_ranges import (
    DISTANCE,
    NLOS_ODDS,
    ODDS,
    SERIAL,
    SIGMA,
    SLOT,
    USER_I,
    USER_J,
    WEIGHT,
    SlotRanges,
    T,
    block_of,
)
from synchronizar.estimation.incremental.slot_states import SlotStates
from synchronizar.graph.follower import Follower, SlotState
from synchronizar.graph.priors import (
    calibration_sigmas,
    height_sigma_of,
    known_bias_sigmas,
    known_biases,
    nlos_mixture,
    survey_of,
    survey_sigmas,
)
from synchronizar.graph.slot_factors import (
    Joining,
    SlamStep,
    SlotFactor,
    calibration_walk_factor,
    height_prior,
    joining_prior,
    place_prior,
    ranges_factor,
    step_factor,
)
from synchronizar.graph.states import BIAS
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.pose_stream import PoseStream
from synchronizar.preprocessing.repaired_poses import ends_of_ranges

_LATE = 1.0  # s: a range whose poses have not come by then is not usable
_JUDGED = 10  # slots whose ranges are judged anew once a slot, ...
_BURST_SLOTS = 2  # ... and at each update: what came just before tells most of whether a line of sight is blocked
_LINEARISED_AFTER = 0.45  # s after a slot's begin: what is done once a slot is not all done at once
_STEPS = 5  # Gauss-Newton steps of a graph that is built anew, one an update
_MOST_OPENED = 30  # slots at once: who was away for longer than that is not followed any more
_FAR_OFF = 3.0  # sigmas of clocks when people come: what is more has been seen to run off
_CLOCK_STEP = 0.02  # s, at most: how far the clock that a track is read by follows its estimate in a slot
_EXACT = 1e-3  # m and rad: 1 sigma of where the one is held who begins the common frame
_BELIEVED = 0.1  # of the weight of a surveyed place: one that weighs less is where its ranges have it
_NO_LEVEL = 1e3  # m: a survey's places tell nothing of the others' mean height
_STATIC = 1e-3  # m and rad: 1 sigma of a static radio's steps; less is as good as nothing, and hard to compute with
_SOMEWHERE = 10.0  # m, 1 sigma of the prior of who joins; a search has it to within a metre
_MOST_EXACT = 4.0  # times the weight that its sigma gives a range
_MOST_ANTENNAS = 1024  # of a user, in the number of a link


class Tracked(NamedTuple):
    """A user now: at the begin of its newest slot."""

    slot: int
    stamp: float
    """s, its own clock."""
    place: Array
    """(3,) SLAM units: where its repaired SLAM has it then."""
    state: Array
    """(7,) x, y (m), yaw (rad), height (m), log scale, radio bias (m), clock offset (s) minus the assumed one."""


class JoiningUser(NamedTuple):
    """A user as a search found it, at m slots of the window."""

    slots: list[int]
    stamps: Array
    """(m,) s, its own clock: the slots' begins."""
    places: Array
    """(m, 3) SLAM units: where its repaired SLAM has it then."""
    states: Array
    """(m, 7) as in `Tracked`; the clock counts from `clock`."""
    clock: float
    """s: its clock offset."""
    height_weight: float = 1.0
    """Of the prior of its height."""
    calibration_prior: Array | None = None
    """(3,) 1 sigma of that of its calibration about what all share, where a search has measured it."""


class NewRanges(NamedTuple):
    """n ranges as they came; i < j."""

    t: Array
    i: Indices
    j: Indices
    distance: Array
    sigma: Array
    nlos_odds: Array
    antenna_i: Indices
    antenna_j: Indices
    serial: Indices

    def part(self, which: Mask) -> NewRanges:
        """Those selected by a mask."""
        columns: Any = self
        return NewRanges(*(column[which] for column in columns))


class Tracking:
    """The users who are followed, their slots and ranges, and the graph over these."""

    KEPT: ClassVar[tuple[str, ...]] = (
        *(
            "assumed_clock",
            "read_clock",
            "noise",
            "height_spread",
            "height_weight",
            "calibration_prior",
            "members",
            "origin",
            "_waiting",
            "_judged_at",
        ),
        *("_linearised_at", "_unsettled", "_untaken", "_steps", "_priors", "_held", "_given"),
    )

    def __init__(self, users: tuple[User, ...], streams: list[PoseStream | None], parameters: Parameters) -> None:
        """`streams` of all k users; None for static radios."""
        self.users, self.streams, self.parameters = users, streams, parameters
        self.follower = Follower()
        self.ranges = SlotRanges()
        self.assumed_clock = np.zeros(len(users))
        """(k,) s: the clock offsets that those of the graph's states count from."""
        self.read_clock = np.zeros(len(users))
        """(k,) s: the clock offsets that tracks are read by. A clock runs off for hours, and a range is read by a
        straight line about this one: it follows the estimate."""
        self.noise = np.ones((len(users), 2))
        self.drift = SeenDrift(len(users), parameters.slam)
        self.height_weight = np.ones(len(users))
        """(k,): of the prior of each user's height, by the search that it joined with."""
        self.calibration_prior = np.tile(calibration_sigmas(parameters)[0], (len(users), 1))
        """(k, 3) 1 sigma of each user's calibration about what all share: as usual, or wider by that search."""
        self.height_spread = np.zeros(len(users))
        """(k,) m^2: mean square of how far each user's other possible heights lie from where it is followed."""
        self.members: dict[int, Tracked] = {}
        self.origin = np.nan
        """s, range clock: when slot 0 begins."""
        self._loss = nlos_mixture(parameters)
        self._levers = _levers(users)
        self._survey, self._biases = _survey(users), known_biases(users)
        self._waiting: NewRanges | None = None
        self.slots = SlotStates(len(users))
        self.weighing = RangeWeighing(parameters)
        self._judged_at = self._linearised_at = -1
        self._unsettled = 0
        self._untaken: list[Array] = []
        # What factors are made of, for them to be made again.
        self._steps: dict[tuple[int, int], tuple[int, SlamStep]] = {}
        self._priors: dict[Hashable, tuple[list[Joining], list[Joining]]] = {}
        self._held: dict[tuple[int, int], tuple[Array, float]] = {}
        self._given: dict[int, Array] = {}

    def slot_of(self, t: float) -> int:
        """The slot in which a range at `t` (s) lies."""
        return int(np.floor((t - self.origin) / self.parameters.slam.keyframe_interval))

    def begin_of(self, slot: int) -> float:
        """s, range clock."""
        return self.origin + slot * self.parameters.slam.keyframe_interval

    def run_off(self, clock: float) -> float:
        """s: by how much more a clock is off than those of people who come: priors are about this."""
        devices = self.parameters.devices
        most = _FAR_OFF * float(np.hypot(devices.clock_sigma, devices.clock_common_sigma))
        return clock - min(max(clock, -most), most)

    # Slots

    def _place(self, user: int, stamp: float) -> Array | None:
        """(3,) where SLAM has a device at its own stamp; None where that is not known (yet)."""
        stream = self.streams[user]
        if stream is None:
            return np.zeros(3)
        poses = stream.at(np.array([stamp]))
        return poses.position[0] if poses.valid[0] else None

    def _open(self, user: int, slot: int) -> bool:
        """A further slot of a member, placed where SLAM's step leads; False where its pose is not known yet."""
        before = self.members[user]
        stamp = self.begin_of(slot) + float(self.read_clock[user])
        place = self._place(user, stamp)
        if place is None:
            return False
        state = before.state.copy()
        scale = float(np.exp(state[4]))
        dx, dy, dz = (scale * (place - before.place)).tolist()
        c, s = np.cos(state[2]), np.sin(state[2])
        state[:2] += c * dx - s * dy, s * dx + c * dy
        state[3] += dz
        self._insert(user, slot, stamp, place, state)
        self._tie(user, before, self.members[user])
        if self.streams[user] is not None:
            metres, _, radians = self._steps[user, slot][1].sigma
            self.drift.open(user, (before.slot, before.state), (slot, state), (metres, radians))
        if self.is_surveyed(user):
            self._hold(user, slot)
        return True

    def _insert(self, user: int, slot: int, stamp: float, place: Array, state: Array) -> None:
        self.members[user] = Tracked(slot, stamp, place, state)
        self.slots.add(user, slot, stamp, place, state)
        self.follower.insert(user, slot, SlotState((state[0], state[1], state[2]), float(state[3]), state[4:]))

    def _tie(self, user: int, a: Tracked, b: Tracked) -> None:
        """SLAM's step between two slots, and what the device may change in between."""
        self._steps[user, b.slot] = a.slot, self._step(user, a, b)
        for kind in ("step", "walk"):
            self.follower.put((kind, user, b.slot), self._tying(kind, user, b.slot), a.slot)

    def _tying(self, kind: str, user: int, slot: int) -> SlotFactor:
        """The factor between a slot of a user and the one before."""
        before, step = self._steps[user, slot]
        if kind == "step":
            return step_factor(user, before, slot, step, self.parameters)
        return calibration_walk_factor(user, before, slot, step.duration, self.parameters)

    def noise_of(self, users: int | Indices) -> Array:
        """(..., 2) factors on the usual drift of users' places and headings: by searches, and by what is seen since."""
        return np.asarray(np.maximum(self.noise[users], self.drift.factors[users]))

    def _step(self, user: int, a: Tracked, b: Tracked) -> SlamStep:
        slam, stream = self.parameters.slam, self.streams[user]
        duration = (b.slot - a.slot) * slam.keyframe_interval
        if stream is None:
            return SlamStep((0.0, 0.0, 0.0), (_STATIC, _STATIC, _STATIC), duration)
        travelled, rebuilt = stream.way(a.stamp, b.stamp)
        metres, radians = self.noise_of(user).tolist()
        metres *= np.sqrt(slam.drift_m_per_sqrt_s**2 * duration + slam.drift_m_per_sqrt_m**2 * travelled)
        radians *= np.sqrt(slam.drift_rad_per_sqrt_s**2 * duration + slam.drift_rad_per_sqrt_m**2 * travelled)
        if rebuilt:
            length, turn = stream.rebuilt_sigma
            length *= float(np.exp(a.state[4]))
            metres = np.hypot(metres, min(slam.jump_sigma_m, length))
            radians = np.hypot(radians, min(slam.jump_sigma_rad, turn))
        x, y, z = (b.place - a.place).tolist()
        return SlamStep((x, y, z), (float(metres), float(metres), float(radians)), duration)

    # Ranges

    def add(self, ranges: NewRanges) -> None:
        """Ranges between members, as they came."""
        ranges = ranges._replace(distance=ranges.distance - self._biases[ranges.i] - self._biases[ranges.j])
        if self._waiting is not None:
            columns: Any = zip(self._waiting, ranges, strict=True)
            ranges = NewRanges(*(np.concatenate(both) for both in columns))
        self._waiting = ranges if len(ranges.t) else None

    def advance(self, now: float, doubted: Collection[int], settle: bool = False) -> None:
        """It is `now` (s, range clock): open slots, take in the ranges whose poses have come, solve.

        Nothing is taken in of users that are `doubted`. With `settle` the graph is built anew, for somebody joined; it
        is linearised anew at each of the next updates then, until it stands. Raises RuntimeError where the graph cannot
        be solved.
        """
        latest = self.slot_of(now)
        for user, tracked in list(self.members.items()):
            if user in doubted:
                continue
            stream = self.streams[user]
            seen = latest if stream is None else self.slot_of(stream.newest - float(self.read_clock[user]))
            for slot in range(max(tracked.slot + 1, latest - _MOST_OPENED), min(latest, seen) + 1):
                self._open(user, slot)
        taken = self._take(now, doubted)
        turns = latest > self._judged_at
        if settle:  # a search has all near their best already, so that they can be judged before they are solved for
            self.judge(-1, weigh=True)
            for slot in taken:
                self._put(slot)
            taken = []
            self.follower.rebuild()
            self._unsettled = _STEPS
        elif turns:
            self._judged_at = latest
            self._refresh()
            self._read_by_estimates()
            self.judge(latest - _JUDGED, weigh=True)
        elif taken:
            self.judge(latest - _BURST_SLOTS, weigh=False)
        for slot in taken:
            self._put(slot)
        if self._unsettled:
            self._unsettled -= 1
            if not settle:
                self.follower.update()
            self._refresh()
        else:
            slot = self.slot_of(now - _LINEARISED_AFTER)
            if slot > self._linearised_at:
                self._linearised_at = slot
                self.follower.linearize_by_turns()
            else:
                self.follower.update(slice(-_BURST_SLOTS - 1, None))
            self._read([(user, tracked.slot) for user, tracked in self.members.items()])

    def _read_by_estimates(self) -> None:
        """The clocks that tracks are read by, nearer to their estimates."""
        for user, tracked in self.members.items():
            if self.streams[user] is None:
                continue
            off = self.assumed_clock[user] + tracked.state[6] - self.read_clock[user]
            self.read_clock[user] += min(max(off, -_CLOCK_STEP), _CLOCK_STEP)

    def _read(self, at: list[tuple[int, int]]) -> None:
        """The estimates of users at slots."""
        states = self.follower.states(at)
        self.slots.change(at, states)
        for (user, slot), state in zip(at, states, strict=True):
            if slot == self.members[user].slot:
                self.members[user] = self.members[user]._replace(state=state)

    def _take(self, now: float, doubted: Collection[int]) -> list[int]:
        """Read the ranges whose poses have come; the slots that they are in."""
        waiting = self._waiting
        if waiting is None:
            return []
        slot = np.floor((waiting.t - self.origin) / self.parameters.slam.keyframe_interval).astype(np.int32)
        users = np.stack([waiting.i, waiting.j], axis=1)
        there = np.asarray(self.slots.have(users, slot[:, None]).all(axis=1))
        for user in doubted:
            there &= (users != user).all(axis=1)
        antennas = np.stack([waiting.antenna_i, waiting.antenna_j], axis=1)
        longest = self.parameters.slam.longest_pose_gap
        ends, there = ends_of_ranges(
            self.streams, self.read_clock, waiting.t, users, self._levers[users, antennas], there, longest
        )
        left = ~there & ~(waiting.t < now - _LATE)
        self._waiting = waiting.part(left) if left.any() else None
        if not there.any():
            return []
        ready, users, slot, ends = waiting.part(there), users[there], slot[there], ends[there]
        ahead = (self.read_clock - self.assumed_clock)[users][:, :, None]
        ends[:, :, 0] -= ahead * ends[:, :, 2]  # where the line about the read clock is at the assumed one
        ends[:, :, 0] -= self.slots.places(users, slot[:, None])
        links = (ready.antenna_i + 1) * _MOST_ANTENNAS + ready.antenna_j + 1
        sigma = np.hypot(ready.sigma, self.parameters.ranges.multipath_sigma)
        weight = [self.weighing.weight_of(i, j) for i, j in users.tolist()]
        known = (ready.t, users, ready.distance, sigma, ready.nlos_odds, links, slot, ready.nlos_odds, weight)
        self.ranges.add(np.column_stack([*known, ready.serial, ends.reshape(len(ends), -1)]))
        added = self.ranges.rows[-len(slot) :]
        away, bias, _ = self.slots.apart(added)
        columns = added[:, [T, USER_I, USER_J, SIGMA, ODDS, WEIGHT, DISTANCE]]
        columns[:, -1] -= bias
        self._untaken.append(np.hstack([columns, away]))
        return sorted(set(slot.tolist()))

    def _put(self, slot: int) -> None:
        """The factor of a slot's ranges, made anew."""
        which = self.ranges.of_slot(slot)
        name = ("ranges", slot)
        if not len(which):
            if name in self.follower:
                self.follower.drop(name)
            return
        rows = self.ranges.rows[which]
        self._given[slot] = rows[:, [NLOS_ODDS, WEIGHT]]
        self.follower.put(name, self._ranging(slot, rows), slot)

    def _ranging(self, slot: int, rows: Array) -> SlotFactor:
        """The factor of ranges (n, columns) of a slot."""
        users, block = block_of(rows)
        return ranges_factor(slot, users, block, self._loss, np.zeros(len(block.pairs)))

    def take_innovations(self, spread: Mapping[int, float]) -> Innovations:
        """The residuals of ranges before they were used, since the last call.

        `spread` is 1 sigma (m) of each user's place, which adds to what is expected.
        """
        if not self._untaken:
            return Innovations.none()
        rows, self._untaken = np.concatenate(self._untaken), []
        users, sigma, nlos_odds, weight, distance, away = rows[:, 1:3], *rows[:, 3:7].T, rows[:, 7:]
        of_users = np.array([spread.get(u, 0.0) for u in range(len(self.users))]) ** 2
        places = of_users[users.astype(np.int32)].sum(axis=1)
        whitened = (np.sqrt((away * away).sum(axis=1)) - distance) / np.sqrt(sigma**2 + places)
        # A pair whose ranges are worth more than their sigma says is that much more exact.
        exact = np.sqrt(sigma**2 / np.minimum(np.maximum(weight, 1.0), _MOST_EXACT) + places)
        of_each = [whitened, *away.T, distance, exact, nlos_odds, np.minimum(weight, 1.0)]
        return Innovations(np.column_stack([rows[:, :3], *of_each]))

    def rejected(self, since: float) -> Array:
        """(k,) share of each user's ranges since then (s) that are more likely NLOS, or outliers, than inliers."""
        rows = self.ranges.rows
        rows = rows[rows[:, T] > since]
        out = np.zeros(len(self.users))
        if not len(rows):
            return out
        inlier = self.inlier_probability(rows)
        i, j = rows[:, USER_I].astype(int), rows[:, USER_J].astype(int)
        count, off = (
            np.bincount(i, weights, len(out)) + np.bincount(j, weights, len(out))
            for weights in (np.ones(len(rows)), (inlier < 0.5).astype(float))
        )
        return np.where(count >= self.parameters.integrity.share_fewest, off / np.maximum(count, 1.0), 0.0)

    def inlier_probability(self, rows: Array) -> Array:
        """(n,) of ranges (n, columns), at the present estimates."""
        sigma = rows[:, SIGMA].copy()
        odds = rows[:, NLOS_ODDS].copy()
        return np.asarray(mixture_terms(self.residuals(rows) / sigma, sigma, odds, self._loss)[2])

    def range_verdicts(self) -> tuple[Array, Array, Array]:
        """(n,) of all rows: probability of line of sight, measured minus predicted (m), information (1/m^2)."""
        rows = self.ranges.rows
        sigma, odds, residuals = rows[:, SIGMA].copy(), rows[:, NLOS_ODDS].copy(), self.residuals(rows)
        _, robust, inlier = mixture_terms(residuals / sigma, sigma, odds, self._loss)
        return inlier, -residuals, robust * rows[:, WEIGHT] / sigma**2

    def costs_of(self, user: int, serial: Indices, residuals: Array) -> tuple[Array, Array]:
        """Costs of a user's ranges that are among `serial` (n,): as it is followed, and at `residuals` (n,) m."""
        rows = self.ranges.rows
        rows = rows[(rows[:, USER_I] == user) | (rows[:, USER_J] == user)]
        _, here, there = np.intersect1d(rows[:, SERIAL].astype(int), serial, return_indices=True)
        rows = rows[here]
        sigma, odds = rows[:, SIGMA].copy(), rows[:, ODDS].copy()
        costs = [
            rows[:, WEIGHT] * mixture_terms(off / sigma, sigma, odds, self._loss)[0]
            for off in (self.residuals(rows), residuals[there])
        ]
        return costs[0], costs[1]

    def has(self, user: int, slot: int) -> bool:
        """Whether a user has a slot in the window."""
        return self.slots.has(user, slot)

    def state_at(self, user: int, slot: int) -> Array:
        """(7,) as in `Tracked`, as of the last time that the slot was looked at."""
        return self.slots.state(user, slot)

    def add_user(self, user: User) -> None:
        """One more user, who is not followed yet."""
        self.users = (*self.users, user)
        self._levers = _levers(self.users)
        self._survey, self._biases = _survey(self.users), known_biases(self.users)
        self.slots.add_user()
        self.assumed_clock, self.read_clock = np.append(self.assumed_clock, 0.0), np.append(self.read_clock, 0.0)
        self.noise = np.vstack([self.noise, [1.0, 1.0]])
        self.drift.add_user()
        self.height_spread = np.append(self.height_spread, 0.0)
        self.height_weight = np.append(self.height_weight, 1.0)
        self.calibration_prior = np.vstack([self.calibration_prior, calibration_sigmas(self.parameters)[0]])

    def use_antennas(self, users: tuple[User, ...]) -> None:
        """Antennas of the same users are elsewhere, for ranges from now on."""
        self.users, self._levers = users, _levers(users)

    def residuals(self, rows: Array) -> Array:
        """(n,) m, predicted minus measured, of ranges (n, columns), at the present estimates."""
        return self.slots.residuals(rows)

    def judge(self, first: int, weigh: bool) -> None:
        """NLOS odds of the ranges from slot `first` on, anew, and weights if `weigh` says so; what changed is put."""
        anew = self.weighing.weigh if weigh else self.weighing.judge
        for slot in anew(self.ranges, self.slots, len(self.users), first):
            self._put(slot)

    def _refresh(self) -> None:
        """All estimates of the window."""
        self._read([(user, slot) for slot, users in self.follower.slots.items() for user in users])

    # Who is in it

    def join(self, new: Mapping[int, JoiningUser], reference: int | None) -> None:
        """Follow users from now on, as a search found them; `reference` begins the common frame."""
        for user, found in new.items():
            self.assumed_clock[user] = self.read_clock[user] = found.clock
            self.height_weight[user] = found.height_weight
            usual, _ = calibration_sigmas(self.parameters)
            measured = usual if found.calibration_prior is None else found.calibration_prior
            self.calibration_prior[user] = np.maximum(usual, measured)
        for user, found in new.items():
            self._insert_all(user, found)
        first = {u: min(slot for slot, users in self.follower.slots.items() if u in users) for u in self.members}
        known = [self._joining(u, first[u]) for u in self.members if u not in new]
        joining = [self._joining(u, first[u]) for u in new]
        name = ("prior", *sorted(new), *first.values())
        self._priors[name] = joining, known
        self.follower.put(name, self._prior_of(name), min(first.values()))
        for user, found in new.items():
            self._hold(user, first[user], exactly=user == reference)
            if self.is_surveyed(user):
                for slot in found.slots:
                    self._hold(user, slot)

    def _prior_of(self, name: Hashable) -> SlotFactor:
        """The factor of some who joined."""
        _, shared = calibration_sigmas(self.parameters)
        joining, known = self._priors[name]
        return joining_prior(joining, known, shared)

    def is_surveyed(self, user: int) -> bool:
        """Whether a user is held where it was surveyed to be: the origin, and radios whose entry is believed."""
        return bool(np.isfinite(self._survey[user, 0]) and self.height_weight[user] > _BELIEVED)

    def _hold(self, user: int, slot: int, exactly: bool = False) -> None:
        """A prior on the place at a slot: exactly that of the one who begins the common frame, or a surveyed one.

        Others have a wide one at their first slot.
        """
        at, sigma = self.slots.state(user, slot)[:4], _EXACT if exactly else _SOMEWHERE
        if self.is_surveyed(user):
            x, y, z = self._survey[user].tolist()
            at = np.array([x, y, float(at[2]), z])
            of_entry = float(survey_sigmas([self.users[user]], self.parameters)[0] / np.sqrt(self.height_weight[user]))
            sigma = _EXACT if self.users[user].is_survey_origin else of_entry
        self._held[user, slot] = at, sigma
        for kind in ("place", "height") if sigma < _SOMEWHERE else ("place",):
            self.follower.put((kind, user, slot), self._holding(kind, user, slot), slot)

    def _holding(self, kind: str, user: int, slot: int) -> SlotFactor:
        """The factor that holds a user's place, or height."""
        at, sigma = self._held[user, slot]
        x, y, yaw, height = at.tolist()
        if kind == "height":
            return height_prior(user, slot, height, sigma)
        heading = _EXACT if sigma == _EXACT else self.parameters.priors.yaw_sigma
        return place_prior(user, slot, (x, y, yaw), (sigma, sigma, heading))

    def _joining(self, user: int, slot: int) -> Joining:
        own = self.calibration_prior[user].copy()
        height = float(self.slots.place(user, slot)[2])
        sigma = height_sigma_of(self.users[user], self.parameters) / np.sqrt(2.0 * self.height_weight[user])
        if np.isfinite(self._survey[user, 0]):
            sigma = _NO_LEVEL
        own[BIAS] = 1.0 / np.hypot(1.0 / own[BIAS], 1.0 / known_bias_sigmas([self.users[user]], self.parameters)[0])
        clock = float(self.assumed_clock[user])
        return Joining(user, slot, height, clock - self.run_off(clock), sigma, own)

    def _insert_all(self, user: int, found: JoiningUser) -> None:
        """The slots of a user who joins, from its first in the window on."""
        before: Tracked | None = None
        columns = (found.slots, found.stamps.tolist(), found.places, found.states)
        for slot, stamp, place, state in zip(*columns, strict=True):
            self._insert(user, slot, stamp, place, state)
            if before is not None:
                self._tie(user, before, self.members[user])
            before = self.members[user]

    def leave(self, user: int) -> None:
        """Follow a user no more: what its ranges told is forgotten, as far back as the window goes."""
        rows = self.ranges.rows
        touched = (rows[:, USER_I] == user) | (rows[:, USER_J] == user)
        slots = np.unique(rows[touched, SLOT]).astype(int).tolist()
        self.ranges.keep(~touched)
        for slot in slots:
            self._put(slot)
        self.members.pop(user)
        self.height_spread[user] = 0.0
        if any(sigma == _EXACT for (u, _), (_, sigma) in self._held.items() if u == user):
            # It was the one that all were beside: from now on that is who is there longest.
            slot, left = next((n, us) for n, us in self.follower.slots.items() if any(u != user for u in us))
            self._hold(next(u for u in left if u != user), slot, exactly=True)
        self.follower.drop_user(user)
        self.slots.drop(user)
        self._forget_made()

    def moved(self) -> float:
        """m: how far the graph's estimates lie from where members were told to be last, at most, in the plane."""
        states = self.follower.states([(user, tracked.slot) for user, tracked in self.members.items()])
        told = np.array([tracked.state for tracked in self.members.values()])
        return float(np.hypot(*(states - told)[:, :2].T).max())

    def forget(self, before: int) -> list[int]:
        """Slots before `before` are marginalised out; returns users who had no later one: they are followed no more."""
        self.follower.marginalize(before)
        self.ranges.keep(self.ranges.rows[:, SLOT] >= before)
        self.slots.forget(before)
        self._forget_made()
        gone = [u for u, tracked in self.members.items() if tracked.slot < before]
        for user in gone:
            del self.members[user]
        return gone

    def _forget_made(self) -> None:
        """What factors were made of that are no more."""
        there = self.follower
        self._steps = {key: value for key, value in self._steps.items() if ("step", *key) in there}
        self._priors = {name: value for name, value in self._priors.items() if name in there}
        self._held = {key: value for key, value in self._held.items() if ("place", *key) in there}
        self._given = {slot: value for slot, value in self._given.items() if ("ranges", slot) in there}

    # To and from plain values

    def state(self) -> dict[str, Any]:
        """All of it but for users and streams, as `restore` takes it."""
        tables = {"ranges": self.ranges.rows.copy(), "slots": self.slots.to_table()}
        parts = {"weighing": kept(self.weighing), "drift": kept(self.drift), "follower": self.follower.to_state()}
        return kept(self) | tables | parts

    def restore(self, state: Mapping[str, Any]) -> None:
        """What `state` told of. KeyError, ValueError or RuntimeError where it does not fit together."""
        restore_kept(self, state)
        restore_kept(self.weighing, state["weighing"])
        restore_kept(self.drift, state["drift"])
        self.ranges = SlotRanges()
        self.ranges.restore(state["ranges"])
        self.slots = SlotStates(len(self.users))
        self.slots.restore(state["slots"])
        names = [name for name, _ in state["follower"].names if name not in state["follower"].linear]
        self.follower = Follower.from_state(state["follower"], {name: self._made(name) for name in names})

    def _made(self, name: Any) -> SlotFactor:
        """The factor of a name, made again."""
        kind = name[0]
        if kind == "ranges":
            rows = self.ranges.rows[self.ranges.of_slot(name[1])]
            rows[:, [NLOS_ODDS, WEIGHT]] = self._given[name[1]]
            return self._ranging(name[1], rows)
        if kind == "prior":
            return self._prior_of(name)
        return self._tying(*name) if kind in ("step", "walk") else self._holding(*name)


def _levers(users: tuple[User, ...]) -> Array:
    """(k, most, 3) m in body axes: the antennas of each user; the last is the origin, for the antenna -1."""
    most = max(len(user.levers) for user in users)
    return np.array([np.pad(user.levers, ((0, most - len(user.levers)), (0, 0))) for user in users])


def _survey(users: tuple[User, ...]) -> Array:
    """(k, 3) m: where surveyed radios are, about the survey's origin, which is at zero; NaN of all others."""
    origin = next((u for u, user in enumerate(users) if user.is_survey_origin), None)
    if origin is None:
        return np.full((len(users), 3), np.nan)
    out = survey_of(users, origin)
    out[origin] = 0.0
    return out
