from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from synchronizar.data.findings import Code, Finding
from synchronizar.data.recording import Recording
from synchronizar.data.registration import Registration
from synchronizar.errors import InputError
from synchronizar.estimation.register import register
from synchronizar.io.registration_folder import registration_json, write_registration
from synchronizar.io.registration_reader import read_registration
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate


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


@pytest.fixture
def folder(written: Path, tmp_path: Path) -> Path:
    """A copy of the answer, to be spoilt."""
    return Path(shutil.copytree(written, tmp_path / "answer"))


def test_a_written_answer_reads_back_the_same(registration: Registration, recording: Recording, written: Path) -> None:
    read, tracks = read_registration(written, recording)
    assert registration_json(read) == registration_json(registration)
    for name in ("usable", "used", "weight", "residual"):
        np.testing.assert_array_equal(getattr(read.ranges, name), getattr(registration.ranges, name))
    for name, in_common in registration.tracks(recording).items():
        np.testing.assert_allclose(tracks[name].position, in_common.position, atol=1e-8)


@pytest.mark.parametrize("file", ["ranges.csv", "phone1.tum", "radio0.tum"])
def test_a_file_that_is_missing_is_named(recording: Recording, folder: Path, file: str) -> None:
    (folder / file).unlink()
    with pytest.raises(InputError, match=rf"{file}: No such file or directory$"):
        read_registration(folder, recording)


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
        read_registration(folder, recording)


@pytest.mark.parametrize(
    ("user", "key", "value"),
    [
        ("phone1", "state", "lost"),
        ("phone1", "x", None),
        ("phone1", "y", "here"),
        ("phone1", "yaw", float("nan")),
        ("phone1", "covariance", [[1.0, 2.0]]),
        ("phone1", "clock_offset", None),
        ("phone1", "clock_offset", float("inf")),
        ("phone1", "scale", 0.0),
        ("phone1", "range_bias", None),
        ("phone1", "sigma", {"scale": 0.1}),
        ("phone1", "sigma", [0.1, 0.1, 0.1]),
        ("phone1", "slam_noise", {"place": 1.0}),
        ("phone1", "slam_noise", [1.0, 1.0]),
        ("phone1", "jumps", None),
        ("phone1", "jumps", [{"t": 1.0}]),
        ("phone1", "jumps", [{"t": 1e9, "distance": 0.5, "turn": 0.1, "tilt": 0.0}]),
        ("radio0", "jumps", [{"t": 0.0, "distance": 0.5, "turn": 0.1, "tilt": 0.0}]),
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
        read_registration(folder, recording)


def test_an_answer_to_another_recording_is_told(recording: Recording, folder: Path) -> None:
    fewer = replace(recording, ranges=recording.ranges.select(np.arange(5)))
    with pytest.raises(InputError, match=r"ranges\.csv: is about another recording: it has \d+ ranges, .* 5$"):
        read_registration(folder, fewer)
    others = simulate(Scene(users=2, seconds=2.0)).recording
    with pytest.raises(InputError, match=r"registration\.json: is about another recording"):
        read_registration(folder, others)


def test_a_written_correction_reads_back_the_same(tmp_path: Path) -> None:
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
    drifting = simulate(scene).recording
    corrected = register(drifting, model="full")
    write_registration(corrected, drifting, tmp_path)
    read, tracks = read_registration(tmp_path, drifting)
    assert registration_json(read) == registration_json(corrected)
    assert {name: user.jumps for name, user in read.users.items()} == {
        name: user.jumps for name, user in corrected.users.items()
    }
    assert any(user.jumps for user in corrected.users.values())
    for name, track in corrected.tracks(drifting).items():
        np.testing.assert_allclose(tracks[name].position, track.position, atol=1e-8)


@pytest.mark.parametrize("user", ["phone1", "radio0"])
def test_a_track_with_other_stamps_is_told(recording: Recording, folder: Path, user: str) -> None:
    file = folder / f"{user}.tum"
    stamp, rest = file.read_text().split(" ", 1)
    file.write_text(f"{float(stamp) - 1.0} {rest}")
    with pytest.raises(InputError, match=rf"{user}\.tum: is about another recording: its stamps are not those"):
        read_registration(folder, recording)


def test_findings_and_a_reference_that_is_not_there_read_back_the_same(
    registration: Registration, recording: Recording, tmp_path: Path
) -> None:
    findings = (
        Finding(Code.HEIGHT, "phone1", "its origin would have to lie 1.2 m lower", "set height_sigma"),
        Finding(Code.REPEATED_RANGES, None, "7 ranges are there twice", "remove them"),
    )
    write_registration(replace(registration, findings=findings, reference=None), recording, tmp_path)
    read, _ = read_registration(tmp_path, recording)
    assert read.findings == findings
    assert read.reference is None


def test_frames_of_y_up_tracks_read_back_in_their_own_axes(tmp_path: Path) -> None:
    y_up = simulate(Scene(seconds=4.0, static_radios=1, up="y")).recording
    registration = register(y_up, model="rigid")
    write_registration(registration, y_up, tmp_path)
    read, tracks = read_registration(tmp_path, y_up)
    assert registration_json(read) == registration_json(registration)
    for name, in_common in registration.tracks(y_up).items():
        np.testing.assert_allclose(tracks[name].position, in_common.position, atol=1e-8)
