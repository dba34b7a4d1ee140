from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.reference_kernel import loss_value, rotation

from synchronizar._core import NlosMixture, search_placements
from synchronizar.arrays import Array

LATE = NlosMixture(scale=1.0, early_odds=0.002)
SIGMA, LATE_ODDS, HEIGHT_SIGMA, APART = 0.1, 0.25, 0.15, 0.5
repeatable = settings(derandomize=True, deadline=None, max_examples=40)

seeds = st.integers(0, 2**32 - 1)
yaws = st.floats(-np.pi, np.pi)
offsets = st.floats(-30.0, 30.0)


class Scene(NamedTuple):
    """Points known in the common frame, the user's own antennas, and where its frame truly lies (x, y, z, yaw)."""

    known: Array
    own: Array
    truth: Array

    def distances(self) -> Array:
        return np.asarray(np.linalg.norm(self.known - placed(self.truth, self.own), axis=1))


def placed(placement: Array, own: Array) -> Array:
    """The user's antennas in the common frame."""
    x, y, z, yaw = placement[:4]
    return np.column_stack([own[:, :2] @ rotation(yaw).T + [x, y], own[:, 2] + z])


def search(
    scene: Scene,
    distances: Array | None = None,
    nlos_odds: float = LATE_ODDS,
    height_sigma: float = HEIGHT_SIGMA,
    has_yaw: bool = True,
    **changed: Any,
) -> Array:
    n = len(scene.known)
    measured = scene.distances() if distances is None else distances
    limits = {"apart": APART, "most_candidates": 16, "most_ranges": 128, "most_cost_above": 30.0, **changed}
    return search_placements(
        scene.known,
        scene.own,
        measured,
        np.full(n, SIGMA),
        np.full(n, nlos_odds),
        height_sigma=height_sigma,
        has_yaw=has_yaw,
        loss=LATE,
        **limits,
    )


def cost_of(placement: Array, scene: Scene, measured: Array, height_sigma: float = HEIGHT_SIGMA) -> float:
    """By definition: the losses' sum and half the squared height over its sigma."""
    e = (np.linalg.norm(scene.known - placed(placement, scene.own), axis=1) - measured) / SIGMA
    losses = sum(loss_value(LATE, x, SIGMA, LATE_ODDS)[0] for x in e)
    return float(losses + placement[2] ** 2 / (2.0 * height_sigma**2))


def farthest_off(placement: Array, scene: Scene) -> float:
    """How far (m) the placement puts any antenna from where it truly is."""
    off = placed(placement, scene.own) - placed(scene.truth, scene.own)
    return float(np.linalg.norm(off, axis=1).max())


def wander(random: np.random.Generator, n: int, seconds: float = 30.0) -> Array:
    """Somebody walks about at 1 m/s, turning all the time, an antenna bobbing at 1.2 m or so."""
    dt = seconds / n
    heading = random.uniform(-np.pi, np.pi) + np.cumsum(random.normal(0.0, 0.8 * np.sqrt(dt), n))
    xy = np.cumsum(np.column_stack([np.cos(heading), np.sin(heading)]) * dt, axis=0)
    return np.column_stack([xy, 1.2 + 0.1 * np.sin(np.arange(n))])


def walk_of_two(seed: int, truth: Array, n: int = 100) -> Scene:
    """Two walkers who begin within 6 m of each other, seen from the one at the common origin."""
    random = np.random.default_rng(seed)
    known, own = wander(random, n), wander(random, n)
    own[:, :2] += random.uniform(-6.0, 6.0, 2)
    return Scene(known, own, truth)


def line(n: int, begin: tuple[float, float, float], end: tuple[float, float, float]) -> Array:
    return np.linspace(begin, end, n)


@given(seed=seeds, x=offsets, y=offsets, yaw=yaws)
@repeatable
def test_two_who_wander_are_placed(seed: int, x: float, y: float, yaw: float) -> None:
    scene = walk_of_two(seed, np.array([0.0, 0.0, 0.0, yaw]))
    shifted = scene._replace(known=scene.known + np.array([x, y, 0.0]), truth=np.array([x, y, 0.0, yaw]))
    best = search(shifted)[0]
    assert farthest_off(best, shifted) < 1e-3
    assert abs(np.remainder(best[3] - yaw + np.pi, 2.0 * np.pi) - np.pi) < 1e-3
    assert -np.pi <= best[3] <= np.pi
    assert best[4] < 1e-3


@given(seed=seeds, yaw=yaws)
@repeatable
def test_every_placement_costs_what_it_says(seed: int, yaw: float) -> None:
    scene = walk_of_two(seed, np.array([2.0, -1.0, 0.1, yaw]), n=150)
    measured = scene.distances() + np.random.default_rng(seed).normal(0.0, SIGMA, 150)
    found = search(scene, measured, most_ranges=60)
    assert found.shape[1] == 5
    for placement in found:
        assert placement[4] == pytest.approx(cost_of(placement, scene, measured), rel=1e-9)
    assert (np.diff(found[:, 4]) >= 0.0).all()
    assert found[-1, 4] <= found[0, 4] + 30.0


@given(seed=seeds, yaw=yaws)
@repeatable
def test_the_best_explains_the_ranges_as_well_as_the_truth(seed: int, yaw: float) -> None:
    scene = walk_of_two(seed, np.array([2.0, -1.0, 0.1, yaw]))
    measured = scene.distances() + np.random.default_rng(seed).normal(0.0, SIGMA, 100)
    assert search(scene, measured)[0, 4] <= cost_of(scene.truth, scene, measured) + 1.0


@given(seed=seeds)
@repeatable
def test_placements_lie_apart(seed: int) -> None:
    random = np.random.default_rng(seed)
    known = line(40, (0.0, 0.0, 1.2), (8.0, 0.0, 1.2))
    own = line(40, (0.0, 0.0, 1.2), (random.uniform(0.5, 4.0), random.uniform(-1.0, 1.0), 1.2))
    scene = Scene(known, own, np.array([3.0, 4.0, 0.0, random.uniform(-3.0, 3.0)]))
    found = search(scene, scene.distances() + random.normal(0.0, SIGMA, 40))
    for a in range(len(found)):
        for b in range(a):
            off = placed(found[a], own) - placed(found[b], own)
            assert np.linalg.norm(off, axis=1).max() > 0.5 * APART


def closest_to(image: Array, found: Array, own: Array) -> float:
    """How far (m) any antenna is off the image at the placement that is nearest to it."""
    return min(float(np.linalg.norm(placed(f, own) - image, axis=1).max()) for f in found)


def test_two_who_walk_on_lines_have_a_mirror_image_of_the_same_cost() -> None:
    known = line(60, (0.0, 0.0, 1.2), (8.0, 0.0, 1.2))
    along = np.linspace(0.0, 1.0, 60)[:, None] ** 2  # no steady pace: see the next test
    own = np.array([1.0, 0.5, 1.2]) + along * [3.0, -3.5, 0.0]
    scene = Scene(known, own, np.array([2.0, 3.0, 0.0, 0.7]))
    found = search(scene)
    np.testing.assert_allclose(found[:2, 4], 0.0, atol=1e-3)
    assert len(found) == 2 or found[2, 4] > 1.0
    true_place = placed(scene.truth, own)
    for image in (true_place, true_place * [1.0, -1.0, 1.0]):
        assert closest_to(image, found[:2], own) < 1e-2


def test_two_who_walk_on_lines_at_a_steady_pace_have_four_placements() -> None:
    """Seen from each other they are one steady motion past a point, and that can be mirrored by itself."""
    known = line(60, (0.0, 0.0, 1.2), (8.0, 0.0, 1.2))
    own = line(60, (1.0, 0.5, 1.2), (4.0, -3.0, 1.2))
    scene = Scene(known, own, np.array([2.0, 3.0, 0.0, 0.7]))
    found = search(scene)
    assert len(found) == 4
    np.testing.assert_allclose(found[:, 4], 0.0, atol=1e-3)
    true_place = placed(scene.truth, own)
    relative = true_place - known
    past = relative[-1] - relative[0]
    past /= np.linalg.norm(past)
    mirrored_motion = known + 2.0 * (relative @ past)[:, None] * past - relative  # its height is 0
    for image in (true_place, mirrored_motion):
        for side in (1.0, -1.0):
            assert closest_to(image * [1.0, side, 1.0], found, own) < 1e-2


@given(seed=seeds, yaw=yaws)
@repeatable
def test_a_user_that_stands_still_is_found_whatever_its_yaw(seed: int, yaw: float) -> None:
    known = wander(np.random.default_rng(seed), 100)
    scene = Scene(known, np.tile([2.0, -1.0, 1.2], (100, 1)), np.array([3.0, 1.0, 0.0, yaw]))
    best = search(scene)[0]
    assert farthest_off(best, scene) < 1e-2
    assert best[4] < 1e-3


def test_the_yaws_of_a_user_that_stands_still_are_one_placement() -> None:
    known = wander(np.random.default_rng(5), 100)
    scene = Scene(known, np.tile([2.0, -1.0, 1.2], (100, 1)), np.array([3.0, 1.0, 0.0, 0.3]))
    found = search(scene)
    places = np.array([placed(f, scene.own)[0] for f in found])
    for a in range(len(places)):
        for b in range(a):
            assert np.linalg.norm(places[a] - places[b]) > 0.5 * APART


def level_walk_and_radio(height: float) -> Scene:
    """Somebody wanders on the level, 1.2 m up, and a radio stands still."""
    known = wander(np.random.default_rng(6), 100)
    known[:, 2] = 1.2
    return Scene(known, np.zeros((100, 3)), np.array([4.0, -2.0, height, 0.0]))


@pytest.mark.parametrize("height", [2.6, -0.2, -3.0])
def test_a_static_radio_is_found_and_so_is_its_mirror_image_in_height(height: float) -> None:
    found = search(level_walk_and_radio(height), height_sigma=3.0, has_yaw=False)
    np.testing.assert_array_equal(found[:, 3], 0.0)
    mirrored = 2.0 * 1.2 - height
    for z in (height, mirrored):
        off = np.linalg.norm(found[:2, :3] - [4.0, -2.0, z], axis=1)
        assert off.min() < 2e-2  # the prior pulls a little
    # Nothing but the prior tells the two apart.
    assert abs(found[0, 2]) < abs(found[1, 2])
    prior_ratio = abs(height**2 - mirrored**2) / (2.0 * 3.0**2)
    assert found[1, 4] - found[0, 4] == pytest.approx(prior_ratio, abs=2e-2)


def test_a_walk_over_stairs_tells_a_radio_from_its_mirror_image() -> None:
    scene = level_walk_and_radio(2.6)
    scene.known[:, 2] = np.linspace(1.2, 4.0, 100)
    found = search(scene, height_sigma=3.0, has_yaw=False)
    np.testing.assert_allclose(found[0, :3], scene.truth[:3], atol=2e-2)
    assert len(found) == 1 or found[1, 4] > found[0, 4] + 3.0


@given(seed=seeds, yaw=yaws)
@repeatable
def test_two_in_five_ranges_may_be_late(seed: int, yaw: float) -> None:
    scene = walk_of_two(seed, np.array([2.0, -1.0, 0.0, yaw]), n=150)
    random = np.random.default_rng(seed)
    late = random.permutation(150) < 60
    found = search(scene, scene.distances() + np.where(late, random.uniform(0.5, 4.0, 150), 0.0))
    assert min(farthest_off(placement, scene) for placement in found) < 0.1
    assert farthest_off(found[0], scene) < 0.1


def test_a_single_range_leaves_a_circle() -> None:
    scene = Scene(np.array([[1.0, 2.0, 1.2]]), np.array([[0.5, 0.0, 1.2]]), np.array([4.0, 6.0, 0.0, 1.0]))
    found = search(scene)
    assert len(found) > 1
    on_circle = np.array([np.linalg.norm(placed(f, scene.own) - scene.known) for f in found])
    np.testing.assert_allclose(on_circle, scene.distances()[0], atol=1e-2)
    np.testing.assert_allclose(found[:, 4], 0.0, atol=1e-2)


def test_ranges_that_are_all_one_leave_a_circle_too() -> None:
    known, own = np.tile([1.0, 2.0, 1.2], (50, 1)), np.tile([0.5, 0.0, 1.2], (50, 1))
    found = search(Scene(known, own, np.array([4.0, 6.0, 0.0, 1.0])))
    assert np.isfinite(found).all()
    assert len(found) > 1
    np.testing.assert_allclose(found[:, 4], 0.0, atol=1e-2)


def test_a_user_that_touches_the_known_one_all_along_is_placed() -> None:
    known = wander(np.random.default_rng(7), 80)
    truth = np.array([2.0, -3.0, 0.0, 2.0])
    away = known - [2.0, -3.0, 0.0]
    own = np.column_stack([away[:, :2] @ rotation(2.0), away[:, 2]])
    scene = Scene(known, own, truth)
    np.testing.assert_allclose(scene.distances(), 0.0, atol=1e-12)
    best = search(scene)[0]
    assert np.isfinite(best).all()
    assert farthest_off(best, scene) < 2e-2


def test_a_range_slightly_below_zero_is_no_trouble() -> None:
    scene = Scene(np.zeros((1, 3)), np.zeros((1, 3)), np.zeros(4))
    found = search(scene, np.array([-0.05]))
    assert np.isfinite(found).all()
    np.testing.assert_allclose(found[0, :3], 0.0, atol=SIGMA)


def test_the_same_ranges_give_the_same_answer() -> None:
    scene = walk_of_two(8, np.array([2.0, -1.0, 0.0, 0.5]), n=300)
    measured = scene.distances() + np.random.default_rng(8).normal(0.0, SIGMA, 300)
    np.testing.assert_array_equal(search(scene, measured), search(scene, measured))


def test_candidates_and_costs_are_limited_as_asked() -> None:
    scene = Scene(np.array([[1.0, 2.0, 1.2]]), np.array([[0.5, 0.0, 1.2]]), np.array([4.0, 6.0, 0.0, 1.0]))
    assert len(search(scene, most_candidates=3)) <= 3
    radio = level_walk_and_radio(2.6)  # whose mirror image costs 0.37 more
    assert len(search(radio, height_sigma=3.0, has_yaw=False, most_cost_above=0.1)) == 1
    assert len(search(radio, height_sigma=3.0, has_yaw=False, most_cost_above=1.0)) == 2


@pytest.mark.parametrize(
    "changed",
    [{"height_sigma": 0.0}, {"height_sigma": -1.0}, {"most_candidates": 0}, {"most_ranges": 0}, {"nlos_odds": -1.0}],
    ids=str,
)
def test_what_makes_no_search_is_refused(changed: dict[str, Any]) -> None:
    scene = walk_of_two(10, np.zeros(4), n=5)
    search(scene)
    with pytest.raises(ValueError):
        search(scene, **changed)
    with pytest.raises(ValueError, match="finite"):
        search(scene, np.full(5, np.nan))
    with pytest.raises(ValueError):
        search(scene, np.ones(4))
