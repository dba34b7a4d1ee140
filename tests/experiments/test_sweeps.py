from __future__ import annotations

from argparse import Namespace
from pathlib import Path

import numpy as np
import pytest

from synchronizar.data.registration import State
from synchronizar.estimation.register import register
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate

pytest.importorskip("scipy", reason="the pairwise method needs scipy")

from experiments.common.full_oracle import last_errors, last_poses, true_tracks
from experiments.common.methods import (
    CLOCKS_TRUSTED,
    EVERY_METHOD,
    METHODS,
    Placed,
    beginning,
    bootstrap,
    median,
    placed,
    points_or_arrows,
    share,
)
from experiments.common.side_by_side import ABREAST_M, side_by_side
from experiments.common.study import Interval, figure
from experiments.sweeps import beside_bound, beside_recordings, ranges_needed
from experiments.sweeps.sweeps import BY_NAME, Task, cells_of, drawn, rows_of, tasks_of, told, walk

EVERYBODY = slice(None)


# ---- people who walk side by side ----


def test_people_in_step_are_as_far_apart_as_they_walk_abreast() -> None:
    simulation = side_by_side(Scene(seed=3, sigma=0.0, height_spread=0.0, height_bob=0.0), stray=0.0)
    assert len(simulation.recording.ranges) > 100
    np.testing.assert_allclose(simulation.recording.ranges.distance, ABREAST_M, atol=1e-12)


def test_a_height_between_people_in_step_lengthens_every_distance_by_pythagoras() -> None:
    simulation = side_by_side(Scene(seed=3, sigma=0.0, height_bob=0.0), stray=0.0)
    one, other = (track.position[0, 2] for track in simulation.truth.values())
    assert abs(one - other) > 0.01
    np.testing.assert_allclose(simulation.recording.ranges.distance, np.hypot(ABREAST_M, one - other), atol=1e-12)


def test_distances_of_people_who_stray_are_those_of_their_frames_at_the_stamps() -> None:
    simulation = side_by_side(Scene(seed=4, sigma=0.0), stray=0.5)
    recording, t = simulation.recording, simulation.recording.ranges.t
    places = [
        simulation.world_from_user[name] @ np.column_stack([np.interp(t, track.t, p) for p in track.position.T])
        for name, track in recording.tracks.items()
    ]
    np.testing.assert_allclose(recording.ranges.distance, np.linalg.norm(places[0] - places[1], axis=1), atol=1e-9)
    assert np.ptp(recording.ranges.distance) > 0.3


def test_who_strays_is_never_further_from_the_place_abreast_than_the_amplitude() -> None:
    simulation = side_by_side(Scene(seed=5), stray=0.2)
    first, second = simulation.truth.values()
    in_step = side_by_side(Scene(seed=5), stray=0.0).truth["phone1"]
    astray = np.abs(second.position - in_step.position)
    assert astray[:, :2].max() <= 0.2 + 1e-12
    assert astray[:, :2].max() > 0.1
    np.testing.assert_array_equal(astray[:, 2], 0.0)
    np.testing.assert_array_equal(first.t, second.t)


def test_a_second_user_of_side_by_side_begins_at_its_own_origin() -> None:
    own = side_by_side(Scene(seed=6), stray=0.3).recording.tracks["phone1"]
    np.testing.assert_allclose(own.position[0], 0.0, atol=1e-12)


def test_people_in_step_are_registered_by_the_paper_and_unobservable_by_ours() -> None:
    done = walk(Task("side_by_side", 0.0, 0))
    assert {method: of.states for method, of in done.items()} == {
        "pairwise": [State.REGISTERED],
        "rigid": [State.UNOBSERVABLE],
        "joint": [State.UNOBSERVABLE],
    }


def test_who_strays_by_a_metre_is_registered_by_all() -> None:
    done = walk(Task("side_by_side", 1.0, 0))
    assert all(of.states == [State.REGISTERED] and of.plane[0] < 0.15 for of in done.values())


# ---- how far off a method is ----


@pytest.mark.parametrize("drift", [0.0, 0.02])
def test_errors_where_slam_is_trusted_are_those_of_the_last_place_in_the_references_last_frame(drift: float) -> None:
    simulation = simulate(Scene(users=3, seconds=20.0, seed=2, drift_rad_per_sqrt_s=drift))
    world, truth = simulation.world_from_user, simulation.truth
    found = placed(simulation.recording, world, "rigid")
    registration = register(simulation.recording, model="rigid")
    for n, name in enumerate(("phone1", "phone2")):
        true = world["phone0"].inverse() @ truth[name].position[-1]
        there = registration.tracks(simulation.recording)[name].position[-1]
        assert found.plane[n] == pytest.approx(np.hypot(*(there - true)[:2]), abs=1e-9)
        assert found.z[n] == pytest.approx(abs(there[2] - true[2]), abs=1e-9)


def test_errors_without_drift_are_those_of_last_poses_in_the_common_frame() -> None:
    simulation = simulate(Scene(users=3, seed=1))
    found = placed(simulation.recording, simulation.world_from_user, "rigid")
    tracks = register(simulation.recording, model="rigid").tracks(simulation.recording)
    error = last_errors(last_poses(tracks), last_poses(true_tracks(simulation, "phone0")), ["phone1", "phone2"])
    np.testing.assert_allclose(found.plane, np.hypot(*error[:, :2].T), atol=1e-9)
    np.testing.assert_allclose(found.yaw, np.abs(error[:, 3]), atol=1e-9)


def test_who_has_no_placement_is_infinitely_far_off() -> None:
    recording = simulate(Scene(users=3, seed=1)).recording
    alone = (recording.ranges.a == 2) | (recording.ranges.b == 2)
    world = simulate(Scene(users=3, seed=1)).world_from_user
    cut = type(recording)(recording.users, recording.tracks, recording.ranges.select(~alone))
    for method in ("pairwise", "rigid"):
        found = placed(cut, world, method)
        assert found.states[1] is State.DISCONNECTED
        assert np.isinf([found.plane[1], found.z[1], found.yaw[1]]).all()
        assert np.isfinite(found.plane[0])


def test_clocks_that_are_trusted_are_left_at_zero_and_cost_accuracy() -> None:
    simulation = simulate(Scene(users=3, seed=0, clock_offset_sigma=0.2))
    registration = EVERY_METHOD[CLOCKS_TRUSTED](simulation.recording)
    assert max(abs(user.clock_offset or 0.0) for user in registration.users.values()) < 1e-3
    with_it, without = (
        placed(simulation.recording, simulation.world_from_user, method).plane.max()
        for method in ("joint", CLOCKS_TRUSTED)
    )
    assert with_it < 0.1 < without


def test_a_beginning_has_the_ranges_before_and_tracks_that_cover_them() -> None:
    recording = simulate(Scene(users=3, seed=1)).recording
    cut = beginning(recording, 5.0)
    assert len(cut.ranges) == np.sum(recording.ranges.t < 5.0)
    for name, track in cut.tracks.items():
        assert 5.0 <= track.t[-1] < 5.0 + 1.0 / 30.0
        np.testing.assert_array_equal(track.position, recording.tracks[name].position[: len(track)])


# ---- intervals ----


def test_a_bootstrap_of_the_median_is_near_the_interval_of_order_statistics() -> None:
    values = np.sort(np.random.default_rng(0).standard_normal(40))
    of = bootstrap(values, median)
    assert of.value == pytest.approx(np.median(values))
    # Binomial(40, 1/2): from the 14th to the 27th is 96 %.
    assert values[11] <= of.low <= values[15]
    assert values[24] <= of.high <= values[28]


def test_infinite_errors_do_not_spoil_an_interval() -> None:
    of = bootstrap(np.array([0.1, 0.2, 0.3, np.inf, np.inf]), median)
    assert of.value == pytest.approx(0.3)
    assert of.low == pytest.approx(0.1)
    assert of.high == np.inf


def test_a_statistic_of_nothing_has_no_interval() -> None:
    assert np.isnan(bootstrap(np.full(5, np.nan), median)).all()


def test_none_of_thirty_is_not_never_and_all_of_thirty_not_always() -> None:
    # The end of an exact interval is the share of which thirty in a row have a chance of 2.5 %.
    chance = 0.025 ** (1.0 / 30.0)
    assert share(np.zeros(30, bool)) == pytest.approx((0.0, 0.0, 1.0 - chance))
    assert share(np.ones(30, bool)) == pytest.approx((1.0, chance, 1.0))
    assert share(np.array([True, True, True, False])).value == 0.75


def test_an_interval_without_an_upper_end_is_drawn_up_to_an_arrow_at_the_top() -> None:
    made, ((ax,),) = figure()
    of = [Interval(1.0, 0.5, 2.0), Interval(2.0, 0.5, np.inf), Interval(np.inf, 3.0, np.inf), Interval(*[np.inf] * 3)]
    points_or_arrows(ax, np.arange(4.0), of, "rigid")
    ax.set_ylim(0.0, 10.0)
    made.draw_without_rendering()
    arrows = next(line for line in ax.lines if line.get_transform() == ax.get_xaxis_transform())
    np.testing.assert_array_equal(arrows.get_xydata(), [[1.0, 1.0], [2.0, 1.0], [3.0, 1.0]])
    bars = [ax.transData.inverted().transform(text.arrow_patch.get_path().vertices[[0, -1]]) for text in ax.texts]
    np.testing.assert_allclose(bars, [[[1.0, 0.5], [1.0, 10.0]], [[2.0, 3.0], [2.0, 10.0]]], atol=1e-6)


# ---- tables and figures ----


def test_walks_are_told_by_medians_of_rms_and_by_shares_of_walks() -> None:
    yes, no = State.REGISTERED, State.UNOBSERVABLE
    walks = [
        Placed(np.array([0.3, 0.4]), np.array([0.0, 0.0]), np.array([0.1, 0.1]), [yes, yes], 1.0),
        Placed(np.array([3.0, 0.0]), np.array([0.0, 0.7]), np.array([0.2, 0.2]), [yes, no], 2.0),
        Placed(np.array([np.inf, 0.1]), np.array([np.inf, 0.1]), np.array([np.inf, 0.1]), [no, yes], 3.0),
    ]
    of = told(walks, EVERYBODY)
    assert of["plane"].value == pytest.approx(3.0 / np.sqrt(2.0))
    assert of["yaw deg"].value == pytest.approx(np.rad2deg(0.2))
    assert of["any off"].value == pytest.approx(2 / 3)  # both of the second walk, one by its height alone
    assert of["any registered, off"].value == pytest.approx(1 / 3)
    assert of["all registered"].value == pytest.approx(1 / 3)
    assert of["any unobservable"].value == pytest.approx(2 / 3)
    assert of["any ambiguous"].value == 0.0
    assert of["seconds"].value == 2.0
    assert told(walks, slice(-1, None))["any off"].value == pytest.approx(1 / 3)


def test_a_sweep_does_every_value_with_every_seed() -> None:
    tasks = tasks_of(BY_NAME["late"], Namespace(full=False, seed=7))
    assert {t.seed for t in tasks} == set(range(7, 12))
    assert len(set(tasks)) == len(tasks) == 5 * 6


@pytest.mark.parametrize("name", BY_NAME)
def test_a_sweep_makes_a_row_of_each_value_and_line(name: str) -> None:
    sweep = BY_NAME[name]
    error = np.full(3, 0.1)
    of = Placed(error, error, error, [State.REGISTERED] * 3, 0.1)
    tasks = [Task(sweep.name, value, 0) for value in sweep.at]
    cells = cells_of(sweep, tasks, [dict.fromkeys(sweep.methods, of)] * len(tasks))
    rows = rows_of(sweep, cells, 1)
    assert len(rows) == len(sweep.at) * len(sweep.methods) * len(sweep.who)
    assert all(row["plane"] == pytest.approx(0.1) and row["all registered"] == 1.0 for row in rows)
    made = drawn(sweep, cells)
    assert len(made.axes) == 6
    assert all(len(ax.containers) == len(cells) for ax in made.axes)


# ---- small, pinned ----


def test_of_late_signals_ours_keeps_what_the_paper_loses() -> None:
    walks = [walk(Task("late", 0.3, seed)) for seed in range(3)]
    pairwise, rigid = (np.array([w[method].plane for w in walks]) for method in ("pairwise", "rigid"))
    assert np.median(rigid) < 0.1
    assert np.median(pairwise) > 3.0 * np.median(rigid)


def test_where_slam_drifts_the_full_model_is_nearer_than_those_that_trust_it() -> None:
    walks = [walk(Task("drift", 1.0, seed)) for seed in range(3)]
    pairwise, rigid, joint = (np.median([w[m].plane for w in walks]) for m in ("pairwise", "rigid", "joint"))
    assert joint < 0.7 * rigid
    assert joint < 0.7 * pairwise


@pytest.mark.parametrize("since", BY_NAME["joiner"].at)
def test_a_late_joiner_comes_twelve_seconds_after_the_others_and_so_long_before_the_end(since: float) -> None:
    simulation = BY_NAME["joiner"].walk(since, 0)
    recording = simulation.recording
    began = [recording.tracks[user.name].t[0] for user in recording.users]
    assert began[-1] == pytest.approx(12.0, abs=0.04)
    assert max(began[:-1]) < 0.04
    assert recording.ranges.t.max() == pytest.approx(12.0 + since, abs=0.2)
    assert len(simulation.late) == len(simulation.extra) == len(recording.ranges)


def test_a_late_joiner_is_the_last_of_the_others() -> None:
    sweep = BY_NAME["joiner"]
    others = np.array(["phone1", "phone2", "phone3"])
    assert others[sweep.who["who came"]].tolist() == ["phone3"]
    assert others[sweep.who["there before"]].tolist() == ["phone1", "phone2"]


# ---- ranges needed ----


def test_what_is_needed_is_the_time_after_which_the_median_stays_good() -> None:
    after = np.array([3.0, 6.0, 12.0, 24.0])
    good_at_once = [[0.1, 0.1, 0.1, 0.1]] * 3
    good_by_chance = [[0.1, 0.3, 0.1, 0.1]] * 3
    never = [[0.3, 0.3, 0.1, 0.3]] * 3
    half = [[9.0, 0.3, 0.1, 0.1], [0.1, 0.1, 0.1, 0.1], [0.2, 0.14, 9.0, 0.0]]
    found = ranges_needed.needed(np.array([good_at_once, good_by_chance, never, half]), after)
    np.testing.assert_array_equal(found, [3.0, 12.0, np.inf, 6.0])


def test_errors_after_the_whole_walk_are_those_of_the_whole_walk() -> None:
    errors = ranges_needed.walk(ranges_needed.Task(4, 1, (3.0, 12.0)))
    simulation = simulate(Scene(users=4, seconds=12.0, seed=1))
    whole = [placed(simulation.recording, simulation.world_from_user, m).plane for m in METHODS]
    np.testing.assert_allclose(errors[:, 1], np.sqrt(np.mean(np.square(whole), axis=1)), rtol=1e-6)
    assert (errors[1:, 1] < 0.1).all()
    assert (errors[:, 0] != errors[:, 1]).all()


# ---- beside the bound ----


def test_maximum_likelihood_and_the_rigid_model_agree_with_the_bound() -> None:
    walks = [beside_bound.walk(beside_bound.Task(4, 12.0, seed)) for seed in range(8)]
    of = beside_bound.told(walks)
    for method in ("likelihood", "rigid"):
        # 48 errors, correlated within a walk: 1 / sqrt(2 * 16) is 18 % of an RMS, three times that
        assert 0.5 < of[method]["plane"].value / of["bound"]["plane"].value < 1.5
    assert of["pairwise"]["plane"].value > 1.5 * of["rigid"]["plane"].value


def test_errors_beside_the_bound_are_of_registered_users_alone() -> None:
    error = np.zeros((4, 2, 4))
    error[:, 0, 0], error[:, 1, 1] = 3.0, 100.0
    of = beside_bound.told([beside_bound.Errors(error, np.array([True, False]))])
    assert of["rigid"]["plane"].value == pytest.approx(3.0)
    nobody = beside_bound.told([beside_bound.Errors(error, np.array([False, False]))] * 2)
    assert np.isnan([nobody[method]["plane"] for method in beside_bound.METHODS]).all()


def test_whom_the_paper_could_not_place_is_left_out_of_the_bound_and_of_all_methods_alike() -> None:
    error = np.ones((4, 2, 4))
    error[:, 1] = 7.0
    error[beside_bound.METHODS.index("pairwise"), 1] = np.nan
    walk_of_both = beside_bound.Errors(error, np.array([True, True]))
    assert walk_of_both.kept.tolist() == [True, False]
    of = beside_bound.told([walk_of_both] * 2)
    assert [of[method]["z"].value for method in beside_bound.METHODS] == [1.0] * 4


# ---- beside recordings ----


def test_a_folder_without_recordings_is_skipped_with_a_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    beside_recordings.main(["--recordings", str(tmp_path)])
    assert capsys.readouterr().out == f"{tmp_path} holds no recordings with truth: skipped\n"


def test_a_recording_is_registered_by_a_method_and_set_beside_its_truth(tmp_path: Path) -> None:
    simulate(Scene(users=3, seed=1)).save(tmp_path / "walk")
    rows = [beside_recordings.row_of(beside_recordings.Task(tmp_path / "walk", method)) for method in METHODS]
    assert [row["method"] for row in rows] == ["pairwise", "rigid", "joint"]
    assert all(row["states"] == "2 registered" and row["missing"] == 0 for row in rows)
    assert rows[1]["joint ate xy"] < 0.1
    assert len(beside_recordings.drawn(rows).axes) == 3
