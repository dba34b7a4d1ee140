from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from synchronizar.arrays import Array
from synchronizar.cli import main
from synchronizar.data.ranges import Ranges
from synchronizar.data.ranging_rate import papers_rate_hz
from synchronizar.data.recording import Recording
from synchronizar.data.registration import State
from synchronizar.data.track import Track
from synchronizar.data.user import User
from synchronizar.errors import InputError
from synchronizar.estimation.pairwise import solve as pairwise_solve
from synchronizar.estimation.pairwise.register import pair_samples, register_pairwise
from synchronizar.estimation.pairwise.solve import LARGEST_HEIGHT, solve_reduced
from synchronizar.geometry import YawFrame, wrap_angle
from synchronizar.parameters import Parameters
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import Simulation, simulate

pytest.importorskip("scipy", reason="the pairwise method needs scipy")
optimize = pytest.importorskip("scipy.optimize")


def two_boxes(random: np.random.Generator, frame: YawFrame, n: int = 60) -> tuple[Array, Array]:
    """Places of two users who walk level, each about a middle of its own 5 m apart, in their own frames."""
    x = np.column_stack([random.uniform(-1.0, 1.0, (n, 2)), np.full(n, 1.3)])
    y_in_x = np.column_stack([random.uniform(-1.0, 1.0, (n, 2)) + np.array([3.0, 4.0]), np.full(n, 1.5)])
    return x, frame.inverse() @ y_in_x


def true_frame(simulation: Simulation, to: str, of: str) -> YawFrame:
    return simulation.world_from_user[to].inverse() @ simulation.world_from_user[of]


# ---- two devices ----


@settings(max_examples=30, deadline=None)
@given(
    st.integers(0, 2**31),
    st.floats(-np.pi, np.pi),
    st.floats(-10.0, 10.0),
    st.floats(-10.0, 10.0),
    st.floats(-LARGEST_HEIGHT, LARGEST_HEIGHT),
)
def test_of_exact_distances_between_level_walks_the_frame_is_exact(
    seed: int, yaw: float, x: float, y: float, z: float
) -> None:
    frame = YawFrame(x, y, z, yaw)
    p_x, p_y = two_boxes(np.random.default_rng(seed), frame)
    found = solve_reduced(p_x, p_y, np.linalg.norm(p_x - frame @ p_y, axis=1))
    assert found.cost < 1e-6
    assert np.hypot(found.x_from_y.x - x, found.x_from_y.y - y) < 0.02
    assert abs(wrap_angle(found.x_from_y.yaw - yaw)) < 0.005


@pytest.mark.parametrize("seed", range(8))
def test_no_other_solver_finds_a_lower_cost(seed: int) -> None:
    """Trust-region least squares from 64 starts all about, the bound on the height as a bound."""
    random = np.random.default_rng(seed)
    p_x, p_y = two_boxes(random, YawFrame(2.0, -3.0, 0.05, 1.0), 40)
    distance = np.linalg.norm(p_x - YawFrame(2.0, -3.0, 0.05, 1.0) @ p_y, axis=1) + 0.1 * random.standard_normal(40)
    weight = random.uniform(0.2, 1.0, 40)
    rise = p_x[:, 2].mean() - p_y[:, 2].mean()

    def errors(parameters: Array) -> Array:
        c, s = np.cos(parameters[0]), np.sin(parameters[0])
        away = p_x[:, :2] - p_y[:, :2] @ np.array([[c, s], [-s, c]]) - parameters[1:3]
        length = np.sqrt((away**2).sum(axis=1) + (rise - parameters[3]) ** 2)
        return np.asarray(np.sqrt(weight / weight.sum()) * (length - distance))

    bounds = [[-np.inf] * 3 + [-LARGEST_HEIGHT], [np.inf] * 3 + [LARGEST_HEIGHT]]
    starts = [[random.uniform(-4.0, 4.0), *random.uniform(-8.0, 8.0, 2), 0.0] for _ in range(64)]
    best = min(2.0 * optimize.least_squares(errors, start, bounds=bounds).cost for start in starts)
    found = solve_reduced(p_x, p_y, distance, weight)
    assert found.cost == pytest.approx(best, rel=1e-4)
    assert (errors(np.array([found.x_from_y.yaw, *found.x_from_y.translation])) ** 2).sum() == pytest.approx(found.cost)


def test_heights_count_by_their_averages_alone() -> None:
    random = np.random.default_rng(3)
    frame = YawFrame(1.0, 2.0, 0.0, 0.4)
    p_x, p_y = two_boxes(random, frame)
    distance = np.linalg.norm(p_x - frame @ p_y, axis=1)
    bobs = random.normal(0.0, 0.3, len(p_x))
    bobbing = p_x + np.column_stack([np.zeros((len(p_x), 2)), bobs - bobs.mean()])
    assert solve_reduced(bobbing, p_y, distance).x_from_y == pytest.approx(solve_reduced(p_x, p_y, distance).x_from_y)


def test_origins_differ_in_height_by_no_more_than_the_paper_allows() -> None:
    frame = YawFrame(1.0, 2.0, 0.8, 0.4)
    p_x, p_y = two_boxes(np.random.default_rng(4), frame)
    found = solve_reduced(p_x, p_y + np.array([0.0, 0.0, 0.8]), np.linalg.norm(p_x - frame @ p_y, axis=1) + 1.0)
    assert abs(found.x_from_y.z) == pytest.approx(LARGEST_HEIGHT, abs=1e-6)


def test_a_sample_that_weighs_nothing_says_nothing() -> None:
    frame = YawFrame(1.0, 2.0, 0.0, 0.4)
    p_x, p_y = two_boxes(np.random.default_rng(5), frame)
    distance = np.linalg.norm(p_x - frame @ p_y, axis=1)
    weight = np.ones(len(distance))
    distance[7], weight[7] = 30.0, 0.0
    found = solve_reduced(p_x, p_y, distance, weight)
    assert np.hypot(found.x_from_y.x - 1.0, found.x_from_y.y - 2.0) < 0.02


def test_fewer_samples_than_unknowns_are_refused() -> None:
    with pytest.raises(ValueError, match="3 samples, where 4"):
        solve_reduced(np.zeros((3, 3)), np.zeros((3, 3)), np.ones(3))


def test_without_scipy_it_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pairwise_solve, "find_spec", lambda _: None)
    with pytest.raises(InputError, match=r"pip install 'synchronizar\[pairwise\]'"):
        solve_reduced(np.zeros((4, 3)), np.zeros((4, 3)), np.ones(4))


# ---- samples, as the paper's modules take them ----


def test_modules_range_at_the_papers_rates() -> None:
    assert papers_rate_hz(1) == pytest.approx(9.9, abs=0.05)
    assert papers_rate_hz(2) == pytest.approx(8.2, abs=0.05)


def test_the_newest_range_is_paired_with_the_average_of_the_newest_positions() -> None:
    """Two users tick every 0.101 s: of the ranges at 0.11 and 0.19 the later counts, with poses of (0.089, 0.19]."""
    t = np.arange(0.0, 0.5, 0.02)
    identity = np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1))
    moving = Track(t, np.column_stack([t, np.zeros((len(t), 2))]), identity)
    ranges = Ranges.of(
        t=np.array([0.11, 0.19, 0.25, 0.9]),
        a=np.array([0, 0, 1, 0], dtype=np.int32),
        b=np.array([1, 1, 0, 1], dtype=np.int32),
        distance=np.array([1.0, 2.0, 3.0, 4.0]),
    )
    recording = Recording((User("a"), User("b")), {"a": moving, "b": moving}, ranges)
    samples = pair_samples(recording, Parameters())[0, 1]
    assert samples.row.tolist() == [1, 2]  # at 0.9 nobody was anywhere
    assert samples.distance.tolist() == [2.0, 3.0]
    np.testing.assert_allclose(
        samples.p_i[:, 0], [np.mean([0.1, 0.12, 0.14, 0.16, 0.18]), np.mean([0.16, 0.18, 0.2, 0.22, 0.24])]
    )


def test_the_lever_of_the_antenna_that_measured_is_added() -> None:
    """A device that turns on the spot by a quarter turn a second, its antenna 0.3 m ahead."""
    t = np.arange(0.0, 4.0, 0.02)
    yaw = 0.5 * np.pi * t
    zero = np.zeros(len(t))
    turning = Track(t, np.zeros((len(t), 3)), np.column_stack([zero, zero, np.sin(0.5 * yaw), np.cos(0.5 * yaw)]))
    when = np.array([1.0, 2.0, 3.0])
    ends = np.zeros(3, dtype=np.int32), np.ones(3, dtype=np.int32)
    ranges = Ranges.of(when, *ends, np.ones(3), antenna_a=np.zeros(3, dtype=np.int32))
    users = User("a", antennas={"0": (0.3, 0.0, 0.0)}), User("b")
    samples = pair_samples(Recording(users, {"a": turning, "b": turning}, ranges), Parameters())[0, 1]
    np.testing.assert_allclose(samples.p_i, [[0.0, 0.3, 0.0], [-0.3, 0.0, 0.0], [0.0, -0.3, 0.0]], atol=1e-6)
    np.testing.assert_allclose(samples.p_j, 0.0)


# ---- many ----


@pytest.mark.parametrize("links", ["all", "star", "chain"])
def test_many_are_registered_one_by_one_and_composed(links: str) -> None:
    simulation = simulate(Scene(users=4, seconds=40.0, sigma=0.02, links=links, height_bob=0.0, height_spread=0.03))
    registration = register_pairwise(simulation.recording)
    assert (registration.method, registration.model, registration.alternatives) == ("pairwise", "rigid", ())
    for name in ("phone1", "phone2", "phone3"):
        assert registration.users[name].state is State.REGISTERED
        assert registration.users[name].covariance is None
        found, true = registration.between("phone0", name), true_frame(simulation, "phone0", name)
        assert np.hypot(found.x - true.x, found.y - true.y) < 0.15
        assert abs(wrap_angle(found.yaw - true.yaw)) < 0.05
    if links == "chain":
        assert "registered with phone2" in registration.users["phone3"].reason
    ranges = registration.ranges
    assert ranges.used.any()
    assert not (ranges.used & ~ranges.usable).any()
    assert np.abs(ranges.residual[ranges.used]).mean() < 0.2


def test_who_ranges_to_nobody_is_disconnected_and_a_radio_has_a_place() -> None:
    simulation = simulate(Scene(users=2, static_radios=2, seconds=30.0, sigma=0.02))
    recording = simulation.recording
    heard = (recording.ranges.a != 3) & (recording.ranges.b != 3)
    registration = register_pairwise(replace(recording, ranges=recording.ranges.select(heard)))
    states = {name: user.state for name, user in registration.users.items()}
    assert states["radio1"] is State.DISCONNECTED
    assert states["radio0"] is State.REGISTERED


# ---- the command ----


def test_the_command_tells_which_method_it_was_and_its_answer_is_drawn(tmp_path: Path) -> None:
    walk, out = tmp_path / "walk", tmp_path / "out"
    simulate(Scene(users=3)).save(walk)
    assert main(["register", str(walk), "--method", "pairwise", "--out", str(out)]) == 0
    said = json.loads((out / "registration.json").read_text())
    assert (said["method"], said["model"]) == ("pairwise", "rigid")
    assert [said["users"][name]["covariance"] for name in ("phone0", "phone1", "phone2")] == [None] * 3
    assert main(["evaluate", str(walk), str(out), "--json"]) == 0
    assert main(["plot", str(walk), str(out)]) == 0


def test_the_pairwise_method_has_no_full_model(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["register", str(tmp_path), "--method", "pairwise", "--model", "full"]) == 2
    assert capsys.readouterr().err == "synchronizar: --model: the pairwise method trusts SLAM: it has no full model\n"
