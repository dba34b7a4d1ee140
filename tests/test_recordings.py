"""What the rigid model makes of real recordings: those in a folder beside the repository, where there is one."""

from __future__ import annotations

import json
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from synchronizar.evaluate import Evaluation, evaluate
from synchronizar.formats.tum import read_tum
from synchronizar.pipeline import register
from synchronizar.recording import Recording
from synchronizar.registration import Registration, State
from synchronizar.report import range_counts, registration_json

FOLDER = Path(__file__).parents[2] / "shared" / "recordings"
NAMES = ("cmu_scott", "miluv_hist", "tiers5_cora", "tiers_case4_k7", "vub_exp2", "vub_exp4")

pytestmark = pytest.mark.skipif(not FOLDER.is_dir(), reason=f"{FOLDER} with the real recordings is not there")


@cache
def registered(name: str) -> tuple[Recording, Registration]:
    recording = Recording.load(FOLDER / name)
    return recording, register(recording)


def evaluated(name: str) -> Evaluation:
    recording, registration = registered(name)
    truth = {file.stem: read_tum(file) for file in sorted((FOLDER / name / "truth").glob("*.tum"))}
    return evaluate(registration.tracks(recording), truth, registration.reference)


@pytest.mark.parametrize("name", NAMES)
def test_every_recording_registers_and_its_answer_is_nothing_but_numbers(name: str) -> None:
    recording, registration = registered(name)
    written = registration_json(registration)
    json.dumps(written, allow_nan=False)
    assert list(written["users"]) == [user.name for user in recording.users]
    assert sum(range_counts(registration.ranges).values()) == len(recording.ranges)
    for track in registration.tracks(recording).values():
        assert np.isfinite(track.position).all()


def test_where_slam_can_be_trusted_everybody_is_in_place() -> None:
    evaluation = evaluated("tiers5_cora")
    assert evaluation.joint_ate_xy is not None
    assert evaluation.joint_ate_xy <= 0.045
    assert evaluation.missing == ()


def test_ranges_of_millions_of_metres_are_set_aside() -> None:
    recording, registration = registered("cmu_scott")
    garbage = np.abs(recording.ranges.distance) > 1e6
    assert garbage.sum() == 7
    np.testing.assert_array_equal(registration.ranges.usable, ~garbage)
    assert range_counts(registration.ranges)["unusable"] == 7


@pytest.mark.parametrize("name", ["vub_exp2", "vub_exp4"])
def test_where_slam_s_scale_is_wrong_nobody_but_the_reference_is_called_registered(name: str) -> None:
    _, registration = registered(name)
    for user in registration.users.values():
        assert (user.state is State.REGISTERED) == (user.name == registration.reference)
