from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.solver_scenes import difference, distances, recording_of, rigid_graph, track_of, true_frames

from synchronizar.arrays import Array
from synchronizar.estimation.mirror_images import height_mirrors, reflections
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.range_measurements import RangeMeasurements, range_measurements
from synchronizar.simulation.simulate import Scene, simulate

seeds = st.integers(0, 2**31 - 1)
walks_of = st.sampled_from(["line", "free"])
linkings = st.sampled_from(["all", "star", "chain"])
few = settings(derandomize=True, deadline=None, max_examples=25)


def walks(
    users: int, seed: int, walk: str, links: str = "all", height_bob: float = 0.0
) -> tuple[RangeMeasurements, Array]:
    """Samples, and true frames in that of the first."""
    scene = Scene(users=users, seed=seed, seconds=6.0, walk=(walk,), links=links, height_bob=height_bob)
    simulation = simulate(scene)
    return range_measurements(simulation.recording, Parameters()), true_frames(simulation, "phone0")


@given(users=st.integers(2, 5), seed=seeds, walk=walks_of, links=linkings)
@few
def test_a_reflection_applied_twice_gives_the_start_back(users: int, seed: int, walk: str, links: str) -> None:
    measurements, frames = walks(users, seed, walk, links)
    once = reflections(measurements, frames, 0)
    assert once
    for k, image in enumerate(once):
        np.testing.assert_allclose(difference(reflections(measurements, image, 0)[k], frames), 0.0, atol=1e-9)


@given(users=st.integers(2, 5), seed=seeds, links=linkings)
@few
def test_reflections_keep_all_distances_between_walkers_of_lines(users: int, seed: int, links: str) -> None:
    measurements, frames = walks(users, seed, "line", links)
    true = distances(measurements, frames)
    for image in reflections(measurements, frames, 0):
        # What is taken for the middle and the axis of a walk is those of its samples, which lie on its line.
        np.testing.assert_allclose(distances(measurements, image), true, atol=1e-9)


@given(users=st.integers(2, 5), seed=seeds)
@few
def test_reflections_leave_the_reference_where_it_is(users: int, seed: int) -> None:
    measurements, frames = walks(users, seed, "line")
    for image in reflections(measurements, frames, 0):
        np.testing.assert_array_equal(image[0], 0.0)
        assert np.abs(difference(image, frames)).max() > 1e-3


def test_the_image_of_a_walker_in_a_line_is_on_its_other_side_by_hand() -> None:
    t = np.linspace(0.0, 10.0, 41)
    along = track_of(t, np.column_stack([t, 0.0 * t, 0.0 * t]))
    rows = [(float(s), "a", "b", 1.0) for s in t]
    measurements = range_measurements(recording_of({"a": along, "b": along}, rows), Parameters())
    frames = np.array([[0.0, 0.0, 0.0, 0.0], [2.0, 3.0, 0.1, 0.4]])
    (image,) = reflections(measurements, frames, 0)  # with the other's line as the mirror nobody is left to be moved
    np.testing.assert_allclose(image[1], [2.0, -3.0, 0.1, -0.4], atol=1e-9)


def test_in_a_chain_of_lines_each_link_has_an_image_of_its_own() -> None:
    measurements, frames = walks(4, 3, "line", "chain")
    images = reflections(measurements, frames, 0)
    moved = {tuple(np.flatnonzero(np.abs(difference(image, frames)).max(axis=1) > 1e-3).tolist()) for image in images}
    assert {(1, 2, 3), (2, 3), (3,)} <= moved


@given(users=st.integers(2, 5), seed=seeds)
@few
def test_all_heights_turned_over_keep_all_distances_of_level_walks(users: int, seed: int) -> None:
    measurements, frames = walks(users, seed, "free")
    mirrored = height_mirrors(measurements, frames, 0)[-1]
    np.testing.assert_allclose(mirrored[:, 2], -frames[:, 2])
    np.testing.assert_allclose(distances(measurements, mirrored), distances(measurements, frames), atol=1e-12)


@given(users=st.integers(2, 5), seed=seeds)
@few
def test_the_height_of_one_that_ranges_to_one_only_mirrors_by_itself(users: int, seed: int) -> None:
    measurements, frames = walks(users, seed, "free", "star")
    images = height_mirrors(measurements, frames, 0)
    assert len(images) == users + 1
    for u in range(1, users):
        np.testing.assert_allclose(distances(measurements, images[u]), distances(measurements, frames), atol=1e-9)
        np.testing.assert_allclose(np.delete(images[u], u, axis=0), np.delete(frames, u, axis=0))
        assert images[u][u, 2] == pytest.approx(-frames[u, 2])


@given(users=st.integers(2, 4), seed=seeds)
@few
def test_height_mirrors_move_heights_alone_and_leave_the_reference_at_zero(users: int, seed: int) -> None:
    measurements, frames = walks(users, seed, "free", height_bob=0.2)
    for image in height_mirrors(measurements, frames, 0):
        np.testing.assert_array_equal(image[:, [0, 1, 3]], frames[:, [0, 1, 3]])
        assert image[0, 2] == 0.0


def test_users_that_are_not_placed_stay_so() -> None:
    simulation = simulate(Scene(users=3, walk=("line",), seed=2))
    measurements, _ = rigid_graph(simulation.recording)
    frames = true_frames(simulation, "phone0")
    frames[2] = np.nan
    measurements = measurements[(measurements.j != 2).nonzero()[0].astype(np.int32)]
    for image in (*reflections(measurements, frames, 0), *height_mirrors(measurements, frames, 0)):
        np.testing.assert_array_equal(np.isnan(image[:, 0]), [False, False, True])
        assert np.isfinite(image[:2]).all()
