"""What both models make of real recordings: those in a folder beside the repository, where there is one."""

from __future__ import annotations

import json
from functools import cache
from typing import Literal

import numpy as np
import pytest
from support.paths import SHARED

from synchronizar.data.recording import Recording
from synchronizar.data.registration import Registration, State
from synchronizar.estimation.register import register
from synchronizar.io.registration_folder import range_counts, registration_json
from synchronizar.io.tum import read_tum
from synchronizar.reporting.evaluate import Evaluation, evaluate

FOLDER = SHARED / "recordings"
NAMES = ("cmu_scott", "miluv_hist", "tiers5_cora", "tiers_case4_k7", "vub_exp2", "vub_exp4")

pytestmark = pytest.mark.skipif(not FOLDER.is_dir(), reason=f"{FOLDER} with the real recordings is not there")


def registered(name: str, kind: Literal["full", "rigid"] = "full") -> tuple[Recording, Registration]:
    return _registered(name, kind)  # a cache keeps what is given by default apart


@cache
def _registered(name: str, kind: Literal["full", "rigid"]) -> tuple[Recording, Registration]:
    recording = Recording.load(FOLDER / name)
    return recording, register(recording, model=kind)


def evaluated(name: str, kind: Literal["full", "rigid"] = "full") -> Evaluation:
    recording, registration = registered(name, kind)
    truth = {file.stem: read_tum(file) for file in sorted((FOLDER / name / "truth").glob("*.tum"))}
    return evaluate(registration.tracks(recording), truth, registration.reference)


@pytest.mark.parametrize("kind", ["full", "rigid"])
@pytest.mark.parametrize("name", NAMES)
def test_every_recording_registers_and_its_answer_is_nothing_but_numbers(
    name: str, kind: Literal["full", "rigid"]
) -> None:
    recording, registration = registered(name, kind)
    written = registration_json(registration)
    json.dumps(written, allow_nan=False)
    assert list(written["users"]) == [user.name for user in recording.users]
    assert sum(range_counts(registration.ranges).values()) == len(recording.ranges)
    for track in registration.tracks(recording).values():
        assert np.isfinite(track.position).all()


@pytest.mark.parametrize("kind", ["full", "rigid"])
def test_where_slam_can_be_trusted_everybody_is_in_place(kind: Literal["full", "rigid"]) -> None:
    evaluation = evaluated("tiers5_cora", kind)
    assert evaluation.joint_ate_xy is not None
    assert evaluation.joint_ate_xy <= {"full": 0.036, "rigid": 0.045}[kind]
    assert evaluation.missing == ()


@pytest.mark.parametrize(("name", "bound"), [("vub_exp2", 0.2), ("vub_exp4", 0.18)])
def test_wrong_scales_drift_and_jumps_are_taken_out(name: str, bound: float) -> None:
    of_other = evaluated(name).transfer_xy["tb3"]
    assert of_other is not None
    assert of_other <= bound
    for user in registered(name)[1].users.values():
        assert user.common_from_user is not None
        assert 0.80 < user.common_from_user.scale < 0.92


def test_radios_that_add_length_are_told_from_late_signals() -> None:
    error = evaluated("tiers_case4_k7").joint_ate_xy
    assert error is not None
    assert error <= 0.1
    bias = {name: user.range_bias for name, user in registered("tiers_case4_k7")[1].users.items()}
    assert max(bias, key=lambda name: bias[name]) == "r4"
    assert 0.3 < bias["r4"] < 0.7


@pytest.mark.parametrize(("name", "bound"), [("miluv_hist", 0.1), ("cmu_scott", 0.4)])
def test_flying_and_walking_devices_are_in_place_in_space(name: str, bound: float) -> None:
    error = evaluated(name).joint_ate
    assert error is not None
    assert error <= bound


def test_ranges_of_millions_of_metres_are_set_aside() -> None:
    recording, registration = registered("cmu_scott")
    garbage = np.abs(recording.ranges.distance) > 1e6
    assert garbage.sum() == 7
    np.testing.assert_array_equal(registration.ranges.usable, ~garbage)
    assert range_counts(registration.ranges)["unusable"] == 7


@pytest.mark.parametrize("name", ["vub_exp2", "vub_exp4"])
def test_where_slam_s_scale_is_wrong_the_rigid_model_calls_nobody_but_the_reference_registered(name: str) -> None:
    _, registration = registered(name, "rigid")
    for user in registration.users.values():
        assert (user.state is State.REGISTERED) == (user.name == registration.reference)
