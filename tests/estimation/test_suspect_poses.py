"""Poses that cannot be where they say are set aside: an answer is that of the recording without them."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from support.paths import SHARED

from synchronizar.data.recording import Recording
from synchronizar.data.registration import Registration, State
from synchronizar.data.track import Track
from synchronizar.estimation.register import register
from synchronizar.io.registration_folder import write_registration
from synchronizar.io.tum import read_tum

CASES = SHARED / "cases"

with_cases = pytest.mark.skipif(not CASES.is_dir(), reason=f"{CASES} is not there")


def mended(track: Track) -> Track:
    """Without lines that are stamped an hour from the middle one, or that repeat the line before but for its stamp."""
    keep = np.abs(track.t - np.median(track.t)) < 3600.0
    keep[1:] &= np.diff(track.position, axis=0).any(axis=1) | np.diff(track.quat_xyzw, axis=0).any(axis=1)
    return Track(track.t[keep], track.position[keep], track.quat_xyzw[keep])


def assert_same(one: Registration, other: Registration) -> None:
    for name, user in one.users.items():
        expected = other.users[name]
        assert (user.state, user.reason) == (expected.state, expected.reason)
        assert user.common_from_user == expected.common_from_user
        np.testing.assert_array_equal(user.covariance, expected.covariance)
    np.testing.assert_array_equal(one.ranges.used, other.ranges.used)
    np.testing.assert_array_equal(one.ranges.weight, other.ranges.weight)


@with_cases
@pytest.mark.parametrize(
    ("case", "model"),
    [("future_one", "full"), ("future_one", "rigid"), ("zero_first", "full"), ("frozen", "rigid")],
)
def test_set_aside_poses_are_as_if_they_were_not_there(
    case: str, model: Literal["full", "rigid"], tmp_path: Path
) -> None:
    recording = Recording.load(CASES / case)
    without = replace(recording, tracks={name: mended(track) for name, track in recording.tracks.items()})
    registration, expected = register(recording, model=model), register(without, model=model)
    assert_same(registration, expected)
    assert {finding.code for finding in registration.findings} - {finding.code for finding in expected.findings} == {
        "frozen-poses" if case == "frozen" else "stray-stamp"
    }
    write_registration(registration, recording, tmp_path)
    for name, track in expected.tracks(without).items():
        lines = (tmp_path / f"{name}.tum").read_text().splitlines()
        assert len(lines) == len(track) == len(without.tracks[name])
        got = registration.tracks(recording)[name]
        np.testing.assert_array_equal(got.t, track.t)
        np.testing.assert_array_equal(got.position, track.position)
    assert any(len(without.tracks[name]) < len(track) for name, track in recording.tracks.items())


@with_cases
@pytest.mark.parametrize("case", ["future_one", "zero_first", "frozen"])
def test_who_had_such_poses_is_registered_all_the_same(case: str) -> None:
    registration = register(Recording.load(CASES / case))
    for name, user in registration.users.items():
        assert user.state is State.REGISTERED, (name, user.reason)
    tracks = {name: user.common_track for name, user in registration.users.items()}
    true = {name: read_tum(CASES / case / "truth" / f"{name}.tum") for name in tracks}
    for one, other in combinations(sorted(tracks), 2):
        apart = []
        for places in (tracks, true):
            first, second = places[one], places[other]
            assert first is not None
            assert second is not None
            there = second.at(true[one].t, 0.2)
            here = first.at(true[one].t, 0.2)
            both = here.valid & there.valid
            apart.append(np.where(both, np.linalg.norm(here.position - there.position, axis=1), np.nan))
        assert np.isfinite(apart[0]).mean() > 0.4
        assert np.nanmax(np.abs(apart[0] - apart[1])) < 0.4
