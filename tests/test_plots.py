from __future__ import annotations

import json
import shutil
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.patches import ArrowStyle, Ellipse, FancyArrowPatch

from synchronizar import report
from synchronizar.errors import InputError
from synchronizar.geometry import YawFrame
from synchronizar.pipeline import register
from synchronizar.plots import draw, plot
from synchronizar.plots.answer import Answer, read_answer
from synchronizar.plots.residuals import residual_limits
from synchronizar.plots.style import caption, short, styles
from synchronizar.plots.uncertainty import CHI2_95_OF_TWO, axes_of, jacobian, plane_covariance
from synchronizar.plots.walks import MOST_RANGES
from synchronizar.ranges import Ranges
from synchronizar.recording import Recording
from synchronizar.registration import Alternative, RangeVerdicts, Registration, State, UserRegistration
from synchronizar.scene import Scene
from synchronizar.simulate import simulate
from synchronizar.track import Track

UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def recording() -> Recording:
    return simulate(Scene(users=3, late_share=0.3, static_radios=1, seed=3)).recording


@pytest.fixture(scope="module")
def registration(recording: Recording) -> Registration:
    return register(recording)


@pytest.fixture(scope="module")
def written(recording: Recording, registration: Registration, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("answer")
    report.write(registration, recording, folder)
    return folder


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
    return Answer(registration, tracks, dict.fromkeys(registration.users, 0.0), ranges)


def placed(name: str, state: State = State.REGISTERED, **of_user: Any) -> UserRegistration:
    settings: dict[str, Any] = {
        "common_from_user": YawFrame(3.0, 1.0, 0.0, np.pi / 2.0),
        "covariance": np.diag([4e-4] * 3 + [1e-2]),
    }
    return UserRegistration(name, state, "", **(settings | of_user))


REFERENCE = placed("alice", common_from_user=YawFrame(), covariance=np.zeros((4, 4)))


# What register wrote


def test_a_written_answer_reads_back_the_same(registration: Registration, recording: Recording, written: Path) -> None:
    answer = read_answer(written, recording)
    assert report.registration_json(answer.registration) == report.registration_json(registration)
    for name in ("usable", "used", "weight", "residual"):
        np.testing.assert_array_equal(getattr(answer.registration.ranges, name), getattr(registration.ranges, name))
    for name, in_common in registration.tracks(recording).items():
        np.testing.assert_allclose(answer.tracks[name].position, in_common.position, atol=1e-8)


def test_written_residuals_are_what_the_written_tracks_leave_of_the_ranges(recording: Recording, written: Path) -> None:
    answer = read_answer(written, recording)
    rows = np.flatnonzero(answer.registration.ranges.usable)
    ends = answer.ends(rows)
    predicted = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    residual = recording.ranges.distance[rows] - predicted
    # Frames are the mean over minima that are all but the same, residuals those of the best one.
    np.testing.assert_allclose(answer.registration.ranges.residual[rows], residual, atol=0.02)


def test_a_device_is_looked_up_by_its_own_clock() -> None:
    answer = answer_of(REFERENCE, placed("bob", common_from_user=YawFrame()))
    ends = replace(answer, clock_offset={"alice": 0.0, "bob": 0.5}).ends(np.array([0, 1, 2]))
    np.testing.assert_allclose(ends[:, 0, 0], [0.0, 1.0, 2.0])
    np.testing.assert_allclose(ends[:, 1, 0], [0.5, 1.5, np.nan])


@pytest.mark.parametrize("file", ["registration.json", "ranges.csv", "phone1.tum", "radio0.tum"])
def test_a_file_that_is_missing_is_named(recording: Recording, folder: Path, file: str) -> None:
    (folder / file).unlink()
    with pytest.raises(InputError, match=rf"{file}: No such file or directory$"):
        plot(recording, folder, "walk")


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("registration.json", ""),
        ("registration.json", "[]"),
        ("registration.json", '{"users": 3}'),
        ("registration.json", "[" * 100_000),
        ("registration.json", '{"users": {"phone0": {}, "phone1": {}, "phone2": {}, "radio0": {}}}'),
        ("ranges.csv", ""),
        ("ranges.csv", "t,a,b,range\n1,phone0,phone1,2\n"),
        ("ranges.csv", "t,a,b,range,residual,weight,verdict\n1,phone0\n"),
        ("ranges.csv", "t,a,b,range,residual,weight,verdict\n1,phone0,phone1,2,much,1,used\n"),
        ("ranges.csv", "t,a,b,range,residual,weight,verdict\n1,phone0,phone1,2,,1,used\n"),
        ("ranges.csv", '"'),
        ("phone1.tum", ""),
    ],
)
def test_a_file_that_is_broken_is_named(recording: Recording, folder: Path, file: str, text: str) -> None:
    (folder / file).write_text(text)
    with pytest.raises(InputError, match=rf"{file}: (is no|has no)"):
        plot(recording, folder, "walk")


@pytest.mark.parametrize(
    ("user", "key", "value"),
    [
        ("phone1", "state", "lost"),
        ("phone1", "x", None),
        ("phone1", "y", "here"),
        ("phone1", "yaw", float("nan")),
        ("phone1", "covariance", [[1.0, 2.0]]),
        ("phone1", "clock_offset", None),
        ("radio0", "covariance", None),
    ],
)
def test_a_registration_with_nonsense_in_it_is_told(
    recording: Recording, folder: Path, user: str, key: str, value: object
) -> None:
    file = folder / "registration.json"
    said = json.loads(file.read_text())
    said["users"][user][key] = value
    file.write_text(json.dumps(said))
    with pytest.raises(InputError, match=r"registration\.json: is no registration$"):
        plot(recording, folder, "walk")


def test_an_answer_to_another_recording_is_told(recording: Recording, folder: Path) -> None:
    fewer = replace(recording, ranges=recording.ranges.select(np.arange(5)))
    with pytest.raises(InputError, match=r"ranges\.csv: is about another recording: it has \d+ ranges, .* 5$"):
        plot(fewer, folder, "walk")
    others = simulate(Scene(users=2, seconds=2.0)).recording
    with pytest.raises(InputError, match=r"registration\.json: is about another recording"):
        plot(others, folder, "walk")


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
    file = plot(recording, folder, "walk")
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


def test_the_other_placements_of_an_ambiguous_user_are_drawn() -> None:
    alternatives = (
        Alternative(0.0, {"alice": YawFrame(), "bob": YawFrame(3.0, 1.0, 0.0, np.pi / 2.0)}),
        Alternative(0.5, {"alice": YawFrame(), "bob": YawFrame(3.0, -1.0, 0.0, -np.pi / 2.0)}),
    )
    answer = answer_of(REFERENCE, placed("bob", State.AMBIGUOUS), alternatives=alternatives)
    dashed = [line for line in draw(answer, "walk").axes[0].lines if line.get_linestyle() == "--"]
    assert len(dashed) == 1
    np.testing.assert_allclose(np.asarray(dashed[0].get_xydata(), dtype=float), [[3, -1], [3, -2], [3, -3]], atol=1e-12)


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
    report.write(register(recording), recording, tmp_path)
    assert plot(recording, tmp_path, "walk").exists()
