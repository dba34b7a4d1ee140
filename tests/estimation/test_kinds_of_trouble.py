"""Kinds of trouble: what is wrong is told, and nobody is registered far from the truth."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from support.mistakes import Y_UP, of_tracks, turned

import synchronizar as sz
from synchronizar.data.findings import Code
from synchronizar.data.recording import Recording
from synchronizar.data.registration import State
from synchronizar.data.track import Track
from synchronizar.geometry import YawFrame
from synchronizar.simulation.simulate import Scene, simulate

Model = Literal["full", "rigid"]
BOTH: tuple[Model, ...] = ("full", "rigid")
WALK = simulate(Scene(users=3, seconds=15.0, seed=5))
FAR = YawFrame(405000.25, 5412345.5, 312.0)


def exchanged(recording: Recording, one: str, other: str) -> Recording:
    """The same, two users' names exchanged in the ranges."""
    u, v, ranges = recording.index(one), recording.index(other), recording.ranges
    now = np.arange(len(recording.users), dtype=np.int32)
    now[[u, v]] = v, u
    return replace(recording, ranges=replace(ranges, a=now[ranges.a], b=now[ranges.b]))


def on_a_map(recording: Recording, *names: str) -> Recording:
    """The same, the tracks of some in a map's axes."""
    tracks = dict(recording.tracks)
    for name in names:
        own = tracks[name]
        tracks[name] = replace(own, position=FAR @ own.position, quat_xyzw=FAR.rotate_quaternions(own.quat_xyzw))
    return replace(recording, tracks=tracks)


def test_who_carries_anothers_radio_is_not_registered() -> None:
    found = sz.register(exchanged(WALK.recording, "phone1", "phone2"))
    assert Code.SWAPPED_RADIOS in {finding.code for finding in found.findings}
    assert found.users["phone0"].state is State.REGISTERED
    for name in ("phone1", "phone2"):
        assert found.users[name].state is not State.REGISTERED
        assert "each other's radio" in found.users[name].reason


def test_where_the_reference_carries_anothers_radio_nobody_is_registered() -> None:
    found = sz.register(exchanged(WALK.recording, "phone0", "phone2"))
    assert State.REGISTERED not in {user.state for user in found.users.values()}
    assert "each other's radio" in found.users["phone0"].reason


def test_a_reference_whose_track_is_another_walks_is_not_registered() -> None:
    """The two others fit each other."""
    other = simulate(replace(WALK.scene, seed=77)).recording.tracks["phone0"]
    mine = WALK.recording.tracks["phone0"]
    n = min(len(other), len(mine))
    wrong = replace(other, t=mine.t[:n], position=other.position[:n], quat_xyzw=other.quat_xyzw[:n])
    found = sz.register(replace(WALK.recording, tracks={**WALK.recording.tracks, "phone0": wrong}))
    assert State.REGISTERED not in {user.state for user in found.users.values()}
    assert "ranges" in found.users["phone0"].reason


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_a_track_that_has_nothing_to_do_with_the_ranges_registers_nobody(seed: int) -> None:
    walk = simulate(Scene(users=2, seconds=40.0, seed=seed)).recording
    other = simulate(Scene(users=2, seconds=40.0, seed=seed + 1000)).recording.tracks["phone1"]
    mine = walk.tracks["phone1"]
    n = min(len(other), len(mine))
    wrong = replace(other, t=mine.t[:n], position=other.position[:n], quat_xyzw=other.quat_xyzw[:n])
    found = sz.register(replace(walk, tracks={**walk.tracks, "phone1": wrong}))
    assert found.users["phone1"].state is not State.REGISTERED


@pytest.mark.parametrize("model", BOTH)
@pytest.mark.parametrize(
    ("mistake", "code"),
    [
        (lambda track: replace(track, position=1000.0 * track.position), Code.TRACK_UNIT),
        (lambda track: turned(track, Y_UP), Code.UP_AXIS),
    ],
    ids=["millimetres", "y up"],
)
def test_a_reference_whose_lengths_or_axes_are_wrong_is_not_registered_where_nobody_is(
    mistake: Callable[[Track], Track], code: Code, model: Model
) -> None:
    found = sz.register(of_tracks(mistake, ("phone0",))(WALK.recording), model=model)
    assert [(f.code, f.user) for f in found.findings] == [(code, "phone0")]
    assert State.REGISTERED not in {user.state for user in found.users.values()}
    assert found.users["phone0"].reason.startswith(found.findings[0].message)


def test_a_reference_stays_registered_where_anothers_lengths_are_wrong() -> None:
    found = sz.register(of_tracks(lambda t: replace(t, position=1000.0 * t.position), ("phone1",))(WALK.recording))
    assert found.users["phone0"].state is State.REGISTERED


def test_who_carries_anothers_radio_does_not_lead_the_others_astray() -> None:
    four = simulate(Scene(users=4, seconds=20.0, seed=5)).recording
    r, without = four.ranges, [four.index(name) for name in ("phone1", "phone2")]
    left = replace(four, ranges=r.select(~np.isin(r.a, without) & ~np.isin(r.b, without)))
    found, expected = sz.register(exchanged(four, "phone1", "phone2")), sz.register(left)
    assert found.users["phone3"].state is State.REGISTERED
    assert found.users["phone3"].common_from_user == expected.users["phone3"].common_from_user


@pytest.mark.parametrize("names", [("phone0", "phone1", "phone2"), ("phone1",), ("phone0",)])
@pytest.mark.parametrize("model", BOTH)
def test_tracks_in_a_maps_axes_give_the_same_answer(names: tuple[str, ...], model: Model) -> None:
    """5.4 million metres north and 312 m up: where everybody is in the common frame is the same to a millimetre."""
    near = sz.register(WALK.recording, model=model).tracks(WALK.recording)
    recording = on_a_map(WALK.recording, *names)
    found = sz.register(recording, model=model)
    shift = np.array([FAR.x, FAR.y, FAR.z]) if "phone0" in names else np.zeros(3)
    for name, track in found.tracks(recording).items():
        assert found.users[name].state is State.REGISTERED
        np.testing.assert_allclose(track.position - shift, near[name].position, atol=0.02)
