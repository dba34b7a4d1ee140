from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.solver_scenes import MEAN_HEIGHT, recording_of, track_of

from synchronizar.arrays import Array
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.data.user import User
from synchronizar.parameters import Parameters
from synchronizar.preprocessing.range_measurements import RangeMeasurements, pairs, range_measurements
from synchronizar.simulation.simulate import Scene, simulate

MODEL = Parameters()
T = np.arange(0.0, 10.5, 0.5)
WALKS = {
    "alice": track_of(T, np.column_stack([T, 0.0 * T, 0.0 * T])),
    "bob": track_of(T, np.column_stack([0.0 * T, 2.0 * T, 0.0 * T + 1.0])),
    "carol": track_of(T, np.column_stack([-T, T, 0.0 * T])),
}
Row = tuple[float, str, str, float]


def measurements(rows: list[Row], **columns: Array) -> RangeMeasurements:
    return range_measurements(recording_of(WALKS, rows, (), **columns), MODEL)


def rows_used(rows: list[Row]) -> list[int]:
    return sorted(measurements(rows).row.tolist())


@pytest.mark.parametrize("t", [-0.001, 10.001, -1e9, 1e9])
def test_a_range_outside_the_track_is_not_usable(t: float) -> None:
    assert rows_used([(5.0, "alice", "bob", 3.0), (t, "alice", "bob", 3.0)]) == [0]


def test_ranges_at_the_very_ends_of_the_track_are_usable() -> None:
    assert rows_used([(0.0, "alice", "bob", 3.0), (10.0, "alice", "bob", 3.0)]) == [0, 1]


def test_a_range_inside_a_gap_of_more_than_a_second_is_not_usable() -> None:
    t = np.array([0.0, 1.0, 2.01, 3.0])
    gappy = WALKS | {"alice": track_of(t, np.zeros((4, 3)))}
    rows = [(s, a, b, 3.0) for s in (0.5, 1.5, 2.01, 2.5) for a, b in (("alice", "bob"), ("bob", "alice"))]
    found = range_measurements(recording_of(gappy, rows), MODEL)
    assert sorted(set(found.t.tolist())) == [0.5, 2.01, 2.5]


@pytest.mark.parametrize("distance", [np.nan, np.inf, -np.inf, 6e6, -6e6, -1.01, 1000.1])
def test_what_cannot_be_a_distance_is_not_usable(distance: float) -> None:
    assert rows_used([(1.0, "alice", "bob", distance), (2.0, "alice", "bob", 3.0)]) == [1]


@pytest.mark.parametrize("distance", [-0.3, 0.0, 999.0])
def test_a_slightly_negative_or_long_range_is_usable(distance: float) -> None:
    assert rows_used([(1.0, "alice", "bob", distance)]) == [0]


def test_repeated_rows_count_once_in_whichever_direction_they_are_told() -> None:
    rows = [(1.0, "alice", "bob", 3.0), (1.0, "bob", "alice", 3.0), (1.0, "alice", "bob", 3.0)]
    assert len(rows_used(rows)) == 1


def test_rows_that_differ_in_time_number_or_devices_all_count() -> None:
    rows = [
        (1.0, "alice", "bob", 3.0),
        (1.0, "alice", "bob", 3.1),
        (1.1, "alice", "bob", 3.0),
        (1.0, "alice", "carol", 3.0),
        (1.0, "carol", "bob", 3.0),
    ]
    assert rows_used(rows) == [0, 1, 2, 3, 4]


def test_the_same_number_by_another_antenna_counts_again() -> None:
    users = [User("alice", antennas={"0": (0.1, 0.0, 0.0), "1": (-0.1, 0.0, 0.0)})]
    rows = [(1.0, "alice", "bob", 3.0), (1.0, "alice", "bob", 3.0)]
    antennas = np.array([0, 1], dtype=np.int32)
    assert len(range_measurements(recording_of(WALKS, rows, users, antenna_a=antennas), MODEL)) == 2


@given(seed=st.integers(0, 2**32 - 1))
@settings(derandomize=True, deadline=None, max_examples=20)
def test_samples_are_sorted_by_pair_and_time_whatever_the_order_of_the_rows(seed: int) -> None:
    random = np.random.default_rng(seed)
    rows = []
    for t in random.uniform(0.0, 10.0, 40):
        a, b = random.choice(sorted(WALKS), 2, replace=False)
        rows.append((float(t), str(a), str(b), float(random.uniform(0.0, 9.0))))
    found = measurements(rows)
    keys = list(zip(found.i.tolist(), found.j.tolist(), found.t.tolist(), strict=True))
    assert keys == sorted(keys)
    assert (found.i < found.j).all()
    names = sorted(WALKS)
    for n, row in enumerate(found.row.tolist()):
        t, a, b, distance = rows[row]
        assert {names[found.i[n]], names[found.j[n]]} == {a, b}
        assert (found.t[n], found.distance[n]) == (t, distance)


def test_pairs_are_the_slices_of_what_belongs_together() -> None:
    found = measurements([(t, a, b, 1.0) for t in (1.0, 2.0) for a, b in (("bob", "carol"), ("bob", "alice"))])
    assert [(p.i, p.j, p.measurements) for p in pairs(found)] == [(0, 1, slice(0, 2)), (1, 2, slice(2, 4))]


def test_where_there_are_no_ranges_there_are_no_pairs() -> None:
    assert len(measurements([])) == 0
    assert list(pairs(measurements([]))) == []


def test_swapped_ends_give_the_same_sample() -> None:
    scene = simulate(Scene(users=3, antennas=2, power=True, seed=4))
    r = scene.recording.ranges
    swapped = replace(r, a=r.b, b=r.a, antenna_a=r.antenna_b, antenna_b=r.antenna_a)
    one, other = (range_measurements(replace(scene.recording, ranges=ranges), MODEL) for ranges in (r, swapped))
    for column in ("i", "j", "t", "p_i", "p_j", "distance", "sigma", "nlos_odds", "row"):
        np.testing.assert_array_equal(getattr(one, column), getattr(other, column))


def test_places_are_interpolated_between_poses_by_hand() -> None:
    found = measurements([(1.25, "bob", "alice", 3.0)])
    np.testing.assert_allclose(found.p_i, [[1.25, 0.0, 0.0]])
    np.testing.assert_allclose(found.p_j, [[0.0, 2.5, 1.0]])


def test_lever_arms_turn_with_the_whole_attitude() -> None:
    """A quarter turn about x takes z to -y; one about y takes x to -z; one about z takes x to y."""
    half = np.sqrt(0.5)
    lever = (0.1, 0.2, 0.3)
    turned = {
        (half, 0.0, 0.0, half): (0.1, -0.3, 0.2),
        (0.0, half, 0.0, half): (0.3, 0.2, -0.1),
        (0.0, 0.0, half, half): (-0.2, 0.1, 0.3),
        (0.5, 0.5, 0.5, 0.5): (0.3, 0.1, 0.2),
    }
    for quat, expected in turned.items():
        held = Track(T, WALKS["bob"].position, np.tile(quat, (len(T), 1)))
        users = [User("bob", antennas={"0": (9.0, 9.0, 9.0), "left": lever})]
        recording = recording_of(
            WALKS | {"bob": held}, [(2.0, "bob", "alice", 3.0)], users, antenna_a=np.array([1], dtype=np.int32)
        )
        np.testing.assert_allclose(
            range_measurements(recording, MODEL).p_j, [np.add([0.0, 4.0, 1.0], expected)], atol=1e-12
        )


def test_a_static_radio_stands_at_its_own_origin_at_any_time() -> None:
    recording = recording_of({"alice": WALKS["alice"], "radio": None}, [(3.0, "radio", "alice", 2.0)])
    found = range_measurements(recording, MODEL)
    np.testing.assert_array_equal(found.p_j, [[0.0, 0.0, 0.0]])
    np.testing.assert_array_equal(found.p_i, [[3.0, 0.0, 0.0]])


def late_share(**columns: float) -> float:
    given_columns = {name: np.array([value]) for name, value in columns.items()}
    odds = float(measurements([(1.0, "alice", "bob", 3.0)], **given_columns).nlos_odds[0])
    return odds / (1.0 + odds)


@pytest.mark.parametrize(
    ("columns", "share"),
    [
        ({}, 0.2),
        ({"nlos": 1.0}, 0.9),
        ({"nlos": 0.0}, 0.05),
        ({"rx_power": -80.0, "fp_power": -86.0}, 0.05),
        ({"rx_power": -80.0, "fp_power": -90.0}, 0.9),
        ({"rx_power": -80.0, "fp_power": -88.0}, 0.475),
        ({"rx_power": -80.0, "fp_power": -87.0}, 0.2625),
        ({"rx_power": -80.0, "fp_power": -80.5}, 0.05),
        ({"rx_power": -80.0, "fp_power": -99.0}, 0.9),
        ({"rx_power": -80.0}, 0.2),
        ({"rx_power": -80.0, "fp_power": -82.0, "nlos": 1.0}, 0.9),
        ({"rx_power": -80.0, "fp_power": -95.0, "nlos": 0.0}, 0.9),
    ],
    ids=str,
)
def test_what_the_radio_tells_says_how_likely_a_range_is_late(columns: dict[str, float], share: float) -> None:
    assert late_share(**columns) == pytest.approx(share)


def test_the_sigma_column_counts_and_the_model_stands_in_where_it_is_silent() -> None:
    found = measurements(
        [(1.0, "alice", "bob", 3.0), (2.0, "alice", "bob", 3.0)],
        sigma=np.array([0.03, np.nan]),
    )
    assert found.sigma.tolist() == [0.03, MODEL.ranges.sigma]


def test_quaternions_of_either_sign_give_the_same_antenna() -> None:
    """q and -q are the same attitude: between the two, nothing may turn."""
    signs = np.where(np.arange(len(T)) % 2, 1.0, -1.0)[:, None]
    users = [User("bob", antennas={"0": (0.1, 0.2, 0.3)})]
    antenna = np.zeros(1, dtype=np.int32)

    def place(track: Track) -> Array:
        recording: Recording = recording_of(
            WALKS | {"bob": track}, [(2.25, "bob", "alice", 3.0)], users, antenna_a=antenna
        )
        return range_measurements(recording, MODEL).p_j

    flipped = Track(T, WALKS["bob"].position, signs * np.tile(MEAN_HEIGHT, (len(T), 1)))
    np.testing.assert_allclose(place(flipped), [[0.1, 4.7, 1.3]], atol=1e-12)
    np.testing.assert_allclose(place(flipped), place(WALKS["bob"]), atol=1e-12)
