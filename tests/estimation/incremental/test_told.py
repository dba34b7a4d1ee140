from __future__ import annotations

from dataclasses import replace

import numpy as np
from support.relocalised import relocalised

from synchronizar.data.registration import State
from synchronizar.estimation.incremental.replay import replay
from synchronizar.quaternions import yaw_quaternion
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate


def test_the_reference_has_its_own_frame_before_anybody_is_followed_beside_it() -> None:
    told = replay(simulate(Scene(users=2, seconds=5.0, seed=2)).recording).registration
    assert told.users["phone1"].state is not State.REGISTERED
    reference = told.users["phone0"]
    assert reference.state is State.REGISTERED
    assert reference.common_from_user is not None
    np.testing.assert_array_equal(reference.common_from_user.matrix, np.eye(4))


def test_a_reference_that_nobody_is_followed_beside_stays_where_it_was_when_its_slam_jumps() -> None:
    recording = simulate(Scene(users=2, seconds=5.0, seed=2)).recording
    honest = recording.tracks["phone0"]
    jumped = relocalised(honest, len(honest) // 2, (2.0, -1.0, 0.3), yaw_quaternion(0.5))
    told = replay(replace(recording, tracks=recording.tracks | {"phone0": jumped})).registration
    reference = told.users["phone0"]
    assert told.users["phone1"].state is not State.REGISTERED
    assert reference.common_from_user is not None
    last = (reference.common_from_user @ jumped.position[-5:])[:, :2]
    assert np.abs(last - honest.position[-5:, :2]).max() < 0.2
    assert np.abs(jumped.position[-5:, :2] - honest.position[-5:, :2]).max() > 1.0
