from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.solver_scenes import distances, rigid_graph, true_frames

from synchronizar.arrays import Array
from synchronizar.estimation.residual_statistics import inflations
from synchronizar.preprocessing.range_measurements import RangeMeasurements
from synchronizar.simulation.simulate import Scene, simulate

SIGMA = 0.1
PIECES = 12


def walk(seed: int, users: int = 3) -> tuple[RangeMeasurements, Array]:
    simulation = simulate(Scene(users=users, seed=seed, height_bob=0.2))
    return rigid_graph(simulation.recording)[0], true_frames(simulation, "phone0")


def inflation(
    measurements: RangeMeasurements, frames: Array, residual: Array, user: int = 1, weight: float = SIGMA**-2
) -> float:
    n = len(measurements)
    return float(inflations(measurements, frames, residual, np.full(n, weight), PIECES)[user])


def jacobian_of(measurements: RangeMeasurements, frames: Array, user: int) -> Array:
    """(n, 4): numerical derivatives of the distances by the user's x, y, z, yaw."""
    h = 1e-6
    columns = []
    for step in h * np.eye(4):
        ahead, behind = frames.copy(), frames.copy()
        ahead[user] += step
        behind[user] -= step
        columns.append((distances(measurements, ahead) - distances(measurements, behind)) / (2.0 * h))
    return np.column_stack(columns)


def test_what_white_noise_leaves_of_residuals_inflates_nothing() -> None:
    random = np.random.default_rng(0)
    found = []
    for seed in range(10):
        measurements, frames = walk(seed)
        both = np.column_stack([jacobian_of(measurements, frames, u) for u in (1, 2)])
        fit, _ = np.linalg.qr(both)
        for _ in range(20):
            noise = SIGMA * random.standard_normal(len(measurements))
            found.append(inflation(measurements, frames, noise - fit @ (fit.T @ noise)))
    assert len(found) == 200
    assert np.mean(np.array(found) == 1.0) > 0.95
    assert max(found) < 1.5


def same_for(measurements: RangeMeasurements, seconds: float, random: np.random.Generator) -> Array:
    """Residuals (n,) of a pair that stay what they are for so long, as large as noise."""
    _, cluster = np.unique(
        np.stack([measurements.i, measurements.j, (measurements.t / seconds).astype(int)]), axis=1, return_inverse=True
    )
    return np.asarray(SIGMA * random.standard_normal(cluster.max() + 1)[cluster])


def test_residuals_that_stay_the_same_for_seconds_inflate() -> None:
    random = np.random.default_rng(1)
    found = []
    for draw in range(40):
        measurements, frames = walk(draw % 10)
        found.append(inflation(measurements, frames, same_for(measurements, 2.0, random)))
    assert np.mean(np.array(found) > 1.5) > 0.95
    # Eight ranges a second and pair that say one thing in the piece's second are worth one.
    assert 3.0 < np.median(found) < 12.0


def by_definition(measurements: RangeMeasurements, frames: Array, residual: Array, weight: float, user: int) -> float:
    """The excess, in loops."""
    jacobian = jacobian_of(measurements, frames, user)
    information = weight * jacobian.T @ jacobian
    scores: dict[tuple[int, int, int], Array] = {}
    begin, span = measurements.t.min(), np.ptp(measurements.t)
    for n in range(len(measurements)):
        i, j = int(measurements.i[n]), int(measurements.j[n])
        if user in (i, j):
            piece = min(int((measurements.t[n] - begin) / span * PIECES), PIECES - 1)
            key = (i, j, piece)
            scores[key] = scores.get(key, np.zeros(4)) + weight * residual[n] * jacobian[n]
    f = sum(float(g @ np.linalg.solve(information, g)) for g in scores.values()) / 4.0
    return max(1.0, f / float(1.0 + 2.0 * np.sqrt(2.0 / (4.0 * len(scores)))))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("user", [1, 2])
def test_the_inflation_is_that_of_the_scores_of_each_pair_and_piece(seed: int, user: int) -> None:
    measurements, frames = walk(seed)
    residual = same_for(measurements, 1.0, np.random.default_rng(seed))
    found = inflation(measurements, frames, residual, user)
    assert found > 1.0
    assert found == pytest.approx(by_definition(measurements, frames, residual, SIGMA**-2, user), rel=1e-5)


def test_residuals_twice_as_large_inflate_four_times_as_much() -> None:
    measurements, frames = walk(3)
    residual = same_for(measurements, 2.0, np.random.default_rng(3))
    once, twice = inflation(measurements, frames, residual), inflation(measurements, frames, 2.0 * residual)
    assert once > 1.0
    assert twice == pytest.approx(4.0 * once)


def test_weights_and_residuals_that_grow_together_change_nothing() -> None:
    measurements, frames = walk(4)
    residual = same_for(measurements, 2.0, np.random.default_rng(4))
    fine = inflation(measurements, frames, 0.1 * residual, weight=100.0 / SIGMA**2)
    assert fine == pytest.approx(inflation(measurements, frames, residual))


def test_residuals_of_other_users_do_not_count() -> None:
    measurements, frames = walk(5)
    mine = (measurements.i == 1) | (measurements.j == 1)
    residual = np.where(mine, 0.0, 10.0)
    assert inflation(measurements, frames, residual, user=1) == 1.0
    assert inflation(measurements, frames, residual, user=2) > 100.0


def test_no_residuals_at_all_make_nobody_surer_than_noise_allows() -> None:
    measurements, frames = walk(6)
    assert inflation(measurements, frames, np.zeros(len(measurements))) == 1.0


def test_ranges_that_have_no_weight_tell_of_no_misfit() -> None:
    measurements, frames = walk(8)
    n = len(measurements)
    np.testing.assert_array_equal(inflations(measurements, frames, np.ones(n), np.zeros(n), PIECES), 1.0)


def test_a_user_that_stands_still_is_judged_by_what_its_ranges_see() -> None:
    measurements, frames = walk(9, users=2)
    standing = replace(measurements, p_j=np.zeros_like(measurements.p_j))  # it never leaves its origin: no yaw is seen
    residual = SIGMA * np.random.default_rng(9).standard_normal(len(measurements))
    found = inflation(standing, frames, residual)
    assert np.isfinite(found)
    assert found < 1.6
