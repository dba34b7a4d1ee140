from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np
import pytest
from support import reference_kernel as reference

from synchronizar._core import (
    Cauchy,
    GemanMcClure,
    Huber,
    NlosMixture,
    RangeSlot,
    Squared,
    semidefinite_root,
)
from synchronizar.arrays import Array

if TYPE_CHECKING:
    from synchronizar._core import Loss

LOSSES: list[Loss] = [Squared(), Huber(), Cauchy(), GemanMcClure(), NlosMixture(1.0, 0.002)]
losses = pytest.mark.parametrize("loss", LOSSES, ids=lambda loss: type(loss).__name__)


class Scene:
    """k users at random places, `many` ranges a pair in random order of pairs' runs, some late."""

    def __init__(self, k: int, many: int, seed: int = 0, far: float = 3.0, offset: float = 0.2) -> None:
        random = np.random.default_rng(seed)
        self.k = k
        self.poses = random.normal(0.0, far, (k, 8))
        self.calibrations = random.normal(0.0, 0.1, (k, 3))
        pairs = np.array([pair for pair in combinations(range(k), 2) for _ in range(many)], dtype=np.int32)
        self.i, self.j = pairs.T.copy()
        n = len(pairs)
        self.ends = [tuple(random.normal(0.0, s, (n, 3)) for s in (2.0, 0.2, 1.0)) for _ in "ij"]
        self.sigma, self.odds = random.uniform(0.05, 0.2, n), random.uniform(0.05, 0.5, n)
        self.range_weight = random.uniform(0.2, 1.5, n)
        self.distance = np.zeros(n)
        self.distance = self.slot().residuals(self.poses, self.calibrations) + random.normal(0.0, 0.1, n) + offset
        self.distance[random.random(n) < 0.2] += 1.5

    def slot(self) -> RangeSlot:
        columns = self.distance, self.sigma, self.odds, self.range_weight
        return RangeSlot(self.k, self.i, self.j, self.ends[0], self.ends[1], *columns)

    def of_pairs(self) -> list[tuple[int, int, RangeSlot]]:
        """The slot of each pair by itself."""
        out = []
        for a, b in combinations(range(self.k), 2):
            which = (self.i == a) & (self.j == b)
            ends = [tuple(column[which] for column in end) for end in self.ends]
            columns = (c[which] for c in (self.distance, self.sigma, self.odds, self.range_weight))
            first = np.zeros(which.sum(), dtype=np.int32)
            out.append((a, b, RangeSlot(2, first, first + 1, ends[0], ends[1], *columns)))
        return out

    def at(self, *users: int) -> tuple[Array, Array]:
        """Poses and calibrations."""
        return self.poses[list(users)], self.calibrations[list(users)]

    def squares_of_pairs(self, loss: Loss, annealing: float = 1.0, curvature: Array | None = None) -> Array:
        """[A b]' [A b] over all users' eleven columns and a residual, pair by pair."""
        out = np.zeros((11 * self.k + 1, 11 * self.k + 1))
        for p, (a, b, slot) in enumerate(self.of_pairs()):
            own = None if curvature is None else curvature[p : p + 1]
            root = slot.square_root(*self.at(a, b), loss, annealing, own)
            at = np.concatenate([np.arange(11 * a, 11 * a + 11), np.arange(11 * b, 11 * b + 11), [11 * self.k]])
            out[np.ix_(at, at)] += root.T @ root
        return out


def assert_same_squares(root: Array, expected: Array) -> None:
    size = np.sqrt(np.maximum(np.diag(expected), 1e-12))
    np.testing.assert_allclose(root.T @ root / np.outer(size, size), expected / np.outer(size, size), atol=1e-10)


@pytest.mark.parametrize("k", [2, 3, 7, 20])
@losses
def test_a_slot_is_the_sum_of_its_pairs(k: int, loss: Loss) -> None:
    scene = Scene(k, 6 if k < 20 else 2)
    slot = scene.slot()
    assert len(slot) == len(scene.distance)
    assert slot.users == k
    assert slot.pairs == list(combinations(range(k), 2))
    root = slot.square_root(scene.poses, scene.calibrations, loss, 1.5)
    assert len(root) <= 7 * k + 1
    assert_same_squares(root, scene.squares_of_pairs(loss, 1.5))
    expected = sum(pair.cost(*scene.at(a, b), loss, 1.5) for a, b, pair in scene.of_pairs())
    assert slot.cost(scene.poses, scene.calibrations, loss, 1.5) == pytest.approx(expected, rel=1e-12)
    residuals = np.concatenate([pair.residuals(*scene.at(a, b)) for a, b, pair in scene.of_pairs()])
    np.testing.assert_allclose(slot.residuals(scene.poses, scene.calibrations), residuals, atol=1e-12)


@losses
@pytest.mark.parametrize("offset", [0.3, -0.3])
def test_it_has_the_numerical_gradient_of_its_cost(loss: Loss, offset: float) -> None:
    scene = Scene(3, 8, offset=offset)
    slot, h = scene.slot(), 1e-5

    def cost(user: int, delta: Array) -> float:
        poses, calibrations = scene.poses.copy(), scene.calibrations.copy()
        poses[user] = reference.perturbed(poses[user, [0, 1, 2, 3, 4, 5, 6, 7]], delta[:8])
        calibrations[user] += delta[8:]
        return slot.cost(poses, calibrations, loss)

    steps = [(user, h * d) for user in range(3) for d in np.eye(11)]
    numerical = [(cost(u, -2 * d) - 8 * cost(u, -d) + 8 * cost(u, d) - cost(u, 2 * d)) / (12 * h) for u, d in steps]
    root = slot.square_root(scene.poses, scene.calibrations, loss)
    gradient = root[:, :-1].T @ root[:, -1]
    np.testing.assert_allclose(gradient, numerical, atol=1e-6 * np.abs(gradient).max())


def test_users_far_from_the_origin_lose_no_digits() -> None:
    """The squares are summed about each user's own place; a QR of single rows is what they must be."""
    scene = Scene(4, 10, far=1.0)
    scene.poses[:, :2] += 1e4
    scene.distance += scene.slot().residuals(scene.poses, scene.calibrations)
    scene.distance += np.random.default_rng(1).normal(0.0, 0.1, len(scene.distance))
    rows = scene.squares_of_pairs(Squared(), curvature=np.zeros(6))
    root = scene.slot().square_root(scene.poses, scene.calibrations, Squared(), height_curvature=np.zeros(6))
    assert_same_squares(root, rows)
    # Without each user's heading, which the origin moves, what is left is as good as near the origin.
    near = [c for u in range(4) for c in (11 * u + 4, 11 * u + 5, 11 * u + 6, 11 * u + 7)]
    expected = np.linalg.eigvalsh(rows[np.ix_(near, near)])
    found = np.linalg.svd(root[:, near], compute_uv=False)
    np.testing.assert_allclose(np.sort(found**2)[-8:], expected[-8:], rtol=1e-6)


def test_what_ranges_do_not_tell_stays_untold() -> None:
    """Everybody may move and turn together: four numbers at least are not in the rows."""
    scene = Scene(5, 12)
    root = scene.slot().square_root(scene.poses, scene.calibrations, Squared(), height_curvature=np.zeros(10))
    assert len(root) <= 7 * 5 + 1 - 4
    frames = np.concatenate([root[:, 11 * u : 11 * u + 4] for u in range(5)], axis=1)
    x, y, yaw, _ = scene.poses[:, :4].T
    together = []
    for dx, dy, dz, turn in np.eye(4):
        shift_x, shift_y = dx - turn * y, dy + turn * x
        own = [np.cos(yaw) * shift_x + np.sin(yaw) * shift_y, -np.sin(yaw) * shift_x + np.cos(yaw) * shift_y]
        together.append(np.column_stack([*own, np.full(5, turn), np.full(5, dz)]).ravel())
    scale = np.abs(root).max()
    np.testing.assert_allclose(frames @ np.array(together).T, 0.0, atol=1e-5 * scale)


def test_antennas_that_coincide_have_no_direction_and_spoil_nothing() -> None:
    scene = Scene(2, 3)
    scene.poses[1] = scene.poses[0]
    scene.calibrations[1] = scene.calibrations[0]
    scene.ends[1] = scene.ends[0]
    scene.distance = np.full(3, 0.1)
    root = scene.slot().square_root(scene.poses, scene.calibrations, NlosMixture(1.0, 0.002))
    assert np.isfinite(root).all()
    assert_same_squares(root, scene.squares_of_pairs(NlosMixture(1.0, 0.002)))


def test_height_curvature_is_replaced_pair_by_pair() -> None:
    scene, curvature = Scene(4, 5), np.linspace(0.0, 3.0, 6)
    scene.poses[:, 7] = 0.0
    root = scene.slot().square_root(scene.poses, scene.calibrations, Squared(), height_curvature=curvature)
    assert_same_squares(root, scene.squares_of_pairs(Squared(), curvature=curvature))


@losses
def test_at_the_frames_origins_there_are_columns_of_frames_and_devices_alone(loss: Loss) -> None:
    scene = Scene(5, 6)
    scene.poses[:, 4:] = 0.0
    root = scene.slot().square_root_frames(scene.poses[:, :4].copy(), scene.calibrations, loss, 2.0)
    kept = [11 * u + c for u in range(5) for c in (0, 1, 2, 3, 8, 9, 10)] + [55]
    assert root.shape[1] == 36
    assert_same_squares(root, scene.squares_of_pairs(loss, 2.0)[np.ix_(kept, kept)])


def test_weights_are_replaced_and_the_rest_is_kept() -> None:
    scene = Scene(3, 4)
    before = scene.slot()
    scene.odds, scene.range_weight = scene.odds * 2.0, scene.range_weight * 0.5
    after = before.with_weights(scene.odds, scene.range_weight)
    loss = NlosMixture(1.0, 0.002)
    expected = scene.slot().square_root(scene.poses, scene.calibrations, loss)
    np.testing.assert_array_equal(after.square_root(scene.poses, scene.calibrations, loss), expected)
    assert after.cost(scene.poses, scene.calibrations, loss) != before.cost(scene.poses, scene.calibrations, loss)


def test_ranges_may_come_in_any_order() -> None:
    scene = Scene(4, 5)
    expected = scene.slot().square_root(scene.poses, scene.calibrations, Cauchy())
    order = np.random.default_rng(2).permutation(len(scene.distance))
    for name in ("i", "j", "distance", "sigma", "odds", "range_weight"):
        setattr(scene, name, getattr(scene, name)[order])
    scene.ends = [tuple(column[order] for column in end) for end in scene.ends]
    root = scene.slot().square_root(scene.poses, scene.calibrations, Cauchy())
    assert_same_squares(root, expected.T @ expected)


@pytest.mark.parametrize("weakest", [1.0, 1e-4, 1e-6, 0.0])
def test_a_root_squares_to_its_matrix_and_stops_at_its_rank(weakest: float) -> None:
    random = np.random.default_rng(0)
    rows = random.normal(size=(30, 12)) * np.logspace(-6, 6, 12)
    directions, sizes, axes = np.linalg.svd(rows / np.linalg.norm(rows, axis=0), full_matrices=False)
    sizes[-3:] *= weakest
    rows = (directions * sizes) @ axes * np.linalg.norm(rows, axis=0)
    root = semidefinite_root(rows.T @ rows)
    assert len(root) == (12 if weakest else 9)
    size = np.linalg.norm(rows, axis=0)
    np.testing.assert_allclose(root.T @ root / np.outer(size, size), rows.T @ rows / np.outer(size, size), atol=1e-13)
    # What a QR of the rows has is there too, weak directions as far as squares can hold them.
    exact = np.linalg.svd(rows / size, compute_uv=False)
    found = np.linalg.svd(root / size, compute_uv=False)
    np.testing.assert_allclose(found, exact[: len(root)], rtol=1e-3 if weakest == 1e-6 else 1e-7)


@pytest.mark.parametrize(
    ("change", "fault"),
    [
        ({"i": np.array([0, 5], dtype=np.int32)}, "not there"),
        ({"j": np.array([0, 1], dtype=np.int32)}, "between two users"),
        ({"range_weight": np.zeros(2)}, "range_weight"),
        ({"odds": np.array([-1.0, 0.0])}, "nlos_odds"),
        ({"sigma": np.zeros(2)}, "sigma"),
    ],
)
def test_bad_columns_are_refused(change: dict[str, Array], fault: str) -> None:
    scene = Scene(2, 2)
    for name, column in change.items():
        setattr(scene, name, column)
    with pytest.raises(ValueError, match=fault):
        scene.slot()


def test_bad_poses_are_refused() -> None:
    scene = Scene(3, 2)
    with pytest.raises(ValueError, match="one row a user"):
        scene.slot().residuals(scene.poses[:2], scene.calibrations)
    with pytest.raises(ValueError, match="one number a pair"):
        scene.slot().square_root(scene.poses, scene.calibrations, Squared(), height_curvature=np.zeros(2))
