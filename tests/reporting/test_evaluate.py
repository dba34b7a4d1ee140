from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from support.paths import SHARED

from synchronizar.arrays import Array
from synchronizar.data.track import Track
from synchronizar.errors import InputError
from synchronizar.geometry import YawFrame
from synchronizar.io.tum import read_tum, write_tum
from synchronizar.reporting.evaluate import evaluate, evaluate_folder, evaluation_json

RECORDINGS = SHARED / "recordings"

frames = st.builds(
    YawFrame,
    x=st.floats(-20.0, 20.0),
    y=st.floats(-20.0, 20.0),
    z=st.floats(-3.0, 3.0),
    yaw=st.floats(-np.pi, np.pi),
)


def track(t: Array, position: Array) -> Track:
    return Track(t, position, np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1)))


def standing(*place: float) -> Track:
    return track(np.zeros(1), np.array([place]))


def random_walks(seed: int, lengths: Mapping[str, int]) -> dict[str, Track]:
    rng = np.random.default_rng(seed)
    return {
        name: track(
            0.1 * np.arange(n, dtype=float), rng.normal(0.0, 3.0, 3) + np.cumsum(rng.normal(0.0, 0.1, (n, 3)), axis=0)
        )
        for name, n in lengths.items()
    }


def moved(tracks: Mapping[str, Track], frame: YawFrame) -> dict[str, Track]:
    return {name: replace(one, position=frame @ one.position) for name, one in tracks.items()}


def noisy(tracks: Mapping[str, Track], sigma: float) -> dict[str, Track]:
    rng = np.random.default_rng(99)
    return {n: replace(one, position=one.position + rng.normal(0.0, sigma, (len(one), 3))) for n, one in tracks.items()}


def brute_force_ate(pairs: list[tuple[Array, Array]]) -> tuple[float, float]:
    """The least mean over users of squared errors, over all yaws tried one by one; the mean offset is best for each."""

    def cost(yaw: float) -> tuple[float, float]:
        turn = np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
        offsets = [true - estimated @ turn.T for estimated, true in pairs]
        mean = np.mean([o.mean(axis=0) for o in offsets], axis=0)
        squares = np.mean([((o - mean) ** 2).mean(axis=0) for o in offsets], axis=0)
        return float(squares.sum()), float(squares[:2].sum())

    centre, width = 0.0, np.pi
    for _ in range(12):
        tried = centre + np.linspace(-width, width, 41)
        centre = float(tried[np.argmin([cost(yaw)[0] for yaw in tried])])
        width /= 10.0
    return float(np.sqrt(cost(centre)[0])), float(np.sqrt(cost(centre)[1]))


@settings(max_examples=30, deadline=None)
@given(frame=frames, seed=st.integers(0, 1000))
def test_a_perfect_estimate_in_any_frame_has_no_error(frame: YawFrame, seed: int) -> None:
    truth = random_walks(seed, {"alice": 40, "bob": 70})
    e = evaluate(moved(truth, frame), truth, "alice")
    assert e.joint_ate == pytest.approx(0.0, abs=1e-9)
    assert e.reference_ate == pytest.approx(0.0, abs=1e-9)
    assert e.transfer["bob"] == pytest.approx(0.0, abs=1e-7)
    assert e.yaw["bob"] == pytest.approx(0.0, abs=1e-9)
    assert e.missing == ()


@settings(max_examples=50, deadline=None)
@given(frame=frames, seed=st.integers(0, 1000))
def test_the_frame_of_the_estimates_does_not_matter(frame: YawFrame, seed: int) -> None:
    truth = random_walks(seed, {"alice": 40, "bob": 70, "carol": 20})
    estimated = noisy(truth, 0.3)
    here, there = evaluate(estimated, truth, "alice"), evaluate(moved(estimated, frame), truth, "alice")
    assert there.joint_ate == pytest.approx(here.joint_ate, rel=1e-6)
    assert there.joint_ate_xy == pytest.approx(here.joint_ate_xy, rel=1e-6)
    assert there.transfer == pytest.approx(here.transfer, rel=1e-6)
    assert there.yaw == pytest.approx(here.yaw, abs=1e-6)


@pytest.mark.parametrize("seed", range(5))
def test_the_joint_alignment_is_the_best_of_all_yaws_with_every_user_weighing_the_same(seed: int) -> None:
    truth = random_walks(seed, {"alice": 300, "bob": 10, "carol": 50})
    estimated = moved(noisy(truth, 0.5), YawFrame(1.0, 2.0, 3.0, 2.5))
    e = evaluate(estimated, truth, "alice")
    pairs = [(estimated[name].position, truth[name].position) for name in truth]
    assert (e.joint_ate, e.joint_ate_xy) == pytest.approx(brute_force_ate(pairs), rel=1e-9)
    assert (e.reference_ate, e.reference_ate_xy) == pytest.approx(brute_force_ate(pairs[:1]), rel=1e-9)


def test_transfer_is_what_a_misplaced_user_is_off_in_the_references_frame() -> None:
    square = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 2.0, 0.0], [0.0, 2.0, 0.0]])
    truth = {name: track(np.arange(4.0), square + offset) for name, offset in (("alice", 0.0), ("bob", 5.0))}
    estimated = {**truth, "bob": replace(truth["bob"], position=truth["bob"].position + np.array([0.3, 0.0, 0.4]))}
    e = evaluate(moved(estimated, YawFrame(7.0, -3.0, 1.0, 3.0)), truth, "alice")
    assert e.reference_ate == pytest.approx(0.0, abs=1e-12)
    assert e.transfer == {"bob": pytest.approx(0.5)}
    assert e.transfer_xy == {"bob": pytest.approx(0.3)}
    assert e.yaw["bob"] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("off", [0.3, -0.3, 3.0, -3.0])
@pytest.mark.parametrize("common_yaw", [0.0, 3.1, -3.1])
def test_yaw_is_how_far_a_user_must_still_turn_and_wraps(off: float, common_yaw: float) -> None:
    truth = random_walks(3, {"alice": 50, "bob": 60})
    estimated = {**truth, **moved({"bob": truth["bob"]}, YawFrame(yaw=-off))}
    e = evaluate(moved(estimated, YawFrame(yaw=common_yaw)), truth, "alice")
    assert e.yaw["bob"] == pytest.approx(off)


def test_the_order_of_the_users_does_not_matter() -> None:
    truth = random_walks(5, {"alice": 40, "bob": 70, "carol": 20})
    estimated = noisy(truth, 0.2)
    backwards = evaluate(dict(reversed(estimated.items())), dict(reversed(truth.items())), "bob")
    assert evaluation_json(backwards) == evaluation_json(evaluate(estimated, truth, "bob"))


def test_the_truth_is_interpolated_at_the_estimates_stamps_and_nowhere_else() -> None:
    truth = {
        "alice": track(np.array([0.0, 0.2, 0.4, 2.0]), np.array([[0.0, 0, 0], [0.2, 0, 0], [0.4, 0, 0], [2.0, 0, 0]]))
    }
    t = np.array([-1.0, 0.1, 0.3, 1.0, 2.5])
    wild = np.array([[50.0, 9, 9], [0.1, 0, 0], [0.3, 0, 0], [70.0, 8, 8], [90.0, 7, 7]])
    e = evaluate({"alice": track(t, wild)}, truth, "alice")
    assert e.reference_ate == pytest.approx(0.0, abs=1e-12)


def test_a_static_radio_holds_at_all_times_and_has_no_yaw() -> None:
    truth = random_walks(8, {"alice": 40}) | {"radio": standing(1.0, 2.0, 3.0)}
    estimated = truth | {"radio": standing(1.3, 2.4, 3.0)}
    e = evaluate(estimated, truth, "alice")
    assert e.transfer["radio"] == pytest.approx(0.5)
    assert e.yaw["radio"] is None
    still = track(np.arange(100.0, 104.0), np.tile([1.0, 2.0, 3.0], (4, 1)))
    assert evaluate(estimated, truth | {"radio": still}, "alice").transfer["radio"] == pytest.approx(0.5)


def test_users_without_an_estimate_or_common_times_are_missing() -> None:
    truth = random_walks(8, {"alice": 40, "bob": 40, "carol": 40})
    later = replace(truth["carol"], t=truth["carol"].t + 1000.0)
    e = evaluate({"alice": truth["alice"], "carol": later, "dave": later}, truth, "alice")
    assert e.missing == ("bob", "carol")
    assert e.transfer == {}
    assert e.joint_ate == pytest.approx(0.0, abs=1e-12)


def test_without_the_reference_there_is_only_the_joint_error() -> None:
    truth = random_walks(8, {"alice": 40, "bob": 40})
    e = evaluate({"bob": truth["bob"]}, truth, "alice")
    assert e.joint_ate == pytest.approx(0.0, abs=1e-12)
    assert e.reference_ate is None
    assert e.transfer == {"bob": None}
    assert e.yaw == {"bob": None}
    assert e.missing == ("alice",)


def test_a_reference_that_stands_still_cannot_carry_the_others() -> None:
    truth = random_walks(8, {"bob": 40}) | {"alice": standing(0.0, 0.0, 0.0)}
    e = evaluate(truth, truth, "alice")
    assert e.reference_ate == pytest.approx(0.0, abs=1e-12)
    assert e.transfer == {"bob": None}


def test_nothing_to_compare_is_null_and_no_exception() -> None:
    e = evaluation_json(evaluate({}, random_walks(8, {"alice": 40}), "alice"))
    assert json.loads(json.dumps(e)) == {
        "joint_ate": None,
        "joint_ate_xy": None,
        "reference_ate": None,
        "reference_ate_xy": None,
        "transfer": {},
        "transfer_xy": {},
        "yaw": {},
        "missing": ["alice"],
    }


def written(folder: Path, tracks: Mapping[str, Track]) -> Path:
    folder.mkdir(parents=True)
    for name, one in tracks.items():
        write_tum(folder / f"{name}.tum", one)
    return folder


def test_a_folder_is_judged_by_the_reference_its_registration_names_else_by_the_first_that_moved(
    tmp_path: Path,
) -> None:
    truth = random_walks(8, {"bob": 40, "carol": 40}) | {"alice": standing(0.0, 0.0, 0.0)}
    written(tmp_path / "recording" / "truth", truth)
    out = written(tmp_path / "out", truth)
    assert evaluate_folder(tmp_path / "recording", out).reference == "bob"
    (out / "registration.json").write_text('{"reference": null}')
    assert evaluate_folder(tmp_path / "recording", out).reference == "bob"
    (out / "registration.json").write_text('{"reference": "carol"}')
    e = evaluate_folder(tmp_path / "recording", out)
    assert e.reference == "carol"
    assert set(e.transfer) == {"alice", "bob"}
    assert e.joint_ate == pytest.approx(0.0, abs=1e-5)


@pytest.mark.parametrize("content", ["", "{", "[]", '{"users": {}}'])
def test_a_registration_that_cannot_be_read_is_told(tmp_path: Path, content: str) -> None:
    truth = random_walks(8, {"alice": 5})
    written(tmp_path / "recording" / "truth", truth)
    out = written(tmp_path / "out", truth)
    (out / "registration.json").write_text(content)
    with pytest.raises(InputError, match=r"registration\.json: "):
        evaluate_folder(tmp_path / "recording", out)


def test_a_recording_without_truth_and_a_folder_that_is_not_there_are_told(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="truth: "):
        evaluate_folder(tmp_path, tmp_path)
    (tmp_path / "truth").mkdir()
    with pytest.raises(InputError, match="truth: holds no truth"):
        evaluate_folder(tmp_path, tmp_path)
    write_tum(tmp_path / "truth" / "alice.tum", standing(0.0, 0.0, 0.0))
    with pytest.raises(InputError, match="nowhere: "):
        evaluate_folder(tmp_path, tmp_path / "nowhere")


@pytest.mark.skipif(not RECORDINGS.exists(), reason="the real recordings are not here")
@pytest.mark.parametrize("name", ["vub_exp4", "tiers_case4_k7", "miluv_hist", "tiers5_cora"])
def test_real_truth_against_itself_is_perfect_and_raw_tracks_are_not(name: str) -> None:
    recording = RECORDINGS / name
    perfect = evaluate_folder(recording, recording / "truth")
    assert perfect.joint_ate == pytest.approx(0.0, abs=1e-9)
    assert max(v for v in perfect.transfer.values() if v is not None) < 1e-6
    raw = evaluate_folder(recording, recording / "tracks")
    assert raw.reference_ate is not None
    assert raw.joint_ate is not None
    assert raw.joint_ate > 2.0 * raw.reference_ate
    assert set(raw.transfer) | set(raw.missing) | {raw.reference} == {p.stem for p in (recording / "truth").glob("*")}
    assert read_tum(recording / "truth" / f"{raw.reference}.tum", "z").extent() > 0.5


def test_truth_at_one_hertz_is_compared_at_its_own_stamps() -> None:
    """Estimates at 10 Hz, truth once a second between their stamps: 0.2 m north of a straight way is 0.2 m off."""
    t = 0.1 * np.arange(101)
    x = 1.3 * t
    sparse = 0.03 + np.arange(10.0)
    estimated = {"a": track(t, np.column_stack([x, 0.0 * x, 0.0 * x])), "b": track(t, np.column_stack([x, x, 0.0 * x]))}
    truth = {
        "a": track(sparse, np.column_stack([1.3 * sparse, 0.0 * sparse, 0.0 * sparse])),
        "b": track(sparse, np.column_stack([1.3 * sparse, 1.3 * sparse + 0.2, 0.0 * sparse])),
    }
    found = evaluate(estimated, truth, "a")
    assert found.missing == ()
    assert found.reference_ate == pytest.approx(0.0, abs=1e-9)
    assert found.transfer["b"] == pytest.approx(0.2)
