from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pytest
from support import reference_kernel as reference
from support.reference_kernel import Numbers

from synchronizar._core import (
    Cauchy,
    GemanMcClure,
    Huber,
    NlosMixture,
    RangeSlot,
    Squared,
    mixture_terms,
)
from synchronizar.arrays import Array

if TYPE_CHECKING:
    from synchronizar._core import Loss

LATE = NlosMixture(scale=1.0, early_odds=0.002)
LOSSES: dict[str, Loss] = {
    "squared": Squared(),
    "huber": Huber(),
    "cauchy": Cauchy(),
    "geman_mcclure": GemanMcClure(),
    "late": LATE,
}
annealings = pytest.mark.parametrize("annealing", [1.0, 3.0])
offsets = pytest.mark.parametrize("offset", [0.0, 0.6, -0.6])

# F (x, y, yaw), H, X (x, y, yaw), Z; log scale, bias (m), clock offset (s).
PLACE_I = np.array([1.0, -2.0, 0.4, 0.3, 0.5, 1.5, -1.2, 0.1, 0.2, 0.12, -0.15])
PLACE_J = np.array([4.0, 3.0, -2.5, -0.2, -1.0, 0.25, 0.8, 0.05, -0.3, -0.05, 0.2])
HEIGHTS = [3, 7, 8, 14, 18, 19]  # of both frames and both keyframes; and the log scales, which lift keyframes

Antennas = tuple[Array, Array, Array]


class Measured(NamedTuple):
    """What a slot of two users is made of."""

    i: Antennas
    j: Antennas
    distance: Array
    sigma: Array
    nlos_odds: Array
    range_weight: Array

    def slot(self) -> RangeSlot:
        first = np.zeros(len(self.distance), dtype=np.int32)
        return RangeSlot(2, first, first + 1, *self)


@pytest.fixture(scope="module", params=sorted(LOSSES))
def loss(request: pytest.FixtureRequest) -> Loss:
    return LOSSES[request.param]


def antennas(place: Numbers, ends: Antennas) -> Numbers:
    """(n, 3): where the antennas lie in the common frame, from device_range.h's definition."""
    offset, lever, velocity = ends
    scale = np.exp(place[8])
    beside = scale * offset + lever + place[10] * velocity
    in_plane = scale * place[4:6] + beside[:, :2] @ reference.rotation(place[6]).T
    common = place[:2] + in_plane @ reference.rotation(place[2]).T
    return np.column_stack([common, place[3] + scale * place[7] + beside[:, 2]])


def predicted(i: Numbers, j: Numbers, ranges: Measured) -> Numbers:
    between = antennas(i, ranges.i) - antennas(j, ranges.j)
    return np.asarray(np.sqrt((between**2).sum(axis=1)) + i[9] + j[9])


def perturbed(place: Array, delta: Numbers) -> Numbers:
    return np.concatenate([reference.perturbed(place[:8], delta[:8]), place[8:] + delta[8:]])


def rows(ranges: Measured) -> Array:
    """(n, 22): derivatives of what is predicted, by complex steps."""
    steps = 1j * reference.STEP * np.eye(22)
    columns = [predicted(perturbed(PLACE_I, d[:11]), perturbed(PLACE_J, d[11:]), ranges).imag for d in steps]
    return np.array(columns).T / reference.STEP


def losses(ranges: Measured, loss: Loss, annealing: float) -> tuple[Array, Array]:
    """(n,) whitened residuals, and rho, weight and curvature (3, n) of every range."""
    e = (predicted(PLACE_I, PLACE_J, ranges) - ranges.distance) / ranges.sigma
    of_ranges = zip(e, ranges.sigma, ranges.nlos_odds, strict=True)
    return e, np.array([reference.loss_value(loss, *of_range, annealing) for of_range in of_ranges]).T


def measured(n: int, offset: float = 0.0, seed: int = 1) -> Measured:
    """n ranges with noise, a third of them late by up to 3 m, and all of them off by `offset` (m)."""
    random = np.random.default_rng(seed)

    def end() -> Antennas:
        return random.normal(0.0, 4.0, (n, 3)), random.normal(0.0, 0.2, (n, 3)), random.normal(0.0, 1.0, (n, 3))

    sigma = random.uniform(0.05, 0.2, n)
    ranges = Measured(end(), end(), np.zeros(n), sigma, random.uniform(0.05, 0.5, n), random.uniform(0.1, 2.0, n))
    detour = np.where(random.random(n) < 0.3, random.uniform(0.3, 3.0, n), 0.0)
    distance = predicted(PLACE_I, PLACE_J, ranges) + sigma * random.normal(size=n) + detour + offset
    return ranges._replace(distance=distance)


def up_of_places() -> list[float]:
    """The derivatives of the keyframes' height difference by HEIGHTS."""
    s_i, s_j = float(np.exp(PLACE_I[8])), float(np.exp(PLACE_J[8]))
    return [1.0, s_i, s_i * PLACE_I[7], -1.0, -s_j, -s_j * PLACE_J[7]]


def ends(i: Array = PLACE_I, j: Array = PLACE_J) -> tuple[Array, Array]:
    """Both poses (2, 8) and calibrations (2, 3)."""
    return np.array([i[:8], j[:8]]), np.array([i[8:], j[8:]])


def square_root(ranges: Measured, loss: Loss, annealing: float = 1.0) -> tuple[Array, Array]:
    """A (r, 22) and b (r,)."""
    root = ranges.slot().square_root(*ends(), loss, annealing)
    assert root.shape[1] == 23
    assert len(root) <= 15
    return root[:, :-1], root[:, -1]


def test_residuals_are_predicted_minus_measured_one_by_one() -> None:
    ranges = measured(50)
    expected = predicted(PLACE_I, PLACE_J, ranges) - ranges.distance
    np.testing.assert_allclose(ranges.slot().residuals(*ends()), expected, atol=1e-12)
    assert len(ranges.slot()) == 50


@annealings
def test_the_cost_takes_each_loss_as_often_as_it_is_worth(loss: Loss, annealing: float) -> None:
    ranges = measured(60)
    _, (rho, _, _) = losses(ranges, loss, annealing)
    assert ranges.slot().cost(*ends(), loss, annealing) == pytest.approx(ranges.range_weight @ rho, rel=1e-12)


@annealings
@offsets
def test_the_rows_hold_the_gradient_of_the_cost_exactly(loss: Loss, annealing: float, offset: float) -> None:
    ranges = measured(60, offset)
    e, (_, weight, _) = losses(ranges, loss, annealing)
    A, b = square_root(ranges, loss, annealing)
    expected = rows(ranges).T @ (ranges.range_weight * weight * e / ranges.sigma)
    np.testing.assert_allclose(A.T @ b, expected, atol=1e-8 * np.abs(A.T @ b).max())


@annealings
@offsets
def test_the_rows_hold_the_documented_information(loss: Loss, annealing: float, offset: float) -> None:
    ranges = measured(60, offset)
    e, (_, weight, curvature) = losses(ranges, loss, annealing)
    J = rows(ranges)
    kept = ranges.range_weight * np.maximum(curvature, 0.1 * weight) / ranges.sigma**2
    between = antennas(PLACE_I, ranges.i) - antennas(PLACE_J, ranges.j)
    length = np.linalg.norm(between, axis=1)
    height_curvature = ranges.range_weight * weight * e / ranges.sigma * (1.0 - (between[:, 2] / length) ** 2) / length
    up = np.zeros(22)
    up[HEIGHTS] = up_of_places()
    expected = J.T @ (kept[:, None] * J) + max(height_curvature.sum(), 0.0) * np.outer(up, up)
    A, _ = square_root(ranges, loss, annealing)
    np.testing.assert_allclose(A.T @ A, expected, atol=1e-8 * np.abs(expected).max())


@pytest.mark.parametrize("height_curvature", [0.0, 7.0])
def test_bending_that_is_handed_in_stands_for_the_pairs_own(height_curvature: float) -> None:
    slot, up = measured(60, 0.6).slot(), np.zeros(22)
    up[HEIGHTS] = up_of_places()
    given, none = (slot.square_root(*ends(), LATE, height_curvature=np.array([b])) for b in (height_curvature, -1.0))
    expected = none[:, :-1].T @ none[:, :-1] + height_curvature * np.outer(up, up)
    np.testing.assert_allclose(given[:, :-1].T @ given[:, :-1], expected, atol=1e-8 * np.abs(expected).max())
    np.testing.assert_allclose(given[:, :-1].T @ given[:, -1], none[:, :-1].T @ none[:, -1], atol=1e-6)


@pytest.mark.parametrize("n", [1, 2, 9, 10, 11, 511, 512, 513, 512 * 3 + 1])
def test_any_number_of_ranges_is_squeezed_alike(n: int) -> None:
    ranges = measured(n)._replace(distance=measured(n).distance + 5.0)  # far too long: no height is bent
    e = (predicted(PLACE_I, PLACE_J, ranges) - ranges.distance) / ranges.sigma
    whitened = np.sqrt(ranges.range_weight)[:, None] * np.column_stack([rows(ranges) / ranges.sigma[:, None], e])
    found = ranges.slot().square_root(*ends(), Squared())
    expected = whitened.T @ whitened
    np.testing.assert_allclose(found.T @ found, expected, atol=1e-12 * np.abs(expected).max())


def test_who_is_called_i_does_not_matter(loss: Loss) -> None:
    ranges = measured(60)
    swapped = ranges._replace(i=ranges.j, j=ranges.i).slot()
    assert swapped.cost(*ends(PLACE_J, PLACE_I), loss) == pytest.approx(ranges.slot().cost(*ends(), loss), rel=1e-12)
    A, b = square_root(ranges, loss)
    root = swapped.square_root(*ends(PLACE_J, PLACE_I), loss)
    A_swapped, b_swapped = np.roll(root[:, :-1], 11, axis=1), root[:, -1]
    np.testing.assert_allclose(A_swapped.T @ A_swapped, A.T @ A, atol=1e-11 * np.abs(A.T @ A).max())
    np.testing.assert_allclose(A_swapped.T @ b_swapped, A.T @ b, atol=1e-10 * np.abs(A.T @ A).max())


def test_a_slot_keeps_its_own_copy_of_the_ranges() -> None:
    ranges = measured(5)
    slot = ranges.slot()
    before = slot.residuals(*ends())
    for column in (*ranges.i, *ranges.j, *ranges[2:]):
        column += 1.0
    np.testing.assert_array_equal(slot.residuals(*ends()), before)


GOOD = measured(3)
SHORT, POINTS, NANS = np.ones(2), np.zeros((3, 3)), np.full((3, 3), np.nan)
NO_POINTS = (np.zeros((0, 3)),) * 3
BROKEN = {
    "no range at all": (Measured(NO_POINTS, NO_POINTS, *np.zeros((4, 0))), "at least one"),
    "an offset missing": (GOOD._replace(i=(np.zeros((2, 3)), POINTS, POINTS)), "antenna"),
    "a lever missing": (GOOD._replace(j=(POINTS, np.zeros((2, 3)), POINTS)), "levers and velocities must be"),
    "a velocity missing": (GOOD._replace(i=(POINTS, POINTS, np.zeros((2, 3)))), "levers and velocities must be"),
    "an offset of NaN": (GOOD._replace(j=(NANS, POINTS, POINTS)), "finite"),
    "a lever of NaN": (GOOD._replace(i=(POINTS, NANS, POINTS)), "levers and velocities must be finite"),
    "a velocity of infinity": (GOOD._replace(j=(POINTS, POINTS, POINTS + np.inf)), "must be finite"),
    "a distance missing": (GOOD._replace(distance=SHORT), "antenna"),
    "a distance of NaN": (GOOD._replace(distance=np.full(3, np.nan)), "finite"),
    "a sigma missing": (GOOD._replace(sigma=SHORT), "sigma"),
    "a sigma of zero": (GOOD._replace(sigma=np.array([0.1, 0.0, 0.1])), "sigma must be positive"),
    "odds missing": (GOOD._replace(nlos_odds=SHORT), "nlos_odds"),
    "negative odds": (GOOD._replace(nlos_odds=np.array([0.1, -0.1, 0.1])), "nlos_odds must not be negative"),
    "a weight missing": (GOOD._replace(range_weight=SHORT), "range_weight"),
    "a weight of zero": (GOOD._replace(range_weight=np.array([1.0, 0.0, 1.0])), "range_weight"),
    "a negative weight": (GOOD._replace(range_weight=np.array([1.0, -1.0, 1.0])), "range_weight"),
    "a weight of NaN": (GOOD._replace(range_weight=np.array([1.0, np.nan, 1.0])), "range_weight"),
    "a weight of infinity": (GOOD._replace(range_weight=np.array([1.0, np.inf, 1.0])), "range_weight"),
}


@pytest.mark.parametrize("fault", BROKEN)
def test_a_slot_refuses(fault: str) -> None:
    ranges, message = BROKEN[fault]
    with pytest.raises(ValueError, match=message):
        ranges.slot()


@pytest.mark.parametrize("antenna", [np.zeros((3, 2)), np.zeros(3)])
def test_antennas_have_three_coordinates(antenna: Array) -> None:
    with pytest.raises(TypeError):
        GOOD._replace(i=(antenna, antenna, antenna)).slot()


@pytest.mark.parametrize("annealing", [0.5, np.nan, np.inf])
def test_a_loss_is_never_narrower_than_it_is(annealing: float) -> None:
    with pytest.raises(ValueError, match="annealing"):
        GOOD.slot().cost(*ends(), Squared(), annealing)
    with pytest.raises(ValueError, match="annealing"):
        GOOD.slot().square_root(*ends(), Squared(), annealing)


def test_ranges_are_judged_one_by_one() -> None:
    random = np.random.default_rng(2)
    e, sigma, odds = random.normal(0.0, 4.0, 80), random.uniform(0.05, 0.3, 80), random.uniform(0.0, 2.0, 80)
    cost, weight, inlier_probability = mixture_terms(e, sigma, odds, LATE)
    alone = np.array([LATE(*of_range) for of_range in zip(e, sigma, odds, strict=True)])
    np.testing.assert_allclose(np.column_stack([cost, weight]), alone[:, :2], rtol=1e-14, atol=1e-15)
    stray = np.where(e < 0.0, odds, LATE.early_odds) * reference.stray_density(e, sigma, LATE.scale)
    density = reference.honest_density(e, sigma)
    np.testing.assert_allclose(inlier_probability, density / (density + stray), rtol=1e-12)


def test_columns_that_are_judged_are_of_one_length() -> None:
    for lengths in ((3, 2, 3), (3, 3, 2), (2, 3, 3)):
        with pytest.raises(ValueError, match="all columns"):
            mixture_terms(*(np.ones(n) for n in lengths), LATE)
    assert [len(column) for column in mixture_terms(*np.zeros((3, 0)), LATE)] == [0, 0, 0]
