"""Surveys and tracks in a map's axes (5.4 million metres north) while people walk."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest
from support.surveyed import CORNERS, among, errors

import synchronizar as sz
from synchronizar.data.recording import Recording
from synchronizar.data.registration import State
from synchronizar.estimation.incremental.replay import in_time
from synchronizar.geometry import YawFrame
from synchronizar.simulation.simulate import Scene, simulate

FAR = YawFrame(405000.25, 5412345.5, 312.0)
ORIGIN = (FAR.x, FAR.y, FAR.z)
WALK = Scene(users=2, seconds=14.0, seed=6, rate_hz=5.0)


def on_a_map(recording: Recording) -> Recording:
    """The same, all tracks in a map's axes."""
    tracks = {
        name: replace(own, position=FAR @ own.position, quat_xyzw=FAR.rotate_quaternions(own.quat_xyzw))
        for name, own in recording.tracks.items()
    }
    return replace(recording, tracks=tracks)


def walked(recording: Recording) -> sz.Estimator:
    """All of a recording fed to an estimator, ten updates a second."""
    names = [user.name for user in recording.users]
    settings = {user.name: {k: v for k, v in asdict(user).items() if k != "name"} for user in recording.users}
    estimator, r, tick = sz.Estimator(settings, workers=0), recording.ranges, 0
    for t, user, row in in_time(recording):
        if user < 0:
            estimator.add_range(t, names[r.a[row]], names[r.b[row]], float(r.distance[row]))
        else:
            track = recording.tracks[names[user]]
            estimator.add_pose(names[user], t, track.position[row], track.quat_xyzw[row])
        if t >= tick / 10:
            estimator.advance(t)
            tick = int(t * 10) + 1
    estimator.complete(t)
    return estimator


def test_tracks_in_a_maps_axes_are_placed_as_near_their_zero() -> None:
    recording = simulate(WALK).recording
    near, far = (walked(one).registration() for one in (recording, on_a_map(recording)))
    for name, track in recording.tracks.items():
        here, there = near.users[name].common_from_user, far.users[name].common_from_user
        assert far.users[name].state is near.users[name].state is State.REGISTERED
        assert here is not None
        assert there is not None
        moved = there @ (FAR @ track.position) - np.array(ORIGIN)
        np.testing.assert_allclose(moved, here @ track.position, atol=0.05)


@pytest.mark.parametrize("origin", [(0.0, 0.0, 0.0), ORIGIN])
def test_people_among_surveyed_radios_are_in_the_surveys_frame_wherever_it_lies(
    origin: tuple[float, float, float],
) -> None:
    simulation = among(WALK, CORNERS, origin=origin)
    registration = walked(simulation.recording).registration()
    assert registration.reference == "survey"
    assert {user.state for user in registration.users.values()} == {State.REGISTERED}
    for in_plane, height, turn in errors(simulation, registration).values():
        assert in_plane < 0.2
        assert height < 0.3
        assert turn < 0.1
