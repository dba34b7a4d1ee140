from __future__ import annotations

import numpy as np
import pytest

from synchronizar._core import Adjustment
from synchronizar.arrays import Array, Indices

K, N, SIGMA, SOFT = 4, 120, 0.1, 0.3


class Scene:
    def __init__(self, seed: int = 0) -> None:
        random = np.random.default_rng(seed)
        self.i = random.integers(0, K - 1, N).astype(np.int32)
        self.j = (self.i + 1 + random.integers(0, K - 1 - self.i)).astype(np.int32)
        self.p, self.q = random.normal(0.0, 3.0, (2, N, 3))
        self.centre = random.normal(0.0, 1.0, (K, 3))
        self.true = random.normal(0.0, 0.1, (K, 6))
        self.distance = np.zeros(N)
        self.distance = self.predicted(self.true) + random.normal(0.0, SIGMA, N)
        self.free: Indices = np.arange(6 * K, dtype=np.int32)[4:]
        self.prior_mean = random.normal(0.0, 0.05, len(self.free))
        self.prior_weight = np.full(len(self.free), 1.0 / 0.2**2)

    def antennas(self, p: Array, who: Indices, at: Array) -> Array:
        c, s = np.cos(at[who, 3]), np.sin(at[who, 3])
        arm = p - self.centre[who]
        turned = np.column_stack([c * arm[:, 0] - s * arm[:, 1], s * arm[:, 0] + c * arm[:, 1], arm[:, 2]])
        return np.asarray(np.exp(at[who, 5])[:, None] * turned + self.centre[who] + at[who, :3])

    def predicted(self, at: Array) -> Array:
        apart = self.antennas(self.p, self.i, at) - self.antennas(self.q, self.j, at)
        return np.asarray(np.linalg.norm(apart, axis=1) + at[self.i, 4] + at[self.j, 4])

    def core(self) -> Adjustment:
        return Adjustment(self.i, self.j, self.p, self.q, self.distance, self.centre, SIGMA, SOFT)

    def jacobian(self, at: Array) -> Array:
        """(n, d) by numerical derivatives."""
        columns, h = [], 1e-6
        for index in self.free:
            ends = []
            for side in (h, -h):
                moved = at.copy()
                moved.ravel()[index] += side
                ends.append(self.predicted(moved))
            columns.append((ends[0] - ends[1]) / (2.0 * h))
        return np.array(columns).T

    def step(self, at: Array) -> tuple[Array, Array]:
        """Where one step leads, and its normal matrix."""
        residual, J = self.distance - self.predicted(at), self.jacobian(at)
        weight = 1.0 / (SIGMA**2 * (1.0 + (residual / SOFT) ** 2))
        normal = J.T @ (weight[:, None] * J) + np.diag(self.prior_weight)
        now = at.ravel()[self.free]
        move = np.linalg.solve(normal, J.T @ (weight * residual) + self.prior_weight * (self.prior_mean - now))
        out = at.copy()
        out.ravel()[self.free] = now + np.clip(move, -0.5, 0.5)
        return out, normal


def test_residuals_are_measured_minus_predicted() -> None:
    scene = Scene()
    found = scene.core().residuals(scene.true)
    np.testing.assert_allclose(found, scene.distance - scene.predicted(scene.true), atol=1e-12)


@pytest.mark.parametrize("seed", range(3))
def test_its_steps_are_gauss_newtons(seed: int) -> None:
    scene = Scene(seed)
    at = expected = np.zeros((K, 6))
    for _ in range(4):
        expected, normal = scene.step(expected)
        at, found = scene.core().adjust(at, scene.free, scene.prior_mean, scene.prior_weight, 1, 0.5, 1e-3)
        np.testing.assert_allclose(at, expected, atol=1e-6)
        np.testing.assert_allclose(found, normal, rtol=1e-5, atol=1e-3)
    assert not at.ravel()[:4].any()


def test_it_stops_where_steps_are_short() -> None:
    scene = Scene()
    arguments = scene.free, scene.prior_mean, scene.prior_weight
    few, _ = scene.core().adjust(np.zeros((K, 6)), *arguments, 12, 0.5, 1e-3)
    many, _ = scene.core().adjust(np.zeros((K, 6)), *arguments, 100, 0.5, 0.0)
    np.testing.assert_allclose(few, many, atol=2e-3)


def test_bad_ranges_are_refused() -> None:
    scene = Scene()
    scene.j[0] = K
    with pytest.raises(ValueError, match="not there"):
        scene.core()
    scene = Scene()
    with pytest.raises(ValueError, match="corrections"):
        scene.core().residuals(np.zeros((K - 1, 6)))
