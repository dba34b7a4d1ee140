from __future__ import annotations

import re
from collections.abc import Hashable, Iterator

import gtsam
import numpy as np
import pytest

from synchronizar._core import NlosMixture, RangeSlot
from synchronizar.arrays import Array
from synchronizar.graph import follower, keys
from synchronizar.graph.follower import Follower, SlotState
from synchronizar.graph.slot_factors import (
    CALIBRATION_UNITS,
    Joining,
    SlamStep,
    calibration_walk_factor,
    joining_prior,
    ranges_factor,
    step_factor,
)
from synchronizar.parameters import Parameters

PARAMETERS = Parameters()
LATE = NlosMixture(1.0, 0.002)
OWN, SHARED = np.array([0.03, 0.05, 0.04]), np.array([0.07, 0.03, 0.04])
Part = tuple[Hashable, gtsam.NonlinearFactor, int]


class Walk:
    """Users who walk in circles beside one another; what each slot adds to a graph."""

    def __init__(self, users: int, seed: int = 0) -> None:
        self.users, self.random = users, np.random.default_rng(seed)
        self.noise: dict[tuple[int, int], Array] = {}

    def place(self, user: int, slot: int) -> Array:
        """(3,) m, in the common frame; its own SLAM's is turned by 0.5 times its index."""
        phase = 0.3 * slot + 2.0 * user
        return np.array([3.0 * user + 2.0 * np.cos(phase), 2.0 * np.sin(phase), 1.0 + 0.3 * user + 0.2 * np.sin(slot)])

    def state(self, user: int, slot: int, off: float = 0.05) -> SlotState:
        """Near the truth."""
        x, y, z = (self.place(user, slot) + off * np.sin([user + slot, 2.0 * slot, 3.0 + slot])).tolist()
        return SlotState((x, y, 0.5 * user + 0.3 * off * np.sin(5.0 * slot)), z, np.zeros(3))

    def begin(self, slot: int = 0, users: list[int] | None = None) -> list[Part]:
        """What holds users where they begin."""
        users = list(range(self.users)) if users is None else users
        of_all = [Joining(u, slot, float(self.place(u, slot)[2]), 0.0, 0.3, OWN) for u in users]
        out: list[Part] = [(("prior", slot), joining_prior(of_all, [], SHARED), slot)]
        for u in users:
            x, y, z = self.place(u, slot).tolist()
            sigma = np.array([1e-3, 1e-3, 1e-3]) if u == 0 else np.array([1.0, 1.0, 0.5])
            noise = gtsam.noiseModel.Diagonal.Sigmas(sigma)
            pose = gtsam.PriorFactorPose2(keys.slot_pose(u, slot), gtsam.Pose2(x, y, 0.5 * u), noise)
            out.append((("place", u, slot), pose, slot))
            if u == 0:
                tight = gtsam.noiseModel.Isotropic.Sigma(1, 1e-3)
                out.append((("height", u, slot), gtsam.PriorFactorDouble(keys.slot_height(u, slot), z, tight), slot))
        return out

    def step(self, user: int, slot: int) -> list[Part]:
        """From the slot before."""
        yaw = 0.5 * user
        turn = np.array([[np.cos(yaw), np.sin(yaw), 0.0], [-np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
        dx, dy, dz = (turn @ (self.place(user, slot) - self.place(user, slot - 1))).tolist()
        moved = SlamStep((dx, dy, dz), (0.02, 0.02, 0.01), 1.0)
        return [
            (("step", user, slot), step_factor(user, slot - 1, slot, moved, PARAMETERS), slot - 1),
            (("walk", user, slot), calibration_walk_factor(user, slot - 1, slot, 1.0, PARAMETERS), slot - 1),
        ]

    def ranges(self, slot: int, users: list[int] | None = None, each: int = 3, weight: float = 0.5) -> list[Part]:
        """Between all."""
        users = list(range(self.users)) if users is None else users
        pairs = [(a, b) for a in range(len(users)) for b in range(a + 1, len(users))] * each
        if not pairs:
            return []
        i, j = (np.array(of, dtype=np.int32) for of in zip(*pairs, strict=True))
        true = [np.linalg.norm(self.place(users[a], slot) - self.place(users[b], slot)) for a, b in pairs]
        measured = np.array(true) + self.random.normal(0.0, 0.1, len(pairs))
        zero, n = np.zeros((len(pairs), 3)), len(pairs)
        own = (zero, zero, zero)
        block = RangeSlot(len(users), i, j, own, own, measured, np.full(n, 0.2), np.full(n, 0.05), np.full(n, weight))
        return [(("ranges", slot), ranges_factor(slot, users, block, LATE, np.zeros(len(block.pairs))), slot)]

    def slots(self, count: int) -> Iterator[tuple[int, list[tuple[int, SlotState]], list[Part]]]:
        """Each slot, the users that it begins for, and its factors."""
        for slot in range(count):
            parts = [part for u in range(self.users) if slot for part in self.step(u, slot)]
            parts += self.ranges(slot) + (self.begin() if slot == 0 else [])
            yield slot, [(u, self.state(u, slot)) for u in range(self.users)], parts


@pytest.fixture
def exact(monkeypatch: pytest.MonkeyPatch) -> None:
    """Everything is linearised where it is."""
    monkeypatch.setattr(follower, "_THRESHOLDS", {k: 1e-8 * v for k, v in follower._THRESHOLDS.items()})


def follow(walk: Walk, count: int, window: int | None = None) -> tuple[Follower, list[Part]]:
    """All slots one by one, as they would come."""
    out, everything = Follower(), []
    for slot, states, parts in walk.slots(count):
        for user, state in states:
            out.insert(user, slot, state)
        for part in parts:
            out.put(*part)
        everything += parts
        out.update()
        if window is not None and slot >= window:
            out.marginalize(slot - window)
    return out, everything


def settle(out: Follower) -> None:
    """Linearise anew and solve until nothing is far from where it was linearised."""
    for _ in range(50):
        out.update()


def variables(out: Follower) -> list[tuple[int, int]]:
    return [(u, slot) for slot, users in out.slots.items() for u in users]


def batch(parts: list[Part], at: list[tuple[int, SlotState]] | gtsam.Values) -> tuple[gtsam.Values, Array, list[int]]:
    """Gauss-Newton on dense normal equations until it stands; the estimates, their covariance, its keys."""
    assert isinstance(at, gtsam.Values)
    values = at
    listed = sorted(values.keys())
    spans = keys.rows(listed)
    for _ in range(30):
        graph = gtsam.GaussianFactorGraph()
        for _, factor, _ in parts:
            graph.push_back(factor.linearize(values))
        information, right = graph.hessian(keys.ordering(listed))
        step = np.linalg.solve(information, right)
        delta = gtsam.VectorValues()
        for key, span in zip(listed, spans, strict=True):
            delta.insert(key, step[span])
        values = values.retract(delta)
        if np.abs(step).max() < 1e-11:
            break
    return values, np.linalg.inv(information), listed


def start(walk: Walk, at: list[tuple[int, int]]) -> gtsam.Values:
    values = gtsam.Values()
    for user, slot in at:
        state = walk.state(user, slot)
        values.insert(keys.slot_pose(user, slot), gtsam.Pose2(*state.pose))
        values.insert(keys.slot_height(user, slot), state.height)
        values.insert(keys.slot_calibration(user, slot), state.calibration / CALIBRATION_UNITS)
    return values


def numbers_in(values: gtsam.Values, user: int, slot: int) -> Array:
    pose = values.atPose2(keys.slot_pose(user, slot))
    calibration = values.atVector(keys.slot_calibration(user, slot)) * CALIBRATION_UNITS
    return np.array([pose.x(), pose.y(), pose.theta(), values.atDouble(keys.slot_height(user, slot)), *calibration])


def assert_estimates(out: Follower, expected: gtsam.Values, within: float) -> None:
    for user, slot in variables(out):
        np.testing.assert_allclose(out.states([(user, slot)])[0], numbers_in(expected, user, slot), atol=within)


# Against the batch


@pytest.mark.usefixtures("exact")
@pytest.mark.parametrize("users", [1, 2, 3])
def test_estimates_and_joint_covariance_are_those_of_a_dense_batch(users: int) -> None:
    walk = Walk(users)
    out, parts = follow(walk, 6)
    settle(out)
    expected, covariance, listed = batch(parts, start(walk, variables(out)))
    assert_estimates(out, expected, 1e-6)
    at = [(u, slot) for slot in (5, 2) for u in range(users)]
    spans, rows = dict(zip(listed, keys.rows(listed), strict=True)), []
    for u, slot in at:
        for key in (keys.slot_pose(u, slot), keys.slot_height(u, slot), keys.slot_calibration(u, slot)):
            rows += list(range(spans[key].start, spans[key].stop))
    units = np.tile(np.concatenate([np.ones(4), CALIBRATION_UNITS]), len(at))
    joint = units[:, None] * covariance[np.ix_(rows, rows)] * units
    size = np.sqrt(np.diag(joint))
    np.testing.assert_allclose(out.covariance(at) / np.outer(size, size), joint / np.outer(size, size), atol=1e-5)


def test_what_is_not_linearised_anew_is_near_the_batch_all_the_same() -> None:
    walk = Walk(3)
    out, parts = follow(walk, 20)
    expected, _, _ = batch(parts, start(walk, variables(out)))
    for user, slot in variables(out):
        off = np.abs(out.states([(user, slot)])[0] - numbers_in(expected, user, slot))
        assert (off < [0.02, 0.02, 0.005, 0.03, 0.002, 0.005, 0.003]).all()


@pytest.mark.usefixtures("exact")
def test_a_factor_of_the_same_name_takes_the_place_of_the_one_before() -> None:
    walk = Walk(2)
    out, parts = follow(walk, 6)
    (other,) = walk.ranges(4, each=9, weight=1.0)
    out.put(*other)
    assert ("ranges", 4) in out
    out.update()
    for _ in range(5):
        settle(out)
    parts = [part for part in parts if part[0] != ("ranges", 4)] + [other]
    expected, _, _ = batch(parts, start(walk, variables(out)))
    assert_estimates(out, expected, 1e-6)


@pytest.mark.usefixtures("exact")
def test_a_factor_that_is_taken_out_tells_nothing_any_more() -> None:
    walk = Walk(2)
    out, parts = follow(walk, 6)
    out.drop(("ranges", 3))
    assert ("ranges", 3) not in out
    out.put(*next(part for part in parts if part[0] == ("ranges", 5)))
    out.update()
    for _ in range(5):
        settle(out)
    expected, _, _ = batch([part for part in parts if part[0] != ("ranges", 3)], start(walk, variables(out)))
    assert_estimates(out, expected, 1e-6)


# Who leaves, what is forgotten


def test_marginalising_the_oldest_slots_leaves_the_later_ones_as_they_were() -> None:
    out, _ = follow(Walk(3), 8)
    settle(out)
    assert out._stale() is None
    later = [at for at in variables(out) if at[1] >= 3]
    before = [out.states([at])[0] for at in later]
    covariance = out.covariance([(0, 7), (2, 4)])
    out.marginalize(3)
    assert list(out.slots) == [3, 4, 5, 6, 7]
    for at, expected in zip(later, before, strict=True):
        np.testing.assert_allclose(out.states([at])[0], expected, atol=1e-9)
    np.testing.assert_allclose(out.covariance([(0, 7), (2, 4)]), covariance, rtol=1e-6, atol=1e-12)


@pytest.mark.usefixtures("exact")
@pytest.mark.parametrize("window", [None, 4])
def test_building_the_tree_anew_changes_nothing(window: int | None) -> None:
    """Marginals too: they know where they were linearised."""
    out, _ = follow(Walk(3), 10, window)
    settle(out)
    at = variables(out)
    before, covariance = [out.states([each])[0] for each in at], out.covariance([(1, 9), (2, 8)])
    out.rebuild()
    for each, expected in zip(at, before, strict=True):
        np.testing.assert_allclose(out.states([each])[0], expected, atol=1e-3 if window else 1e-7)
    size = np.sqrt(np.diag(covariance))
    np.testing.assert_allclose((out.covariance([(1, 9), (2, 8)]) - covariance) / np.outer(size, size), 0.0, atol=1e-2)


def test_long_after_slots_were_marginalised_the_newest_are_near_the_batch_of_all() -> None:
    walk = Walk(2)
    out, parts = follow(walk, 40, window=6)
    expected, covariance, listed = batch(parts, start(walk, [(u, n) for n in range(40) for u in range(2)]))
    spans = dict(zip(listed, keys.rows(listed), strict=True))
    for user in range(2):
        span = spans[keys.slot_pose(user, 39)]
        sigma = np.sqrt(np.diag(covariance[span, span]))
        off = np.abs(out.states([(user, 39)])[0] - numbers_in(expected, user, 39))[:3]
        assert (off < 0.5 * np.linalg.norm(sigma[:2]) + 1e-3).all()


@pytest.mark.usefixtures("exact")
@pytest.mark.parametrize("gone", [1, 2])
def test_a_user_who_is_taken_out_leaves_what_the_others_know_without_it(gone: int) -> None:
    """Its ranges gone before, and its priors marginalised, the batch of the others alone is left."""
    walk = Walk(3)
    out, parts = follow(walk, 6)
    others = [u for u in range(3) if u != gone]
    between = []
    for slot in range(6):
        between += walk.ranges(slot, others)
        out.put(*between[-1])
    out.update()
    out.drop_user(gone)
    out.rebuild()
    assert all(users == others for users in out.slots.values())
    settle(out)
    left = [part for part in parts if part[0][0] in ("step", "walk", "place", "height") and part[0][1] in others]  # type: ignore[index]
    of_all = [Joining(u, 0, float(walk.place(u, 0)[2]), 0.0, 0.3, OWN) for u in others]
    left += [*between, (("prior", 0), joining_prior(of_all, [], SHARED), 0)]
    expected, _, _ = batch(left, start(walk, variables(out)))
    assert_estimates(out, expected, 2e-4)


def test_who_comes_and_goes_again_and_again_leaves_the_graph_sound() -> None:
    """The marginals of each time stay: of what the first told nothing is lost."""
    walk = Walk(3)
    out, _ = follow(walk, 6)
    for again in range(3):
        for slot in range(6):
            out.put(*walk.ranges(slot, [0, 2])[0])
        out.drop_user(1)
        out.rebuild()
        settled = out.covariance([(2, 5)])
        known = [Joining(u, 0, float(walk.place(u, 0)[2]), 0.0, 0.3, OWN) for u in (0, 2)]
        new = Joining(1, 0, float(walk.place(1, 0)[2]), 0.0, 0.3, OWN)
        for slot in range(6):
            out.insert(1, slot, walk.state(1, slot))
            for part in walk.step(1, slot) if slot else []:
                out.put(*part)
            out.put(*walk.ranges(slot)[0])
        out.put(("prior", 1, again), joining_prior([new], known, SHARED), 0)
        noise = gtsam.noiseModel.Isotropic.Sigma(3, 1.0)
        pose = gtsam.Pose2(*walk.state(1, 0).pose)
        out.put(("place", 1, again), gtsam.PriorFactorPose2(keys.slot_pose(1, 0), pose, noise), 0)
        out.rebuild()
        size = np.sqrt(np.diag(settled))
        assert (np.sqrt(np.diag(out.covariance([(2, 5)]))) < 1.2 * size).all()
    assert sum(name[:2] == ("marginal", "of") for name in out.names()) >= 1  # type: ignore[index]


def test_a_variable_that_nothing_sees_is_an_error() -> None:
    out, _ = follow(Walk(2), 3)
    out.insert(0, 3, SlotState((0.0, 0.0, 0.0), 0.0, np.zeros(3)))
    out.insert(1, 3, SlotState((0.0, 0.0, 0.0), 0.0, np.zeros(3)))
    for part in Walk(2).step(0, 3):
        out.put(*part)
    with pytest.raises(RuntimeError):
        out.update()


# The order of time


def cliques(out: Follower) -> list[tuple[list[int], list[int]]]:
    """Slots of the variables that each clique of the tree eliminates, and of those that it depends on."""
    of = []
    first = gtsam.symbolIndex(keys.slot_pose(0, 0)) // 10**4
    for label in re.findall(r'label="([^"]*)"', out._tree.dot()):
        front, _, separator = label.partition(":")
        slots = ([int(n) - first for n in re.findall(r"[xhd](\d+)", part)] for part in (front, separator))
        of.append(tuple(slots))
    return of  # type: ignore[return-value]


@pytest.mark.parametrize("users", [1, 2, 5])
def test_slots_are_eliminated_in_the_order_of_time_for_hundreds_of_slots(users: int) -> None:
    out, _ = follow(Walk(users), 200 if users < 5 else 120, window=12)
    found = cliques(out)
    assert sum(len(front) for front, _ in found) == 3 * users * len(out.slots)
    for front, separator in found:
        assert max(front) <= min(separator, default=max(out.slots))
    assert max(found[0][0]) == max(out.slots)


@pytest.mark.parametrize("users", [1, 2])
def test_nothing_is_out_of_order_where_nothing_is_forgotten(users: int) -> None:
    out, _ = follow(Walk(users), 150)
    for front, separator in cliques(out):
        assert max(front) <= min(separator, default=149)


# To and from plain arrays


def test_a_slot_is_one_clique_however_many_users_it_has() -> None:
    """One for each user would keep as much as all together, each: the cube of how many they are."""
    out, _ = follow(Walk(8), 12, 6)
    assert len(cliques(out)) <= len(out.slots)
    for frontal, separator in cliques(out):
        assert not set(frontal) & set(separator)


@pytest.mark.parametrize("window", [None, 4])
def test_what_is_taken_to_arrays_and_back_goes_on_the_same(window: int | None) -> None:
    """A factor that was put and not taken in yet, and the one it replaces, are not forgotten either."""
    walk = Walk(3)
    out, parts = follow(walk, 10, window)
    out.put(*walk.ranges(8, each=9)[0])
    made = {name: factor for name, factor, _ in parts} | {("ranges", 8): out._factors["ranges", 8].factor}
    again = Follower.from_state(out.to_state(), made)
    assert list(again.names()) == list(out.names())
    assert again.slots == out.slots
    for step in range(3):
        for at in variables(out):
            np.testing.assert_allclose(again.states([at])[0], out.states([at])[0], atol=1e-7)
        np.testing.assert_allclose(again.covariance([(1, 9)]), out.covariance([(1, 9)]), rtol=1e-6, atol=1e-12)
        slot = 10 + step
        for user in range(3):
            more = walk.step(user, slot)
            for each in (out, again):
                each.insert(user, slot, walk.state(user, slot, off=0.3))
                for part in more:
                    each.put(*part)
        (ranges,) = walk.ranges(slot)
        for each in (out, again):
            each.put(*ranges)
            each.update()
            each.marginalize(slot - 5)
