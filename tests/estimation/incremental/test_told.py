from __future__ import annotations

import numpy as np

from synchronizar.data.registration import State
from synchronizar.estimation.incremental.replay import replay
from synchronizar.simulation.scene import Scene
from synchronizar.simulation.simulate import simulate


def test_the_reference_has_its_own_frame_before_anybody_is_followed_beside_it() -> None:
    told = replay(simulate(Scene(users=2, seconds=5.0, seed=2)).recording).registration
    assert told.users["phone1"].state is not State.REGISTERED
    reference = told.users["phone0"]
    assert reference.state is State.REGISTERED
    assert reference.common_from_user is not None
    np.testing.assert_array_equal(reference.common_from_user.matrix, np.eye(4))
