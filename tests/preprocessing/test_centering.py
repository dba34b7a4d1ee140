from __future__ import annotations

from dataclasses import replace

import numpy as np
from support.solver_scenes import register_rigid as register

from synchronizar.data.recording import Recording
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate


def test_a_walk_fifty_kilometres_from_its_own_origin_is_registered_as_well_as_at_it() -> None:
    recording = simulate(Scene(users=3, seed=4)).recording
    here = register(recording)
    away = np.array([5e4, -2e4, 0.0])
    tracks = {
        name: track if name == "phone0" else replace(track, position=track.position + away)
        for name, track in recording.tracks.items()
    }
    there = register(Recording(recording.users, tracks, recording.ranges))
    for name, user in here.users.items():
        assert there.users[name].state is user.state
        points = recording.tracks[name].position
        shift = 0.0 if name == "phone0" else away
        near, far = user.common_from_user, there.users[name].common_from_user
        assert near is not None
        assert far is not None
        np.testing.assert_allclose(far @ (points + shift), near @ points, atol=2e-3)


def test_the_covariance_of_a_walk_far_from_its_origin_has_place_and_heading_tied() -> None:
    recording = simulate(Scene(users=2, seed=4)).recording
    away = np.array([1000.0, 0.0, 0.0])
    track = recording.tracks["phone1"]
    tracks = {**recording.tracks, "phone1": replace(track, position=track.position + away)}
    user = register(Recording(recording.users, tracks, recording.ranges)).users["phone1"]
    assert user.covariance is not None
    assert user.common_from_user is not None
    yaw_sigma = np.sqrt(user.covariance[3, 3])
    # The origin swings about the walk, a kilometre away.
    across = np.array([-np.sin(user.common_from_user.yaw), np.cos(user.common_from_user.yaw)])
    swing = np.sqrt(across @ user.covariance[:2, :2] @ across)
    np.testing.assert_allclose(swing, 1000.0 * yaw_sigma, rtol=0.01)
