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
from matplotlib.colors import to_hex
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from synchronizar.arrays import Array
from synchronizar.cli import main
from synchronizar.data.ranges import Ranges
from synchronizar.data.recording import Recording
from synchronizar.data.registration import RangeVerdicts, Registration, State, UserRegistration
from synchronizar.data.track import Track
from synchronizar.data.updates import Replay, Update, UserUpdate
from synchronizar.data.user import User
from synchronizar.errors import InputError
from synchronizar.estimation.incremental.replay import replay
from synchronizar.estimation.register import register
from synchronizar.geometry import YawFrame
from synchronizar.io.registration_folder import write_registration, write_replay
from synchronizar.reporting.answer import Answer
from synchronizar.reporting.history import History, UserHistory, history_of
from synchronizar.reporting.plots import draw_timeline, plot
from synchronizar.reporting.plots.style import short, styles
from synchronizar.reporting.plots.timeline import BAR, MOST_EVENTS, MOST_USERS, STATE_COLOURS
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import Simulation, simulate

REGISTERED, UNOBSERVABLE, DISCONNECTED = State.REGISTERED, State.UNOBSERVABLE, State.DISCONNECTED
UPRIGHT = np.array([0.0, 0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def simulation() -> Simulation:
    return simulate(Scene(seconds=4.0, static_radios=1, seed=2))


@pytest.fixture(scope="module")
def replayed(simulation: Simulation) -> Replay:
    return replay(simulation.recording)


@pytest.fixture
def folder(simulation: Simulation, replayed: Replay, tmp_path: Path) -> Path:
    """What a replay wrote, to be spoilt."""
    write_replay(replayed, simulation.recording, tmp_path / "answer")
    return tmp_path / "answer"


def pair() -> Recording:
    """Alice walks from (2, 0) of her own frame to (2, 1) in the 10 s from 100 s on; the radio stands still."""
    alice = Track(np.array([100.0, 110.0]), np.array([[2.0, 0.0, 0.0], [2.0, 1.0, 0.0]]), np.tile(UPRIGHT, (2, 1)))
    one = np.zeros(2, dtype=np.int32)
    ranges = Ranges.of(np.array([101.0, 112.0]), one, one + 1, np.ones(2))
    return Recording((User("alice"), User("radio", static=True)), {"alice": alice}, ranges)


def known(**of_user: Any) -> UserUpdate:
    """A user that is registered at the common frame's origin, and of whose sureness nothing is known."""
    here: dict[str, Any] = {"common_from_user": YawFrame(), "covariance": None, "static": False, "cue": None}
    return UserUpdate(**({"state": REGISTERED, "progress": 1.0} | here | of_user))


def update(t: float, alice: UserUpdate, radio: UserUpdate | None = None) -> Update:
    return Update(t, 1e-3, {"alice": alice, "radio": radio or known(static=True)}, [])


# What was known


def test_a_history_has_what_was_known_at_each_update(simulation: Simulation, replayed: Replay) -> None:
    history = history_of(replayed.updates, simulation.recording)
    began = simulation.recording.ranges.t.min()
    np.testing.assert_allclose(history.t, [update.t - began for update in replayed.updates])
    assert history.events == [(update.t - began, event) for update in replayed.updates for event in update.events]
    assert list(history.users) == ["phone0", "phone1", "radio0"]
    for name, user in history.users.items():
        assert user.states == [update.users[name].state for update in replayed.updates]
        assert user.cues == [update.users[name].cue for update in replayed.updates]
        np.testing.assert_array_equal(user.progress, [update.users[name].progress for update in replayed.updates])
    assert np.isfinite(history.users["phone1"].sigma_yaw).any()
    assert np.isnan(history.users["radio0"].sigma_yaw).all()


def sigma_by_differences(frame: YawFrame, own: Array, covariance: Array) -> float:
    """1 sigma the longest way in the plane, of where a place (3,) of the user's own lies."""
    step = 1e-6
    moved = [
        (replace(frame, **{key: getattr(frame, key) + step}) @ own - frame @ own)[:2] / step
        for key in ("x", "y", "z", "yaw")
    ]
    jacobian = np.array(moved).T
    return float(np.sqrt(np.linalg.eigvalsh(jacobian @ covariance @ jacobian.T).max()))


@given(
    frame=st.builds(YawFrame, *[st.floats(-10.0, 10.0)] * 3, st.floats(-3.0, 3.0), st.floats(0.5, 2.0)),
    roots=st.lists(st.floats(-1.0, 1.0), min_size=16, max_size=16),
)
def test_a_place_is_as_sure_as_its_frame_says_it_is(frame: YawFrame, roots: list[float]) -> None:
    root = np.reshape(roots, (4, 4))
    covariance = root @ root.T + 1e-3 * np.eye(4)
    of_alice = known(common_from_user=frame, covariance=covariance)
    alice = history_of([update(t, of_alice) for t in (99.0, 105.0, 115.0)], pair()).users["alice"]
    first, last = np.array([2.0, 0.0, 0.0]), np.array([2.0, 1.0, 0.0])
    expected = [sigma_by_differences(frame, own, covariance) for own in (first, first, last)]
    np.testing.assert_allclose(alice.sigma_xy, expected, rtol=1e-4)
    np.testing.assert_allclose(alice.sigma_yaw, np.sqrt(covariance[3, 3]))


def test_a_static_radio_is_as_sure_as_its_place() -> None:
    covariance = np.full((4, 4), np.nan)
    covariance[:3, :3] = np.diag([4.0, 9.0, 1.0])
    one = update(102.0, known(), known(static=True, covariance=covariance))
    radio = history_of([one], pair()).users["radio"]
    np.testing.assert_allclose(radio.sigma_xy, [3.0])
    assert np.isnan(radio.sigma_yaw).all()


def test_who_has_no_place_has_no_sureness() -> None:
    nowhere = known(state=DISCONNECTED, common_from_user=None, progress=0.0)
    alice = history_of([update(102.0, nowhere)], pair()).users["alice"]
    assert alice.states == [DISCONNECTED]
    assert np.isnan([*alice.sigma_xy, *alice.sigma_yaw]).all()


# The files


def test_the_page_of_a_replay_is_written_and_nothing_else_is_touched(simulation: Simulation, folder: Path) -> None:
    before = {file.name: file.read_bytes() for file in folder.iterdir()}
    (page,) = plot(simulation.recording, folder, "walk")
    assert page == folder / "replay.png"
    assert page.read_bytes().startswith(b"\x89PNG\r\n")
    assert before == {file.name: file.read_bytes() for file in folder.iterdir() if file != page}


def test_pages_of_an_earlier_answer_go(simulation: Simulation, folder: Path) -> None:
    (folder / "picture.png").write_text("earlier")
    (folder / "devices.png").write_text("earlier")
    plot(simulation.recording, folder, "walk")
    assert [file.name for file in folder.glob("*.png")] == ["replay.png"]
    (folder / "updates.jsonl").unlink()
    write_registration(register(simulation.recording, model="rigid"), simulation.recording, folder)
    assert plot(simulation.recording, folder, "walk") == [folder / "picture.png"]
    assert [file.name for file in folder.glob("*.png")] == ["picture.png"]


def test_a_page_that_cannot_be_written_is_told(simulation: Simulation, folder: Path) -> None:
    (folder / "replay.png").mkdir()
    with pytest.raises(InputError, match=r"replay\.png: Is a directory$"):
        plot(simulation.recording, folder, "walk")


def test_a_replay_is_drawn_by_the_command_without_the_truth(
    simulation: Simulation, folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    simulation.save(tmp_path / "walk")
    shutil.rmtree(tmp_path / "walk/truth")
    assert main(["plot", str(tmp_path / "walk"), str(folder)]) == 0
    assert capsys.readouterr() == (f"{folder / 'replay.png'}\n", "")
    (folder / "updates.jsonl").write_text("{}\n")
    assert main(["plot", str(tmp_path / "walk"), str(folder)]) == 2
    assert capsys.readouterr() == ("", f"synchronizar: {folder / 'updates.jsonl'}:1: is no update of a replay\n")


# The page


def user_of(states: list[State], static: bool = False, **of_user: Any) -> UserHistory:
    n = len(states)
    known: dict[str, Any] = {
        "cues": [None] * n,
        "progress": np.linspace(0.0, 1.0, n),
        "sigma_xy": np.full(n, 0.1),
        "sigma_yaw": np.full(n, np.nan if static else 0.1),
    }
    return UserHistory(static, states, **(known | of_user))


def history_with(*events: tuple[float, str], **users: UserHistory) -> History:
    n = max((len(user.states) for user in users.values()), default=0)
    return History(np.arange(1.0, n + 1.0), list(events), users)


def bars(ax: Axes) -> list[tuple[int, float, float, str]]:
    """Row, begin, end and colour."""
    return [
        (
            round(bar.get_y() + BAR / 2.0),
            bar.get_x(),
            bar.get_x() + bar.get_width(),
            to_hex(bar.get_facecolor()).upper(),
        )
        for bar in ax.patches
        if isinstance(bar, Rectangle)
    ]


def marks(ax: Axes, marker: str) -> list[tuple[float, float]]:
    return [tuple(xy) for of in ax.lines if of.get_marker() == marker for xy in np.asarray(of.get_xydata()).tolist()]


def texts(figure: Figure) -> set[str]:
    return {text.get_text() for ax in figure.axes for text in ax.texts} | {ax.get_title() for ax in figure.axes}


def test_a_state_holds_until_another_is_told() -> None:
    bob = user_of([DISCONNECTED, UNOBSERVABLE, UNOBSERVABLE, REGISTERED, UNOBSERVABLE])
    ax = draw_timeline(history_with(alice=user_of([REGISTERED] * 5), bob=bob), "walk").axes[0]
    assert bars(ax) == [
        (0, 0.0, 5.0, STATE_COLOURS[REGISTERED]),
        (1, 0.0, 2.0, STATE_COLOURS[DISCONNECTED]),
        (1, 2.0, 4.0, STATE_COLOURS[UNOBSERVABLE]),
        (1, 4.0, 5.0, STATE_COLOURS[REGISTERED]),
        (1, 5.0, 5.0, STATE_COLOURS[UNOBSERVABLE]),
    ]
    assert len(set(STATE_COLOURS.values())) == len(State)
    assert ax.get_xlim() == (0.0, 5.0)


def test_progress_climbs_from_the_lower_edge_of_a_bar_to_its_upper() -> None:
    ax = draw_timeline(history_with(alice=user_of([UNOBSERVABLE] * 3)), "walk").axes[0]
    low, high = ax.transData.transform([(0.0, BAR / 2.0), (0.0, -BAR / 2.0)])[:, 1]
    drawn = ax.transData.transform(np.asarray(ax.lines[0].get_xydata()))[:, 1]
    np.testing.assert_allclose(drawn, [low, (low + high) / 2.0, high])
    assert low < high


def test_events_stand_on_the_bar_of_whom_they_are_about_and_new_cues_below() -> None:
    cues = [None, "walk 1 m back", "walk 1 m back", "walk 2 m to your left", None]
    history = history_with(
        (2.0, "bob: unobservable: stood still"),
        (3.0, "all: something else"),
        alice=user_of([REGISTERED] * 5),
        bob=user_of([UNOBSERVABLE] * 5, cues=cues),
    )
    figure = draw_timeline(history, "walk")
    assert marks(figure.axes[0], "v") == [(2.0, 1.0 - BAR / 2.0)]
    assert marks(figure.axes[0], "|") == [(2.0, 1.0 + BAR / 2.0), (4.0, 1.0 + BAR / 2.0)]
    assert texts(figure) >= {"What was told", "2.0 s", "bob: unobservable: stood still", "all: something else"}


def test_sureness_is_drawn_in_metres_and_degrees_and_thick_while_registered() -> None:
    sigma = np.array([np.nan, 4.0, 0.2])
    bob = user_of([DISCONNECTED, UNOBSERVABLE, REGISTERED], sigma_xy=sigma, sigma_yaw=np.radians(10.0 * sigma))
    _, xy, yaw, _ = draw_timeline(history_with(bob=bob), "walk").axes
    for ax, expected in ((xy, sigma), (yaw, 10.0 * sigma)):
        thin, thick = sorted(ax.lines, key=lambda of: of.get_linewidth())
        np.testing.assert_allclose(np.asarray(thin.get_ydata(), dtype=float), expected)
        np.testing.assert_allclose(np.asarray(thick.get_ydata(), dtype=float), [np.nan, np.nan, expected[2]])
        assert ax.get_yscale() == "log"


def test_everybody_looks_as_on_the_other_pages() -> None:
    users = {f"bob{n:02}": n % 5 == 3 for n in range(25)}
    none = np.zeros(0, dtype=bool)
    registration = Registration(
        "bob00",
        "full",
        "joint",
        {name: UserRegistration(name, DISCONNECTED, "", None, None, static) for name, static in users.items()},
        (),
        RangeVerdicts(none, none, np.zeros(0), np.zeros(0)),
        {},
    )
    elsewhere = styles(Answer(registration, {}, {}, pair().ranges))
    ax = draw_timeline(history_with(**{n: user_of([REGISTERED] * 2, static) for n, static in users.items()}), "").axes[
        1
    ]
    drawn = [(of.get_color(), of.get_linestyle()) for of in ax.lines[::2]]
    assert drawn == [tuple(style) for style in elsewhere.values()]


def test_without_any_range_the_page_says_so(tmp_path: Path) -> None:
    recording = pair()
    recording = replace(recording, ranges=recording.ranges.select(np.zeros(2, dtype=bool)))
    figure = draw_timeline(history_of([], recording), "walk")
    assert "No range came" in texts(figure)
    assert bars(figure.axes[0]) == []
    assert [label.get_text() for label in figure.axes[0].get_yticklabels()] == ["alice", "radio"]
    figure.savefig(tmp_path / "replay.png", dpi=30)


def test_of_very_many_users_and_events_the_first_are_shown() -> None:
    users = {f"bob{n:02}": user_of([REGISTERED] * 2) for n in range(MOST_USERS + 3)}
    events = [(1.0, f"bob{n:02}: registered: at last") for n in range(MOST_EVENTS + 5)]
    figure = draw_timeline(history_with(*events, **users), "walk")
    assert texts(figure) >= {"and 3 more", f"What was told: the first {MOST_EVENTS} of {MOST_EVENTS + 5} events"}
    assert len({row for row, *_ in bars(figure.axes[0])}) == MOST_USERS
    assert len(figure.axes[1].lines) == 2 * (MOST_USERS + 3)
    assert sum(text.get_text().endswith("at last") for text in figure.axes[3].texts) == MOST_EVENTS


@pytest.mark.parametrize("name", ["_hidden", r"$\frac$", "ボブ", "b" * 200, "a&b<c>%s{x}"])
@pytest.mark.parametrize("n", [1, 5])
def test_every_history_has_a_page(name: str, n: int, tmp_path: Path) -> None:
    unknown = user_of([DISCONNECTED] * n, sigma_xy=np.full(n, np.nan), sigma_yaw=np.full(n, np.nan))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        figure = draw_timeline(history_with((1.0, f"{name}: {'much ' * 50}"), **{name: unknown}), name)
        figure.savefig(tmp_path / "replay.png", dpi=30)
    assert [label.get_text() for label in figure.axes[0].get_yticklabels()] == [short(name)]
