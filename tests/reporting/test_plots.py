from __future__ import annotations

import shutil
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import ArrowStyle, Ellipse, FancyArrowPatch
from matplotlib.text import Text
from matplotlib.transforms import Bbox

from synchronizar.data.jump import Jump
from synchronizar.data.ranges import Ranges
from synchronizar.data.recording import Recording
from synchronizar.data.registration import (
    Alternative,
    CalibrationSigma,
    RangeVerdicts,
    Registration,
    State,
    UserRegistration,
)
from synchronizar.data.track import Track
from synchronizar.errors import InputError
from synchronizar.estimation.register import register
from synchronizar.geometry import YawFrame
from synchronizar.io.registration_folder import write_registration
from synchronizar.parameters import Parameters
from synchronizar.quaternions import yaw_quaternion
from synchronizar.reporting.answer import Answer, read_answer
from synchronizar.reporting.drift import common_from_user_at_start, drift_of
from synchronizar.reporting.pairs import pairs
from synchronizar.reporting.plots import draw, draw_devices, plot
from synchronizar.reporting.plots.estimates import MOST_ROWS, draw_estimates, kinds
from synchronizar.reporting.plots.jump_list import MOST_JUMPS, draw_jumps
from synchronizar.reporting.plots.pairs import MOST_PAIRS, draw_pair
from synchronizar.reporting.plots.residuals import residual_limits
from synchronizar.reporting.plots.style import JUMP, caption, short, styles
from synchronizar.reporting.plots.walks import MOST_RANGES
from synchronizar.reporting.uncertainty import CHI2_95_OF_TWO, axes_of, jacobian, plane_covariance
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate

FULL: dict[str, Any] = {"model": "full"}
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def recording() -> Recording:
    return simulate(Scene(users=3, late_share=0.3, static_radios=1, seed=3)).recording


@pytest.fixture(scope="module")
def registration(recording: Recording) -> Registration:
    return register(recording, model="rigid")


@pytest.fixture(scope="module")
def written(recording: Recording, registration: Registration, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("answer")
    write_registration(registration, recording, folder)
    return folder


@pytest.fixture(scope="module")
def drifting() -> Recording:
    """SLAM that drifts and jumps, with wrong scales, clocks and biases."""
    scene = Scene(
        seconds=15.0,
        jumps=1,
        static_radios=1,
        drift_m_per_sqrt_s=0.02,
        drift_rad_per_sqrt_s=0.01,
        scale_sigma=0.1,
        bias_sigma=0.05,
        clock_offset_sigma=0.05,
    )
    return simulate(scene).recording


@pytest.fixture(scope="module")
def corrected(drifting: Recording) -> Registration:
    return register(drifting, model="full")


@pytest.fixture
def folder(written: Path, tmp_path: Path) -> Path:
    """A copy of the answer, to be spoilt."""
    return Path(shutil.copytree(written, tmp_path / "answer"))


def track(*places: tuple[float, float, float]) -> Track:
    return Track(np.arange(len(places), dtype=float), np.array(places), np.tile(UPRIGHT, (len(places), 1)))


def answer_of(*users: UserRegistration, **of_registration: Any) -> Answer:
    """Of users that each walk from their origin 2 m along their own x, and range once a second to the first."""
    n = 3 * (len(users) - 1)
    who = np.repeat(np.arange(1, len(users), dtype=np.int32), 3)
    ranges = Ranges.of(np.tile(np.arange(3.0), len(users) - 1), np.zeros(n, dtype=np.int32), who, np.ones(n))
    verdicts = RangeVerdicts(np.ones(n, dtype=bool), np.ones(n, dtype=bool), np.full(n, 100.0), np.zeros(n))
    tracks = {}
    for user in users:
        if user.common_from_user is not None:
            places = track((0, 0, 0)) if user.static else track((0, 0, 0), (1, 0, 0), (2, 0, 0))
            tracks[user.name] = replace(places, position=user.common_from_user @ places.position)
    settings: dict[str, Any] = {"model": "rigid", "method": "joint", "alternatives": (), "seconds": {}}
    registration = Registration(
        reference=users[0].name,
        users={user.name: user for user in users},
        ranges=verdicts,
        **(settings | of_registration),
    )
    slam = {user.name: track((0, 0, 0), (1, 0, 0), (2, 0, 0)) for user in users if not user.static}
    return Answer(registration, tracks, slam, ranges)


def placed(name: str, state: State = State.REGISTERED, **of_user: Any) -> UserRegistration:
    settings: dict[str, Any] = {
        "common_from_user": YawFrame(3.0, 1.0, 0.0, np.pi / 2.0),
        "covariance": np.diag([4e-4] * 3 + [1e-2]),
    }
    return UserRegistration(name, state, "", **(settings | of_user))


REFERENCE = placed("alice", common_from_user=YawFrame(), covariance=np.zeros((4, 4)))


# What register wrote


def test_written_residuals_are_what_the_written_tracks_leave_of_the_ranges(recording: Recording, written: Path) -> None:
    answer = read_answer(written, recording)
    rows = np.flatnonzero(answer.registration.ranges.usable)
    ends = answer.ends(rows)
    predicted = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    residual = recording.ranges.distance[rows] - predicted
    # Frames are the mean over minima that are all but the same, residuals those of the best one.
    np.testing.assert_allclose(answer.registration.ranges.residual[rows], residual, atol=0.02)


def test_a_device_is_looked_up_by_its_own_clock() -> None:
    answer = answer_of(REFERENCE, placed("bob", common_from_user=YawFrame(), clock_offset=0.5))
    ends = answer.ends(np.array([0, 1, 2]))
    np.testing.assert_allclose(ends[:, 0, 0], [0.0, 1.0, 2.0])
    np.testing.assert_allclose(ends[:, 1, 0], [0.5, 1.5, np.nan])
    assert answer_of(REFERENCE, placed("radio", static=True, clock_offset=None)).clock_offset("radio") == 0.0


# What was corrected


def turned(*yaws: float) -> Track:
    """A device that stands at its origin and turns."""
    return replace(track(*[(0, 0, 0)] * len(yaws)), quat_xyzw=np.array([yaw_quaternion(yaw) for yaw in yaws]))


def corrected_answer(bob: UserRegistration, of_bob: Track, slam: Track) -> Answer:
    answer = answer_of(REFERENCE, bob, **FULL)
    return replace(answer, tracks={**answer.tracks, "bob": of_bob}, slam={**answer.slam, "bob": slam})


def test_slams_own_track_is_laid_where_the_corrected_one_starts() -> None:
    # SLAM walks 2 m along its x; bob in truth began at (5, 5, 1) facing y, in steps of twice that, and then turned.
    bob = placed("bob", common_from_user=YawFrame(-7.0, 3.0, 0.0, 2.0, scale=2.0))
    of_bob = Track(
        np.arange(3.0),
        np.array([[5.0, 5.0, 1.0], [5.0, 7.0, 1.0], [3.0, 7.0, 1.0]]),
        np.array([yaw_quaternion(yaw) for yaw in (np.pi / 2.0, np.pi / 2.0, np.pi)]),
    )
    answer = corrected_answer(bob, of_bob, track((1, 0, 0), (2, 0, 0), (3, 0, 0)))
    drift = drift_of(answer, "bob")
    np.testing.assert_allclose(drift.uncorrected.position, [[5, 5, 1], [5, 7, 1], [5, 9, 1]], atol=1e-12)
    np.testing.assert_allclose(drift.distance, [0.0, 0.0, np.sqrt(8.0)], atol=1e-12)
    np.testing.assert_allclose(drift.turn, [0.0, 0.0, np.pi / 2.0], atol=1e-12)


@given(
    frame=st.builds(YawFrame, *[st.floats(-10.0, 10.0)] * 3, st.floats(-3.0, 3.0), st.floats(0.5, 2.0)),
    yaws=st.lists(st.floats(-3.0, 3.0), min_size=2, max_size=5),
)
def test_a_track_that_was_moved_as_a_whole_was_not_corrected(frame: YawFrame, yaws: list[float]) -> None:
    slam = replace(turned(*yaws), position=np.arange(3.0 * len(yaws)).reshape(-1, 3))
    of_bob = replace(slam, position=frame @ slam.position, quat_xyzw=frame.rotate_quaternions(slam.quat_xyzw))
    answer = corrected_answer(placed("bob", common_from_user=frame), of_bob, slam)
    found = common_from_user_at_start(answer, "bob")
    np.testing.assert_allclose(found.matrix, frame.matrix, atol=1e-9)
    drift = drift_of(answer, "bob")
    np.testing.assert_allclose(drift.distance, 0.0, atol=1e-9)
    np.testing.assert_allclose(drift.turn, 0.0, atol=1e-9)


def test_a_heading_that_drifts_beyond_half_a_turn_goes_on() -> None:
    yaws = np.linspace(0.0, 3.0 * np.pi, 20)
    answer = corrected_answer(placed("bob"), turned(*yaws), turned(*np.zeros(20)))
    np.testing.assert_allclose(drift_of(answer, "bob").turn, yaws, atol=1e-9)


def test_time_is_counted_on_the_clock_of_the_ranges() -> None:
    answer = answer_of(REFERENCE, placed("bob", clock_offset=100.0))
    np.testing.assert_array_equal(answer.elapsed("bob", np.array([100.0, 101.5])), [0.0, 1.5])
    alone = answer_of(replace(REFERENCE, clock_offset=7.0))
    np.testing.assert_array_equal(alone.elapsed("alice", np.array([0.0, 2.0])), [0.0, 2.0])


# How sure it is


@given(
    frame=st.builds(YawFrame, *[st.floats(-10.0, 10.0)] * 3, st.floats(-3.0, 3.0)),
    point=st.tuples(*[st.floats(-10.0, 10.0)] * 3),
)
def test_a_place_moves_with_its_frame_as_differences_say(frame: YawFrame, point: tuple[float, float, float]) -> None:
    user, step = placed("bob", common_from_user=frame), 1e-6
    numerical = [
        (replace(frame, **{name: getattr(frame, name) + step}) @ point - frame @ point) / step
        for name in ("x", "y", "z", "yaw")
    ]
    np.testing.assert_allclose(jacobian(user, frame @ point).T, numerical, atol=1e-4)


def test_uncertainty_grows_across_the_line_to_the_origin() -> None:
    # 2 m along the common y from the origin: 0.1 rad is 0.2 m along x.
    bob = placed("bob")
    np.testing.assert_allclose(plane_covariance(bob, np.array([3.0, 1.0, 0.0])), np.diag([4e-4, 4e-4]), atol=1e-12)
    np.testing.assert_allclose(
        plane_covariance(bob, np.array([3.0, 3.0, 0.0])), np.diag([4e-4 + 0.04, 4e-4]), atol=1e-12
    )


def test_a_static_radio_is_as_sure_as_its_place() -> None:
    covariance = np.full((4, 4), np.nan)
    covariance[:3, :3] = np.diag([1.0, 2.0, 3.0])
    radio = placed("radio", static=True, covariance=covariance)
    np.testing.assert_array_equal(plane_covariance(radio, np.array([3.0, 1.0, 0.0])), np.diag([1.0, 2.0]))


def test_the_axes_of_an_ellipse_are_found_and_hold_95_percent() -> None:
    c, s = np.cos(0.5), np.sin(0.5)
    turn = np.array([[c, -s], [s, c]])
    sigmas, angle = axes_of(turn @ np.diag([25.0, 1.0]) @ turn.T)
    np.testing.assert_allclose(sigmas, [5.0, 1.0])
    assert np.tan(angle) == pytest.approx(np.tan(0.5))
    draws = np.random.default_rng(0).normal(size=(100_000, 2))
    assert (np.sum(draws**2, axis=1) < CHI2_95_OF_TWO).mean() == pytest.approx(0.95, abs=0.003)


# Who is who


def test_captions_say_the_state_and_how_sure_it_is() -> None:
    radio = placed("radio", static=True, common_from_user=YawFrame(1.0, 1.0, 1.0))
    answer = answer_of(
        REFERENCE,
        placed("bob"),
        placed("carol", State.UNOBSERVABLE, covariance=np.diag([4e-4] * 3 + [4.0])),
        placed("dave", State.AMBIGUOUS),
        UserRegistration("erin", State.DISCONNECTED, "", None, None),
        radio,
        alternatives=tuple(Alternative(cost, {"dave": YawFrame(cost)}) for cost in (0.0, 1.0, 2.0)),
    )
    assert [caption(answer, name) for name in answer.names] == [
        "alice: the reference",
        "bob: registered ±0.20 m ±5.7°",
        "carol: unobservable ±4.00 m, yaw unknown",
        "dave: ambiguous (3 fit) ±0.20 m ±5.7°",
        "erin: disconnected",
        "radio: registered ±0.02 m",
    ]


def test_thirty_walkers_are_drawn_each_in_a_way_of_their_own() -> None:
    answer = answer_of(REFERENCE, *(placed(f"bob{k:02}") for k in range(30)), placed("radio", static=True))
    of_user = styles(answer)
    walkers = [of_user[name] for name in answer.names[:-1]]
    assert len(set(walkers)) == 31
    assert len({style.colour for style in walkers[:9]}) == 9
    assert of_user["radio"].colour not in {style.colour for style in walkers}


def test_a_long_name_is_cut() -> None:
    assert short("bob") == "bob"
    assert short("b" * 50) == "b" * 15 + "…"


# The picture


def texts(figure: Figure) -> set[str]:
    return {text.get_text() for ax in figure.axes for text in ax.texts}


def test_a_picture_is_written_beside_the_answer_and_nothing_else_is_touched(recording: Recording, folder: Path) -> None:
    before = {file.name: file.read_bytes() for file in folder.iterdir()}
    (file,) = plot(recording, folder, "walk")
    assert file == folder / "picture.png"
    assert file.read_bytes().startswith(b"\x89PNG\r\n")
    assert file.stat().st_size > 50_000
    assert before == {other.name: other.read_bytes() for other in folder.iterdir() if other != file}


def test_a_picture_that_cannot_be_written_is_told(recording: Recording, folder: Path) -> None:
    (folder / "picture.png").mkdir()
    with pytest.raises(InputError, match=r"picture\.png: Is a directory$"):
        plot(recording, folder, "walk")


def test_every_range_is_in_the_histogram_or_counted_as_further_out(recording: Recording, written: Path) -> None:
    answer = read_answer(written, recording)
    residual = answer.registration.ranges.residual.copy()
    residual[np.flatnonzero(answer.registration.ranges.usable)[:3]] = 500.0
    answer = replace(
        answer, registration=replace(answer.registration, ranges=replace(answer.registration.ranges, residual=residual))
    )
    histogram = draw(answer, "walk").axes[-1]
    shown = sum(bar.get_height() for bar in histogram.containers[0])
    low, high = residual_limits(answer, 0.1)
    outside = int(((residual < low) | (residual > high)).sum())
    verdicts = answer.registration.ranges
    assert outside >= 3
    assert f"({outside} further out)" in histogram.get_title()
    assert shown == (verdicts.used & (residual >= low) & (residual <= high)).sum()


def test_the_map_has_every_name_and_some_of_the_ranges(recording: Recording, written: Path) -> None:
    answer = read_answer(written, recording)
    top = draw(answer, "walk").axes[0]
    assert {text.get_text() for text in top.texts} == {"phone0", "phone1", "phone2", "radio0"}
    used, rejected = (lines for lines in top.collections if isinstance(lines, LineCollection))
    assert len(used.get_segments()) + len(rejected.get_segments()) == MOST_RANGES
    assert len(used.get_segments()) > len(rejected.get_segments()) > 0
    assert top.get_aspect() == 1.0
    assert sum(isinstance(artist, Ellipse) for artist in top.artists + list(top.patches)) == 7


@pytest.mark.parametrize("scale", [1.0, 2.0])
def test_the_other_placements_of_an_ambiguous_user_are_drawn(scale: float) -> None:
    alternatives = (
        Alternative(0.0, {"alice": YawFrame(), "bob": YawFrame(3.0, 1.0, 0.0, np.pi / 2.0)}),
        Alternative(0.5, {"alice": YawFrame(), "bob": YawFrame(3.0, -1.0, 0.0, -np.pi / 2.0)}),
    )
    frame = YawFrame(3.0, 1.0, 0.0, np.pi / 2.0, scale)  # alternatives are of the same scale and do not tell it
    bob = placed("bob", State.AMBIGUOUS, common_from_user=frame)
    answer = answer_of(REFERENCE, bob, alternatives=alternatives)
    dashed = [line for line in draw(answer, "walk").axes[0].lines if line.get_linestyle() == "--"]
    assert len(dashed) == 1
    walk = [[3.0, -1.0], [3.0, -1.0 - scale], [3.0, -1.0 - 2.0 * scale]]
    np.testing.assert_allclose(np.asarray(dashed[0].get_xydata(), dtype=float), walk, atol=1e-12)


@pytest.mark.parametrize(
    ("unseen", "arrows", "words"),
    [
        ([1.0, 0.0, 0.0, 0.0], 1, set()),
        ([0.0, 0.0, 0.0, 1.0], 1, set()),
        ([0.0, 0.0, 1.0, 0.0], 0, {"height unseen"}),
    ],
)
def test_the_direction_that_the_ranges_do_not_see_is_shown(unseen: list[float], arrows: int, words: set[str]) -> None:
    carol = placed("carol", State.UNOBSERVABLE, unseen_direction=np.array(unseen))
    figure = draw(answer_of(REFERENCE, carol), "walk")
    styles_of_arrows = [p.get_arrowstyle() for p in figure.axes[0].patches if isinstance(p, FancyArrowPatch)]
    both_ways = [style for style in styles_of_arrows if isinstance(style, ArrowStyle.CurveFilledAB)]
    assert len(both_ways) == arrows
    assert len(styles_of_arrows) - len(both_ways) == 2  # everybody's own x axis
    assert texts(figure) == {"alice", "carol"} | words


def test_somebody_who_could_be_anywhere_does_not_flood_the_map() -> None:
    carol = placed("carol", State.UNOBSERVABLE, covariance=np.diag([100.0, 100.0, 1.0, 4.0]))
    patches = draw(answer_of(REFERENCE, carol), "walk").axes[0].patches
    assert max(p.get_width() for p in patches if isinstance(p, Ellipse)) == 0.0


@pytest.mark.parametrize("name", ["_hidden", r"$\frac$", "ボブ", "b" * 200, "a&b<c>%s{x}"])
def test_a_user_may_be_called_anything(name: str, tmp_path: Path) -> None:
    figure = draw(answer_of(REFERENCE, placed(name)), name)
    legend = figure.axes[2].get_legend()
    assert legend is not None
    assert [text.get_text().strip() for text in legend.get_texts()] == [
        "alice: the reference",
        f"{short(name)}: registered ±0.20 m ±5.7°",
    ]
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        figure.savefig(tmp_path / "picture.png", dpi=30)


def test_of_very_many_users_the_first_are_listed() -> None:
    answer = answer_of(REFERENCE, *(placed(f"bob{k:02}") for k in range(60)))
    legend = draw(answer, "walk").axes[2].get_legend()
    assert legend is not None
    assert [text.get_text().strip() for text in legend.get_texts()][-2:] == [
        "bob42: registered ±0.20 m ±5.7°",
        "and 17 more",
    ]


def test_no_range_at_all_makes_a_picture_too(tmp_path: Path) -> None:
    simulated = simulate(Scene(users=2, seconds=2.0)).recording
    recording = replace(simulated, ranges=simulated.ranges.select(np.zeros(0, dtype=np.intp)))
    write_registration(register(recording, model="rigid"), recording, tmp_path)
    assert all(file.exists() for file in plot(recording, tmp_path, "walk"))


def test_the_page_of_devices_is_written_where_slam_is_corrected_alone(
    corrected: Registration, drifting: Recording, tmp_path: Path
) -> None:
    write_registration(corrected, drifting, tmp_path)
    assert plot(drifting, tmp_path, "walk") == [tmp_path / "picture.png", tmp_path / "devices.png"]
    assert (tmp_path / "devices.png").read_bytes().startswith(b"\x89PNG\r\n")
    write_registration(replace(corrected, model="rigid"), drifting, tmp_path)
    plot(drifting, tmp_path, "walk")
    assert not (tmp_path / "devices.png").exists()


def uncorrected_lines(top: Axes) -> list[LineCollection]:
    lines = [lines for lines in top.collections if isinstance(lines, LineCollection)]
    return lines[2:]  # after the used and the rejected ranges


def jump_markers(ax: Axes) -> list[tuple[float, float]]:
    return [tuple(xy) for line in ax.lines if line.get_marker() == JUMP for xy in np.asarray(line.get_xydata())]


def test_the_map_has_slams_own_tracks_and_where_it_jumped() -> None:
    bob = placed("bob", clock_offset=-0.5, jumps=(Jump(1.0, 1, 0.5, 0.1, 0.0),))
    radio = placed("radio", static=True, clock_offset=None)
    answer = answer_of(REFERENCE, bob, radio, UserRegistration("zoe", State.DISCONNECTED, "", None, None), **FULL)
    top = draw(answer, "walk").axes[0]
    assert len(uncorrected_lines(top)) == 2
    np.testing.assert_allclose(jump_markers(top), [[3.0, 2.0]])
    assert "1.5 s" in {text.get_text() for text in top.texts}
    rigid = draw(answer_of(REFERENCE, bob, radio), "walk").axes[0]
    assert not uncorrected_lines(rigid)
    assert not jump_markers(rigid)


def test_slam_that_is_lost_does_not_shrink_the_map() -> None:
    slam = track((0, 0, 0), (1e5, 0, 0), (0, 1e5, 0))
    answer = corrected_answer(placed("bob"), track((3, 1, 0), (3, 2, 0), (3, 3, 0)), slam)
    low, high = draw(answer, "walk").axes[0].get_ylim()
    assert high - low < 20.0


def panel() -> Axes:
    return Figure().add_subplot()


def test_drift_is_drawn_over_time_with_its_jumps() -> None:
    bob = placed("bob", common_from_user=YawFrame(), jumps=(Jump(2.0, 2, 1.0, -0.5, 0.0),))
    of_bob = replace(turned(0.0, 0.0, 0.5), position=np.array([[0, 0, 0], [1, 0, 0], [2, 1, 0]], dtype=float))
    answer = corrected_answer(bob, of_bob, track((0, 0, 0), (1, 0, 0), (2, 0, 0)))
    distance, turn = draw_devices(answer, "walk").axes[:2]
    assert jump_markers(distance) == [(2.0, 1.0)]
    np.testing.assert_allclose(jump_markers(turn), [[2.0, np.degrees(0.5)]])
    assert np.asarray(distance.lines[2].get_xydata()).tolist() == [[0.0, 0.0], [1.0, 0.0], [2.0, 1.0]]


def test_estimates_have_bars_of_two_sigma_and_are_hollow_where_the_prior_determines_them() -> None:
    sigma = CalibrationSigma(0.01, 0.02, 0.005)
    bob = placed("bob", clock_offset=0.05, calibration_sigma=sigma, prior_dominated=("clock_offset",))
    alice = replace(REFERENCE, clock_offset=-0.02, calibration_sigma=sigma)
    radio = placed("radio", static=True, clock_offset=None, range_bias=0.1, calibration_sigma=sigma)
    zoe = UserRegistration("zoe", State.DISCONNECTED, "", None, None)
    answer = answer_of(alice, bob, radio, zoe, **FULL)
    scale, bias, clock = (panel() for _ in range(3))
    for ax, kind in zip((scale, bias, clock), kinds(Parameters()), strict=True):
        draw_estimates(ax, answer, kind)
    assert [text.get_text() for text in clock.texts] == ["-20 ±10", "50 ±10", "-", "-"]
    assert [text.get_text() for text in bias.texts] == ["0.000 ±0.040", "0.000 ±0.040", "0.100 ±0.040", "-"]
    assert [text.get_text() for text in scale.texts] == ["1.000 ±0.020", "1.000 ±0.020", "-", "-"]
    circles = [line for line in clock.lines if line.get_marker() == "o"]
    assert [line.get_markerfacecolor() for line in circles] == ["black", "white"]
    bars = [lines.get_segments()[0] for lines in clock.collections if isinstance(lines, LineCollection)]
    np.testing.assert_allclose(bars, [[[-30, 0], [-10, 0]], [[40, 1], [60, 1]]])
    band = clock.patches[0].get_extents().transformed(clock.transData.inverted())
    prior = 2e3 * np.hypot(Parameters().devices.clock_sigma, Parameters().devices.clock_common_sigma)
    np.testing.assert_allclose([band.x0, band.x1], [-prior, prior])


def test_of_jumps_the_table_tells_when_whose_and_how_far() -> None:
    bob = placed("bob", clock_offset=10.0, jumps=(Jump(11.0, 1, 0.5, np.radians(-20.0), np.radians(3.0)),))
    alice = replace(REFERENCE, jumps=(Jump(2.0, 2, 1.0, 0.0, 0.0),))
    answer, ax = answer_of(alice, bob, **FULL), panel()
    draw_jumps(ax, answer, styles(answer))
    cells = [text.get_text() for text in ax.texts][5:]
    assert cells == ["1.0", "bob", "0.50", "-20.0", "3.0", "2.0", "alice", "1.00", "+0.0", "0.0"]


def test_of_very_many_jumps_the_first_are_listed() -> None:
    jumps = tuple(Jump(float(t), 0, 0.5, 0.0, 0.0) for t in range(MOST_JUMPS + 3))
    answer, ax = answer_of(replace(REFERENCE, jumps=jumps), **FULL), panel()
    draw_jumps(ax, answer, styles(answer))
    assert "and 3 more" in {text.get_text() for text in ax.texts}
    assert sum(text.get_text() == "alice" for text in ax.texts) == MOST_JUMPS


def with_residuals(answer: Answer, residual: np.ndarray, used: np.ndarray) -> Answer:
    verdicts = replace(answer.registration.ranges, residual=residual, used=used)
    return replace(answer, registration=replace(answer.registration, ranges=verdicts))


def test_pairs_come_by_the_rms_of_their_used_ranges() -> None:
    answer = answer_of(REFERENCE, placed("bob"), placed("carol"), placed("dave"), **FULL)
    a, b = answer.ranges.a.copy(), answer.ranges.b.copy()
    a[1], b[1] = b[1], a[1]  # either order
    answer = replace(answer, ranges=replace(answer.ranges, a=a, b=b))
    residual = np.array([0.1, 0.1, 9.0, 0.3, -0.3, 0.3, 5.0, 5.0, 5.0])
    used = np.array([True, True, False, True, True, True, False, False, False])
    found = pairs(with_residuals(answer, residual, used))
    assert [(pair.a, pair.b) for pair in found] == [("alice", "dave"), ("alice", "carol"), ("alice", "bob")]
    np.testing.assert_allclose([pair.rms for pair in found], [np.nan, 0.3, 0.1])
    assert [pair.rows.tolist() for pair in found] == [[6, 7, 8], [3, 4, 5], [0, 1, 2]]


def test_a_residual_beyond_the_panel_is_drawn_at_its_edge() -> None:
    answer = with_residuals(
        answer_of(REFERENCE, placed("bob"), **FULL), np.array([0.1, -5.0, 7.0]), np.array([True, False, False])
    )
    ax = panel()
    draw_pair(ax, answer, pairs(answer)[0], (-0.6, 0.6))
    points = [xy for line in ax.lines[1:] for xy in np.asarray(line.get_xydata()).tolist()]
    assert sorted(points) == [[0.0, 0.1], [1.0, -0.6], [2.0, 0.6]]
    assert ax.get_title() == "alice - bob: rms 0.10 m"


def test_of_very_many_devices_the_first_are_listed_and_the_worst_pairs_shown() -> None:
    answer = answer_of(REFERENCE, *(placed(f"bob{k:02}") for k in range(60)), **FULL)
    figure = draw_devices(answer, "walk")
    said = texts(figure)
    assert f"and {61 - MOST_ROWS} more" in said
    assert sum(ax.get_title().startswith("alice - bob") for ax in figure.axes) == MOST_PAIRS
    told = [half.get_suptitle() for half in figure.subfigs]
    assert any(f"the {MOST_PAIRS} pairs of the largest rms, {60 - MOST_PAIRS} more not shown" in text for text in told)


@pytest.mark.parametrize(
    "others",
    [
        (),
        (UserRegistration("bob", State.DISCONNECTED, "", None, None, jumps=(Jump(1.0, 1, 0.5, 0.1, 0.0),)),),
        (placed("bob", static=True, clock_offset=None, calibration_sigma=CalibrationSigma(np.nan, 0.02, np.nan)),),
        *((placed(name),) for name in ("_hidden", r"$\frac$", "ボ" * 50)),
    ],
)
def test_every_answer_has_a_page_of_devices(others: tuple[UserRegistration, ...], tmp_path: Path) -> None:
    answer = answer_of(REFERENCE, *others, **FULL)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        draw_devices(answer, "walk").savefig(tmp_path / "devices.png", dpi=30)


# Twenty devices


def crowd(count: int) -> Answer:
    """Devices that start from a few places very near to each other."""
    users = [placed(f"phone{k:02}", common_from_user=YawFrame(0.2 * (k % 5), 0.2 * (k % 4), 0.0)) for k in range(count)]
    return answer_of(REFERENCE, *users, **FULL)


def boxes(figure: Figure, ax: Axes) -> list[Bbox]:
    """Where the texts of the map stand, without the lines that lead to them, in pixels."""
    figure.canvas.draw()
    renderer = figure.canvas.get_renderer()  # type: ignore[attr-defined]
    return [Text.get_window_extent(text, renderer) for text in ax.texts]


def test_names_of_twenty_devices_overlap_neither_each_other_nor_the_frame() -> None:
    figure = draw(crowd(20), "walk")
    FigureCanvasAgg(figure)
    ax = figure.axes[0]
    found, frame = boxes(figure, ax), ax.get_window_extent()
    assert len(found) == 21
    for n, one in enumerate(found):
        assert frame.x0 <= one.x0 < one.x1 <= frame.x1
        assert not any(one.overlaps(other) for other in found[:n])


def test_the_list_of_twenty_devices_ends_above_the_symbols() -> None:
    figure = draw(crowd(21), "walk")
    FigureCanvasAgg(figure)
    figure.canvas.draw()
    people, symbols_shown = (
        ax.get_legend().get_window_extent() for ax in figure.axes if ax.get_legend() and not ax.axison
    )
    assert people.y0 >= symbols_shown.y1


def test_of_many_devices_slams_own_tracks_are_left_out_of_the_map() -> None:
    dashed = [
        sum(isinstance(lines, LineCollection) and lines.get_zorder() == 2 for lines in ax.collections)
        for ax in (draw(crowd(count), "walk").axes[0] for count in (3, 20))
    ]
    assert dashed == [4, 0]


def test_of_many_devices_each_is_named_where_it_ends_and_its_last_seconds_stand_out() -> None:
    answer = crowd(20)
    ax = draw(answer, "walk").axes[0]
    for name, text in zip(answer.tracks, ax.texts, strict=True):
        np.testing.assert_allclose(text.xy, answer.tracks[name].position[-1, :2])
    strong = [line for line in ax.lines if line.get_linewidth() > 1.0 and line.get_linestyle() != "None"]
    walkers = [track for name, track in answer.tracks.items() if not answer.registration.users[name].static]
    assert len(strong) == len(walkers)
    for line, track in zip(strong, walkers, strict=True):
        assert len(line.get_xdata()) == np.count_nonzero(track.t >= track.t[-1] - 4.0)


def test_names_can_be_read_on_white_in_every_colour() -> None:
    """The contrast that WCAG 2 asks for (AA), by its own formula."""
    for style in styles(crowd(20)).values():
        rgb = np.array([int(style.ink[k : k + 2], 16) / 255.0 for k in (1, 3, 5)])
        linear = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
        assert 1.05 / (linear @ [0.2126, 0.7152, 0.0722] + 0.05) >= 4.45
