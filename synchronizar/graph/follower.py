"""The graph that follows people, on gtsam's iSAM2: slots come at one end, are marginalised at the other.

The factors and variables are in slot_factors.py. Nothing in the graph lives for the whole walk, so nothing freezes at
a bad linearisation. Variables are eliminated in the order of time: the newest slot is the root, so its factor is
replaced cheaply as ranges come, and the oldest slot is a leaf, which is marginalised out into a linear factor. Each
user's own newest slot is in the root too, however old it is: so the joint covariance of all is told by the root alone.
"""

from __future__ import annotations

from collections.abc import Hashable, Iterable, Mapping, Sequence
from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import gtsam
import numpy as np
from numpy.typing import NDArray

from synchronizar.arrays import Array
from synchronizar.graph import keys
from synchronizar.graph.slot_factors import CALIBRATION_UNITS

_THRESHOLDS = {
    "x": np.array([0.02, 0.02, 0.01]),  # m, m, rad
    "h": np.array([0.05]),  # m
    "d": np.array([0.005, 0.02, 0.01]) / CALIBRATION_UNITS,  # log scale, m, s
}
"""Where an estimate is further from where it was linearised, ..."""
_ALONG = 0.5
"""... all are linearised anew that are further than so much of that: others would be so far off a moment later."""
_NUMBERS = 7  # of a user and slot
_SPANS = (slice(0, 3), slice(3, 4), slice(4, 7))  # of X, H and D among a user's seven numbers
_NEVER = 10**9  # updates: iSAM2 linearises anew when it is told to, so that the order of time can be kept
_VARIABLES = 3  # a user and slot
_ALL, _NONE = slice(None), slice(0)
_RECENT = 12  # slots
_OLDER = 2.0  # times the thresholds: how far estimates of older slots may be from where they were linearised
_CLIQUE_SLOTS = 2  # before a slot, that its cliques may hold variables of
_WHOLE = 0.5  # of all variables: gtsam orders all where it eliminates more than 0.65 of them
_DIMENSIONS = {"x": 3, "h": 1, "d": 3}
_KeyArray = NDArray[np.int64]
_Users = tuple[int, tuple[int, ...]]  # of a slot
_NO_ROWS = [np.zeros((0, of)) for of in _DIMENSIONS.values()]
_MOST_SLOTS = 4096  # whose keys are remembered


class SlotState(NamedTuple):
    """A user at a slot."""

    pose: tuple[float, float, float]
    """x, y (m), yaw (rad) in the common frame."""
    height: float
    """m, of the device in the common frame."""
    calibration: Array
    """(3,) log scale, radio bias (m), clock offset (s) minus the assumed one."""


class LinearRows(NamedTuple):
    """A linear factor: rows times the tangents at a point."""

    keys: list[int]
    rows: Array
    """(m, n + 1): columns of each variable in turn, then the right side."""
    point: Array
    """Of each variable in turn, where its tangents are taken: x, y, yaw of a pose."""


class FollowerState(NamedTuple):
    """All that a `Follower` needs to go on as it would have, but for the factors that are known from elsewhere."""

    slots: dict[int, list[int]]
    point: list[tuple[_KeyArray, Array]]
    """Keys, and their values one after the other: where the tree is linearised; then of what no update has seen yet."""
    names: list[tuple[Hashable, bool]]
    """Of all factors, and whether the tree has them already."""
    linear: dict[Hashable, LinearRows]
    """Those of the factors that are linear, ..."""
    dropped: list[LinearRows]
    """... and those that the next update takes out."""
    fixed: list[int]
    touched: int | None
    left: int


class _Placed(NamedTuple):
    """A factor and its position in the tree; None before the next update."""

    factor: gtsam.NonlinearFactor
    position: int | None
    point: dict[int, Array] | None = None
    """Where it was linearised, if it is linear."""


class _Tie(NamedTuple):
    """The name of what ties a slot to the next."""

    slot: int


class _Pair(NamedTuple):
    """Users of a slot, and of the next one."""

    users: tuple[int, ...]
    after: int
    others: tuple[int, ...]


class Follower:
    """A graph whose factors have names, and its iSAM2 tree."""

    def __init__(self) -> None:
        self._factors: dict[Hashable, _Placed] = {}
        self._new: dict[Hashable, None] = {}
        self._dropped: list[int] = []
        self._inserted = gtsam.Values()
        self._slots: dict[int, list[int]] = {}
        self._newest: dict[int, int] = {}  # slot of each user
        self._touched: int | None = None
        self._left = 0  # users who were taken out, ever
        self._fixed: set[int] = set()  # variables that a marginal ties: they stay linearised where they are
        self._tied: dict[int, _Pair] = {}
        self._are_tied = True
        self._ordered: tuple[tuple[list[_Users], dict[int, int]], gtsam.KeyGroupMap] | None = None
        self._tree, self._at = _tree()

    # What is in it

    @property
    def slots(self) -> dict[int, list[int]]:
        """The users of each slot, slots by time."""
        return self._slots

    def __contains__(self, name: Hashable) -> bool:
        return name in self._factors

    def names(self) -> Iterable[Hashable]:
        """Of all factors that were put."""
        return (name for name in self._factors if not isinstance(name, _Tie))

    def insert(self, user: int, slot: int, state: SlotState) -> None:
        """A new user of a slot, where the next update begins. Factors must follow before that."""
        if slot not in self._slots and slot < next(reversed(self._slots), slot):
            self._slots = dict(sorted([*self._slots.items(), (slot, [])]))
        self._slots.setdefault(slot, []).append(user)
        self._are_tied = False
        self._newest[user] = max(slot, self._newest.get(user, slot))
        self._inserted.insert(keys.slot_pose(user, slot), gtsam.Pose2(*state.pose))
        self._inserted.insert(keys.slot_height(user, slot), state.height)
        self._inserted.insert(keys.slot_calibration(user, slot), state.calibration / CALIBRATION_UNITS)

    def put(self, name: Hashable, factor: gtsam.NonlinearFactor, slot: int) -> None:
        """A factor, instead of the one of the same name; `slot` is the earliest that it touches."""
        placed = self._factors.get(name)
        if placed is not None and placed.position is not None:
            self._dropped.append(placed.position)
        self._factors[name] = _Placed(factor, None)
        self._new[name] = None
        self._touched = slot if self._touched is None else min(self._touched, slot)

    # Solving

    def update(self, among: slice = _ALL) -> None:
        """Take in what was put since the last update, and solve.

        Only estimates of these slots, `among` all, are linearised anew where they need it. Raises RuntimeError where a
        variable is seen by no factor.
        """
        self._tie()
        stale = self._stale(among)
        first = min((s for s in (stale, self._touched) if s is not None), default=None)
        if first is None:
            return
        slots = list(self._slots)
        at, ordered = self._affected(slots, first)
        graph = gtsam.NonlinearFactorGraph()
        names = list(self._new)
        for name in names:
            graph.push_back(self._factors[name].factor)
        params = gtsam.ISAM2UpdateParams()
        params.removeFactorIndices = self._dropped
        params.force_relinearize = stale is not None
        touched = self._keys_of(slots[at:])
        if self._inserted.size():
            touched = [key for key in touched if not self._inserted.exists(key)]
        params.constrainedKeys, params.extraReelimKeys = self._groups(slots[ordered:]), _key_list(touched)
        waiting = [] if stale is None else self._keys_of(sorted(set(slots).difference(slots[among])))
        params.noRelinKeys = _key_list({*self._fixed, *waiting})
        try:
            result = self._tree.update(graph, self._inserted, params)
        except IndexError as error:  # gtsam looks for the variable's factors
            raise RuntimeError("a variable is seen by no factor") from error
        for name, index in zip(names, result.getNewFactorsIndices(), strict=True):
            self._factors[name] = self._factors[name]._replace(position=index)
        self._new, self._dropped, self._inserted, self._touched = {}, [], gtsam.Values(), None
        self._at = self._tree.getLinearizationPoint()

    def _tie(self) -> None:
        """Factors that say nothing, between all of each slot and all of the next: so a slot is one clique of the tree.

        Steps tie each user to itself. Eliminated one after the other, users would be a clique each, and each clique
        keeps what it tells all others, which is as large as that of all together.
        """
        if self._are_tied:
            return
        self._are_tied = True
        for (slot, users), (after, others) in pairwise(self._slots.items()):
            pair = _Pair(tuple(users), after, tuple(others))
            if self._tied.get(slot) != pair:
                self._tied[slot] = pair
                self.put(_Tie(slot), _tying(slot, pair), slot)

    def _keys_of(self, slots: Iterable[int]) -> list[int]:
        """All variables of slots."""
        return [key for slot in slots for key in _keys(tuple(self._slots[slot]), slot)]

    def linearize_by_turns(self) -> None:
        """Take in what was put, and solve: estimates that need it are linearised anew, seldom those of the older slots.

        What slots that are long past tell of now depends little on where they are linearised; but all that came after
        them has to be eliminated anew with them, and where that is most of the tree, gtsam linearises it all.
        """
        recent = slice(-_RECENT, None)
        self.update(_ALL if self._stale(slice(-_RECENT), _OLDER) is not None else recent)

    def _affected(self, slots: list[int], first: int) -> tuple[int, int]:
        """From which of `slots` on all is eliminated anew where `first` is touched, and from which on it is ordered.

        Cliques hold variables of slots before the first one too. Where most of the tree is touched, gtsam orders all.
        And it takes no more groups than there are variables to eliminate: some slots more are, where it takes that.
        """
        users = [len(self._slots[slot]) for slot in slots]
        at = slots.index(first) if first in self._slots else 0
        ordered = max(at - _CLIQUE_SLOTS, 0)
        if sum(users[ordered:]) > _WHOLE * sum(users):
            ordered = 0
        while at > 0 and _VARIABLES * sum(users[at:]) <= len(slots) - ordered + 1:
            at -= 1
        return at, min(ordered, at)

    def _groups(self, slots: Sequence[int]) -> gtsam.KeyGroupMap:
        """The variables of slots, by the order of these; what stands in no group comes first.

        Everybody's newest ones come last: they are the root.
        """
        present = [(slot, tuple(self._slots[slot])) for slot in slots]
        if self._ordered is None or self._ordered[0] != (present, self._newest):
            self._ordered = (present, self._newest.copy()), _by_time(present, self._newest)
        return self._ordered[1]

    def _stale(self, among: slice = _ALL, beyond: float = 1.0) -> int | None:
        """The first slot, among these, from which on estimates are to be linearised anew; None: all are near enough.

        `beyond`: how many times the thresholds is too far.
        """
        if not self._at.size():
            return None
        at = [(user, slot) for slot, users in list(self._slots.items())[among] for user in users]
        if self._inserted.size():
            at = [(user, slot) for user, slot in at if not self._inserted.exists(keys.slot_pose(user, slot))]
        wanted = [key for user, slot in at for key in _keys((user,), slot)]
        if not wanted:
            return None
        off = np.abs(self._tree.getDelta().vector(wanted)).reshape(-1, _NUMBERS) / np.concatenate(
            list(_THRESHOLDS.values())
        )
        if not self._moved(at, off, beyond):
            return None
        return min(slot for _, slot in self._moved(at, off, _ALONG))

    def _moved(self, at: Sequence[tuple[int, int]], off: Array, beyond: float) -> list[tuple[int, int]]:
        """The users and slots that have a variable which is `off` (n, 7) by more than that, and may be moved."""
        far = off > beyond
        return [
            at[row]
            for row in np.flatnonzero(far.any(axis=1)).tolist()
            if any(
                far[row, span].any() and key not in self._fixed
                for key, span in zip(_keys(at[row][:1], at[row][1]), _SPANS, strict=True)
            )
        ]

    def rebuild(self) -> None:
        """The tree made anew of all factors, linearised at the present estimates, and solved."""
        self._build(self.estimates())

    def _build(self, values: gtsam.Values) -> None:
        self._tree, self._at = _tree()
        self._inserted, self._dropped, self._fixed = values, [], set()
        self._factors = {name: placed._replace(position=None) for name, placed in self._factors.items()}
        self._new = dict.fromkeys(self._factors)
        self._touched = next(iter(self._slots), None)
        self.update()

    def estimates(self) -> gtsam.Values:
        """Of all variables, those included that no update has seen yet."""
        values = self._tree.calculateEstimate()
        values.insert(self._inserted)
        return values

    def drop(self, name: Hashable) -> None:
        """Take a factor out."""
        placed = self._factors.pop(name)
        self._new.pop(name, None)
        if placed.position is not None:
            self._dropped.append(placed.position)

    def drop_user(self, user: int) -> None:
        """Take a user's variables out; its ranges must be gone already, its priors are marginalised. Then `rebuild`."""
        own = {key for slot, users in self._slots.items() if user in users for key in _keys((user,), slot)}
        for slot in self._tied:
            self.drop(_Tie(slot))
        self._tied.clear()
        self._are_tied = False
        values = self.estimates()
        linear = gtsam.GaussianFactorGraph()
        for name, (factor, _, _) in list(self._factors.items()):
            touched = own.intersection(factor.keys())
            if not touched:
                continue
            if len(touched) < factor.size():  # it tells of others too
                linear.push_back(factor.linearize(values))
            self.drop(name)
        self._left += 1
        present = linear.keys()
        gone = [key for key in sorted(own) if present.count(key)]
        if gone:
            _, left = linear.eliminatePartialSequential(keys.ordering(gone))
            for n in range(left.size()):
                if left.at(n) is not None and left.at(n).size():
                    name = ("marginal", "of", self._left, n)
                    self._factors[name] = _linear(left.at(n), values, None)
                    self._new[name] = None
        for key in own:
            values.erase(key)
        self._slots = {slot: [u for u in users if u != user] for slot, users in self._slots.items()}
        self._slots = {slot: users for slot, users in self._slots.items() if users}
        self._newest.pop(user, None)
        self._build(values)

    def marginalize(self, before: int) -> None:
        """Leave out the slots before `before`; what they tell stays as linear factors on the later ones."""
        leaves = [slot for slot in self._slots if slot < before]
        if not leaves:
            return
        # They stay linearised where they are, and so do those after them that they tie.
        leaving = slice(len(leaves) + 1)
        gone = [user for user, slot in self._newest.items() if slot < before]
        for user in gone:  # its variables are the root's no more
            self._newest.pop(user)
            self._touched = leaves[0]
        self.update(_ALL if self._stale(leaving, _OLDER) is not None else _NONE)
        marginal = self._keys_of(leaves)
        left, deleted = self._tree.marginalizeLeavesWithIndices(_key_list(marginal))
        taken = set(deleted)
        self._factors = {name: placed for name, placed in self._factors.items() if placed.position not in taken}
        graph, self._at = self._tree.getFactorsUnsafe(), self._tree.getLinearizationPoint()
        for index in left:
            # gtsam's own does not know where it was linearised, and would be wrong in a tree that is built anew.
            placed = _linear(graph.at(index).linearize(self._at), self._at, index)
            self._factors["marginal", before, index] = placed
            self._fixed.update(placed.factor.keys())
        for slot in leaves:
            del self._slots[slot]
            self._tied.pop(slot, None)
        self._fixed.difference_update(marginal)

    # What it tells

    def states(self, at: Sequence[tuple[int, int]]) -> Array:
        """(n, 7) x, y, yaw, height, log scale, radio bias, clock offset of users at slots."""
        out = np.empty((len(at), _NUMBERS))
        known = list(range(len(at)))
        if self._inserted.size():  # they are where they begin
            for n in [n for n in known if self._inserted.exists(keys.slot_pose(*at[n]))]:
                out[n] = np.concatenate([_value(self._inserted, key) for key in _keys((at[n][0],), at[n][1])])
                known.remove(n)
        known.sort(key=lambda n: at[n][::-1])  # gtsam lists values by key, which is by slot and user
        listed = [_keys((user,), slot) for user, slot in map(at.__getitem__, known)]
        if listed:
            values = self._tree.calculateEstimate([key for of_one in listed for key in of_one])
            out[known, :3] = gtsam.utilities.extractPose2(values)
            out[known, 3] = [values.atDouble(height) for _, height, _ in listed]
            out[known, 4:] = gtsam.utilities.extractVectors(values, "d")
        out[:, 4:] *= CALIBRATION_UNITS
        return out

    def covariance(self, at: Iterable[tuple[int, int]]) -> Array:
        """(7 k, 7 k) joint covariance of users at slots: tangents of X, H and D of each (user, slot) in turn.

        Raises RuntimeError where the graph does not determine them.
        """
        wanted = [key for user, slot in at for key in _keys((user,), slot)]
        units = np.tile(np.concatenate([np.ones(4), CALIBRATION_UNITS]), len(wanted) // 3)
        return np.asarray(units[:, None] * self._tree.jointMarginalCovariance(wanted).fullMatrix() * units)

    # To and from plain arrays

    def to_state(self) -> FollowerState:
        """All of it but for the factors that are not linear, which `from_state` is given again."""
        graph, at = self._tree.getFactorsUnsafe(), self._tree.getLinearizationPoint()
        linear = {name: _rows(factor, point) for name, (factor, _, point) in self._factors.items() if point is not None}
        dropped = [graph.at(index) for index in self._dropped]
        point = []
        for values in (at, self._inserted):
            listed = list(values.keys())
            numbers: Array = np.concatenate([np.zeros(0), *(_value(values, key) for key in listed)])
            point.append((np.array(listed, dtype=np.int64), numbers))
        return FollowerState(
            {slot: list(users) for slot, users in self._slots.items()},
            point,
            [(name, self._factors[name].position is not None) for name in self.names()],
            linear,
            [_rows(factor, {key: _value(at, key) for key in factor.keys()}) for factor in dropped],  # noqa: SIM118
            sorted(self._fixed),
            self._touched,
            self._left,
        )

    @classmethod
    def from_state(cls, state: FollowerState, factors: Mapping[Hashable, gtsam.NonlinearFactor]) -> Follower:
        """The follower that `to_state` was called of, its tree linearised where it was.

        `factors` are those that are not linear. KeyError or RuntimeError where what is given does not fit together.
        """
        out = cls()
        out._slots = {slot: list(users) for slot, users in state.slots.items()}
        out._newest = {user: slot for slot, users in out._slots.items() for user in users}
        at, out._inserted = (_values(_by_key(*part)) for part in state.point)
        graph = gtsam.NonlinearFactorGraph()
        for rows in state.dropped:
            graph.push_back(_of_rows(rows).factor)
        out._dropped = list(range(len(state.dropped)))
        for name, is_there in state.names:
            placed = _of_rows(state.linear[name]) if name in state.linear else _Placed(factors[name], None)
            if is_there:
                placed = placed._replace(position=graph.size())
                graph.push_back(placed.factor)
            else:
                out._new[name] = None
            out._factors[name] = placed
        for (slot, users), (after, others) in pairwise(out._slots.items()):
            there = [[u for u in of if at.exists(keys.slot_pose(u, n))] for n, of in ((slot, users), (after, others))]
            if all(there):
                out._tied[slot] = pair = _Pair(tuple(there[0]), after, tuple(there[1]))
                out._factors[_Tie(slot)] = tie = _Placed(_tying(slot, pair), graph.size())
                graph.push_back(tie.factor)
        params = gtsam.ISAM2UpdateParams()
        known = [(slot, tuple(u for u in us if at.exists(keys.slot_pose(u, slot)))) for slot, us in out._slots.items()]
        params.constrainedKeys = _by_time(known, {user: slot for slot, users in known for user in users})
        if graph.size():
            out._tree.update(graph, at, params)
        out._are_tied = False
        out._fixed, out._touched, out._left = set(state.fixed), state.touched, state.left
        out._at = out._tree.getLinearizationPoint()
        return out


@lru_cache(_MOST_SLOTS)
def _keys(users: tuple[int, ...], slot: int) -> tuple[int, ...]:
    """X, H and D of each user in turn."""
    return tuple(
        key
        for u in users
        for key in (keys.slot_pose(u, slot), keys.slot_height(u, slot), keys.slot_calibration(u, slot))
    )


def _by_time(slots: Sequence[_Users], newest: Mapping[int, int]) -> gtsam.KeyGroupMap:
    """Groups of variables: slot by slot, `newest` of each user in the last one."""
    groups = gtsam.KeyGroupMap()
    for group, (slot, users) in enumerate(slots, 1):
        for key in _keys(tuple(u for u in users if newest.get(u) != slot), slot):
            groups.insert2(key, group)
    for user, slot in newest.items():
        for key in _keys((user,), slot):
            groups.insert2(key, len(slots))
    return groups


def _tying(slot: int, pair: _Pair) -> gtsam.LinearContainerFactor:
    """A factor of no rows."""
    users, after, others = pair
    x, h, d = _NO_ROWS
    # From factors of three variables each gtsam makes one of all sooner than Python can name all to it.
    of_each = gtsam.GaussianFactorGraph()
    for u, n in [*((u, slot) for u in users), *((u, after) for u in others)]:
        pose, height, device = _keys((u,), n)
        unit = gtsam.noiseModel.Unit.Create(0)
        of_each.push_back(gtsam.JacobianFactor(pose, x, height, h, device, d, np.zeros(0), unit))
    return gtsam.LinearContainerFactor(gtsam.JacobianFactor(of_each))


def _key_list(of: Iterable[int]) -> gtsam.KeyList:
    out = gtsam.KeyList()
    for key in of:
        out.push_back(key)
    return out


def _linear(factor: gtsam.GaussianFactor, values: gtsam.Values, position: int | None) -> _Placed:
    """A linear factor that knows where it was linearised."""
    point = {key: _value(values, key) for key in factor.keys()}  # noqa: SIM118
    return _Placed(gtsam.LinearContainerFactor(factor, values), position, point)


def _value(values: gtsam.Values, key: int) -> Array:
    """The value of a variable, as numbers."""
    symbol = chr(gtsam.symbolChr(key))
    if symbol == "x":
        pose = values.atPose2(key)
        return np.array([pose.x(), pose.y(), pose.theta()])
    return np.array([values.atDouble(key)]) if symbol == "h" else np.array(values.atVector(key))


def _by_key(listed: _KeyArray, numbers: Array) -> dict[int, Array]:
    """Values one after the other. ValueError where there are not as many as the keys say."""
    sizes = [_DIMENSIONS[chr(gtsam.symbolChr(key))] for key in listed.tolist()]
    if sum(sizes) != len(numbers):
        raise ValueError("so many numbers are not these variables'")
    return dict(zip(listed.tolist(), np.split(numbers, np.cumsum(sizes)[:-1]), strict=True)) if sizes else {}


def _values(of: Mapping[int, Array]) -> gtsam.Values:
    """Variables from their numbers."""
    out = gtsam.Values()
    for key, numbers in of.items():
        symbol = chr(gtsam.symbolChr(key))
        out.insert(key, gtsam.Pose2(*numbers) if symbol == "x" else float(numbers[0]) if symbol == "h" else numbers)
    return out


def _rows(factor: gtsam.NonlinearFactor, point: Mapping[int, Array]) -> LinearRows:
    """A factor linearised at a point."""
    linear = factor.linearize(_values(point))
    matrix, right = linear.jacobian()
    listed = list(linear.keys())
    return LinearRows(listed, np.column_stack([matrix, right]), np.concatenate([point[key] for key in listed]))


def _of_rows(of: LinearRows) -> _Placed:
    """A linear factor from its rows: gtsam's own takes no more than three variables from Python."""
    spans = keys.rows(of.keys)

    def error(_: gtsam.CustomFactor, __: gtsam.Values, jacobians: list[Array] | None) -> Array:
        if jacobians is not None:
            for n, span in enumerate(spans):
                jacobians[n] = of.rows[:, span].copy()
        return np.asarray(-of.rows[:, -1])

    values = _values(_by_key(np.array(of.keys, dtype=np.int64), of.point))
    custom = gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(len(of.rows)), of.keys, error)
    return _linear(custom.linearize(values), values, None)


def _tree() -> tuple[gtsam.ISAM2, gtsam.Values]:
    """An empty tree, and its linearisation point: while Python holds it, no update copies it."""
    params = gtsam.ISAM2Params()
    thresholds = gtsam.ISAM2ThresholdMap()
    for symbol, threshold in _THRESHOLDS.items():
        thresholds.insert((symbol, _ALONG * threshold))
    params.setRelinearizeThreshold(thresholds)
    params.relinearizeSkip = _NEVER
    params.findUnusedFactorSlots = True
    params.setOptimizationParams(gtsam.ISAM2GaussNewtonParams(1e-6))
    tree = gtsam.ISAM2(params)
    return tree, tree.getLinearizationPoint()
