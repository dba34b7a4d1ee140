from __future__ import annotations

import gtsam
import numpy as np
import pytest

from experiments.common.optimize import optimize
from synchronizar._core import Huber, RangeBlock, UserPose
from synchronizar.arrays import Array
from synchronizar.graph.range_factors import FixedUser, RangeBlockFactor, UserKeys

FRAME, HEIGHT, X = 1, 2, 3
PLACE, UP = (4.0, 3.0, -2.5), 0.4


def ordering_of(*keys: int) -> gtsam.Ordering:
    out = gtsam.Ordering()
    for key in keys:
        out.push_back(key)
    return out


def range_graph() -> gtsam.NonlinearFactorGraph:
    """A user that ranges to one that is held, with noise and a prior on its height."""
    random = np.random.default_rng(4)
    o_i, o_j = random.normal(0.0, [3.0, 3.0, 1.0], (2, 100, 3))
    sigma, odds = np.full(100, 0.1), np.zeros(100)
    exact = RangeBlock(o_i, o_j, np.zeros(100), sigma, odds).residuals(UserPose(), UserPose(*PLACE, UP))
    block = RangeBlock(o_i, o_j, exact + random.normal(0.0, 0.1, 100), sigma, odds)
    graph = gtsam.NonlinearFactorGraph()
    graph.add(RangeBlockFactor(FixedUser(UserPose()), UserKeys(FRAME, HEIGHT), block, Huber()))
    graph.addPriorDouble(HEIGHT, 0.0, gtsam.noiseModel.Isotropic.Sigma(1, 0.5))
    return graph


def active_users(x: float, y: float, yaw: float, height: float) -> gtsam.Values:
    values = gtsam.Values()
    values.insert(FRAME, gtsam.Pose2(x, y, yaw))
    values.insert(HEIGHT, height)
    return values


def scalar(x: float) -> gtsam.Values:
    values = gtsam.Values()
    values.insert(X, x)
    return values


class Counted:
    """A graph that tells the cost of each step that was tried, and how often it was linearised."""

    def __init__(self, graph: gtsam.NonlinearFactorGraph) -> None:
        self.graph, self.costs, self.linearised = graph, list[float](), list[float]()

    def error(self, values: gtsam.Values) -> float:
        self.costs.append(self.graph.error(values))
        return self.costs[-1]

    def linearize(self, values: gtsam.Values) -> gtsam.GaussianFactorGraph:
        self.linearised.append(self.graph.error(values))
        return self.graph.linearize(values)


def arc_tangent() -> gtsam.NonlinearFactorGraph:
    """The residual atan(x): from beyond 1.39 a full Gauss-Newton step leads further away."""

    def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        x = values.atDouble(X)
        if jacobians is not None:
            jacobians[0] = np.array([[1.0 / (1.0 + x * x)]])
        return np.array([np.arctan(x)])

    graph = gtsam.NonlinearFactorGraph()
    graph.add(gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(1), [X], error))
    return graph


@pytest.mark.parametrize("off", [(0.3, -0.4, 0.1, -0.2), (-1.0, 0.5, 0.4, 0.3)])
def test_the_minimum_is_that_of_levenberg_and_marquardt(off: tuple[float, float, float, float]) -> None:
    graph = range_graph()
    start = active_users(*(np.array([*PLACE, UP]) + off))
    found = optimize(graph, start, ordering_of(FRAME, HEIGHT), 50, 1e-12)
    parameters = gtsam.LevenbergMarquardtParams()
    parameters.setRelativeErrorTol(1e-14)
    parameters.setAbsoluteErrorTol(1e-14)
    expected = gtsam.LevenbergMarquardtOptimizer(graph, start, parameters).optimize()
    assert graph.error(found) == pytest.approx(graph.error(expected), rel=1e-9)
    np.testing.assert_allclose(found.atPose2(FRAME).localCoordinates(expected.atPose2(FRAME)), 0.0, atol=1e-5)
    assert found.atDouble(HEIGHT) == pytest.approx(expected.atDouble(HEIGHT), abs=1e-4)


def test_the_cost_never_rises() -> None:
    random = np.random.default_rng(5)
    for _ in range(20):
        start = active_users(*random.uniform([-8.0, -8.0, -np.pi, -2.0], [8.0, 8.0, np.pi, 2.0]))
        graph = Counted(range_graph())
        found = optimize(graph, start, ordering_of(FRAME, HEIGHT), 30, 1e-6)
        assert (np.diff(graph.linearised) < 0.0).all()
        assert graph.graph.error(found) == min(graph.costs) <= graph.graph.error(start)


def test_at_a_minimum_nothing_is_tried() -> None:
    graph = range_graph()
    minimum = optimize(graph, active_users(*PLACE, UP), ordering_of(FRAME, HEIGHT), 50, 1e-12)
    counted = Counted(graph)
    again = optimize(counted, minimum, ordering_of(FRAME, HEIGHT), 50, 1e-6)
    assert again is minimum
    assert len(counted.costs) == len(counted.linearised) == 1


def test_a_step_that_overshoots_is_shortened() -> None:
    """Newton's step on atan from x = 3 is -10 atan(3): to -9.5. Of 0.4 of it, -2.0, the cost is lower."""
    graph = Counted(arc_tangent())
    once = optimize(graph, scalar(3.0), ordering_of(X), 1, 1e-12)
    assert once.atDouble(X) == pytest.approx(3.0 - 0.4 * 10.0 * np.arctan(3.0))
    assert graph.costs[1] > graph.costs[0] > graph.costs[2]
    assert len(graph.costs) == 3
    assert optimize(graph, scalar(3.0), ordering_of(X), 20, 1e-12).atDouble(X) == pytest.approx(0.0, abs=1e-6)


def test_there_are_no_more_steps_than_asked_for() -> None:
    for steps in range(4):
        graph = Counted(arc_tangent())
        optimize(graph, scalar(3.0), ordering_of(X), steps, 0.0)
        assert len(graph.linearised) == steps


@pytest.mark.parametrize(("gain", "linearised"), [(0.1, 2), (0.106, 1)])
def test_a_step_that_gains_or_promises_too_little_is_the_last(gain: float, linearised: int) -> None:
    """From x = 0.5 the first step promises 0.1075 and gains 0.1043; the next would gain 0.003."""
    graph = Counted(arc_tangent())
    found = optimize(graph, scalar(0.5), ordering_of(X), 20, gain)
    assert (len(graph.linearised), len(graph.costs)) == (linearised, 2)
    assert found.atDouble(X) == pytest.approx(0.5 - 1.25 * np.arctan(0.5))


def test_where_no_length_of_step_helps_the_values_stay() -> None:
    """A factor whose derivative has the wrong sign promises what never comes."""

    def error(_: gtsam.CustomFactor, values: gtsam.Values, jacobians: list[Array] | None) -> Array:
        if jacobians is not None:
            jacobians[0] = np.array([[-1.0]])
        return np.array([values.atDouble(X)])

    graph = gtsam.NonlinearFactorGraph()
    graph.add(gtsam.CustomFactor(gtsam.noiseModel.Unit.Create(1), [X], error))
    start = scalar(1.0)
    assert optimize(graph, start, ordering_of(X), 20, 1e-9) is start


def test_a_linear_problem_is_solved_in_one_step() -> None:
    graph = gtsam.NonlinearFactorGraph()
    graph.addPriorDouble(X, 2.0, gtsam.noiseModel.Unit.Create(1))
    graph.addPriorDouble(X, 5.0, gtsam.noiseModel.Isotropic.Sigma(1, 0.5))
    counted = Counted(graph)
    assert optimize(counted, scalar(-40.0), ordering_of(X), 1, 1e-9).atDouble(X) == pytest.approx(22.0 / 5.0)
    assert len(counted.costs) == 2
