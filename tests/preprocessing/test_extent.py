from __future__ import annotations

import numpy as np

from synchronizar.data.ranges import Ranges
from synchronizar.data.recording import Recording
from synchronizar.data.track import Track
from synchronizar.data.user import User
from synchronizar.preprocessing.extent import EXTENT_POINTS, extent_points


def test_the_extent_of_the_last_seconds_knows_nothing_of_what_was_before() -> None:
    """A walk of 10 m along x at 1 m/s: all of it spans 10 m, its last 3 s the last 3 m."""
    t = np.arange(0.0, 10.01, 0.1)
    position = np.column_stack([t, np.zeros((len(t), 2))])
    nobody = np.zeros(0, dtype=np.int32)
    none = Ranges.of(np.zeros(0), nobody, nobody, np.zeros(0))
    track = Track(t, position, np.tile([0.0, 0.0, 0.0, 1.0], (len(t), 1)))
    recording = Recording((User("a"), User("b", static=True)), {"a": track}, none)
    whole, last = extent_points(recording), extent_points(recording, 3.0)
    assert whole.shape == last.shape == (2, EXTENT_POINTS, 3)
    np.testing.assert_allclose([whole[0, :, 0].min(), whole[0, :, 0].max()], [0.0, 10.0], atol=1e-9)
    np.testing.assert_allclose([last[0, :, 0].min(), last[0, :, 0].max()], [7.0, 10.0], atol=1e-9)
    assert not last[1].any()
