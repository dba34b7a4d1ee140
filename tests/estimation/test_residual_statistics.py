from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from support.solver_scenes import distances, rigid_graph, true_frames

from synchronizar.arrays import Array
from synchronizar.estimation.residual_statistics import misfit
from synchronizar.preprocessing.range_measurements import Samples
from synchronizar.simulation.simulate import Scene, simulate

SIGMA = 0.1
PIECES = 12


def walk(seed: int, users: int = 3) -> tuple[Samples, Array]:
    simulation = simulate(Scene(users=users, seed=seed, height_bob=0.2))
    return rigid_graph(simulation.recording)[0], true_frames(simulation, "phone0")


def inflation(samples: Samples, frames: Array, residual: Array, user: int = 1, weight: float = SIGMA**-2) -> float:
    n = len(samples)
    return misfit(samples, frames, residual, np.full(n, weight), np.ones(n), user).inflation


def jacobian_of(samples: Samples, frames: Array, user: int) -> Array:
    """(n, 4): numerical derivatives of the distances by the user's x, y, z, yaw."""
    h = 1e-6
    columns = []
    for step in h * np.eye(4):
        ahead, behind = frames.copy(), frames.copy()
        ahead[user] += step
        behind[user] -= step
        columns.append((distances(samples, ahead) - distances(samples, behind)) / (2.0 * h))
    return np.column_stack(columns)


def test_what_white_noise_leaves_of_residuals_inflates_nothing() -> None:
    random = np.random.default_rng(0)
    found = []
    for seed in range(10):
        samples, frames = walk(seed)
        both = np.column_stack([jacobian_of(samples, frames, u) for u in (1, 2)])
        fit, _ = np.linalg.qr(both)
        for _ in range(20):
            noise = SIGMA * random.standard_normal(len(samples))
            found.append(inflation(samples, frames, noise - fit @ (fit.T @ noise)))
    assert len(found) == 200
    assert np.mean(np.array(found) == 1.0) > 0.95
    assert max(found) < 1.5


def same_for(samples: Samples, seconds: float, random: np.random.Generator) -> Array:
    """Residuals (n,) of a pair that stay what they are for so long, as large as noise."""
    _, cluster = np.unique(
        np.stack([samples.i, samples.j, (samples.t / seconds).astype(int)]), axis=1, return_inverse=True
    )
    return np.asarray(SIGMA * random.standard_normal(cluster.max() + 1)[cluster])


def test_residuals_that_stay_the_same_for_seconds_inflate() -> None:
    random = np.random.default_rng(1)
    found = []
    for draw in range(40):
        samples, frames = walk(draw % 10)
        found.append(inflation(samples, frames, same_for(samples, 2.0, random)))
    assert np.mean(np.array(found) > 1.5) > 0.95
    # Eight ranges a second and pair that say one thing in the piece's second are worth one.
    assert 3.0 < np.median(found) < 12.0


def by_definition(samples: Samples, frames: Array, residual: Array, weight: float, user: int) -> float:
    """The excess, in loops."""
    jacobian = jacobian_of(samples, frames, user)
    information = weight * jacobian.T @ jacobian
    scores: dict[tuple[int, int, int], Array] = {}
    begin, span = samples.t.min(), np.ptp(samples.t)
    for n in range(len(samples)):
        i, j = int(samples.i[n]), int(samples.j[n])
        if user in (i, j):
            piece = min(int((samples.t[n] - begin) / span * PIECES), PIECES - 1)
            key = (i, j, piece)
            scores[key] = scores.get(key, np.zeros(4)) + weight * residual[n] * jacobian[n]
    f = sum(float(g @ np.linalg.solve(information, g)) for g in scores.values()) / 4.0
    return max(1.0, f / float(1.0 + 2.0 * np.sqrt(2.0 / (4.0 * len(scores)))))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("user", [1, 2])
def test_the_inflation_is_that_of_the_scores_of_each_pair_and_piece(seed: int, user: int) -> None:
    samples, frames = walk(seed)
    residual = same_for(samples, 1.0, np.random.default_rng(seed))
    found = inflation(samples, frames, residual, user)
    assert found > 1.0
    assert found == pytest.approx(by_definition(samples, frames, residual, SIGMA**-2, user), rel=1e-5)


def test_residuals_twice_as_large_inflate_four_times_as_much() -> None:
    samples, frames = walk(3)
    residual = same_for(samples, 2.0, np.random.default_rng(3))
    once, twice = inflation(samples, frames, residual), inflation(samples, frames, 2.0 * residual)
    assert once > 1.0
    assert twice == pytest.approx(4.0 * once)


def test_weights_and_residuals_that_grow_together_change_nothing() -> None:
    samples, frames = walk(4)
    residual = same_for(samples, 2.0, np.random.default_rng(4))
    fine = inflation(samples, frames, 0.1 * residual, weight=100.0 / SIGMA**2)
    assert fine == pytest.approx(inflation(samples, frames, residual))


def test_residuals_of_other_users_do_not_count() -> None:
    samples, frames = walk(5)
    mine = (samples.i == 1) | (samples.j == 1)
    residual = np.where(mine, 0.0, 10.0)
    assert inflation(samples, frames, residual, user=1) == 1.0
    assert inflation(samples, frames, residual, user=2) > 100.0


def test_no_residuals_at_all_make_nobody_surer_than_noise_allows() -> None:
    samples, frames = walk(6)
    assert inflation(samples, frames, np.zeros(len(samples))) == 1.0


def test_the_share_of_rejected_ranges_is_that_of_the_user_s_own() -> None:
    samples, frames = walk(7)
    mine = np.flatnonzero((samples.i == 1) | (samples.j == 1))
    honest = np.zeros(len(samples))
    honest[mine] = 1.0
    honest[mine[: len(mine) // 4]] = 0.49
    found = misfit(samples, frames, np.zeros(len(samples)), np.full(len(samples), 100.0), honest, 1)
    assert found.rejected == (len(mine) // 4) / len(mine)


def test_ranges_that_have_no_weight_tell_of_no_misfit() -> None:
    samples, frames = walk(8)
    n = len(samples)
    assert misfit(samples, frames, np.ones(n), np.zeros(n), np.zeros(n), 1) == (1.0, 1.0)


def test_a_user_that_stands_still_is_judged_by_what_its_ranges_see() -> None:
    samples, frames = walk(9, users=2)
    standing = replace(samples, p_j=np.zeros_like(samples.p_j))  # it never leaves its origin: no yaw is seen
    residual = SIGMA * np.random.default_rng(9).standard_normal(len(samples))
    found = inflation(standing, frames, residual)
    assert np.isfinite(found)
    assert found < 1.6
