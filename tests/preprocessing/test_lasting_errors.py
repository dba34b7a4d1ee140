from __future__ import annotations

import numpy as np

from synchronizar.parameters import Parameters
from synchronizar.preprocessing.lasting_errors import lasting_errors
from synchronizar.preprocessing.range_measurements import RangeMeasurements

MODEL = Parameters().changed(ranges={"multipath_slot": 1.0, "multipath_duration": 3.0})


def measurements_of(pairs: list[tuple[int, int, float]]) -> RangeMeasurements:
    """Ranges (i, j, t), sorted."""
    n = len(pairs)
    i, j = (np.array([pair[end] for pair in pairs], dtype=np.int32) for end in (0, 1))
    none = np.zeros((n, 3))
    t = np.array([pair[2] for pair in pairs])
    return RangeMeasurements(i, j, t, none, none, np.ones(n), np.ones(n), np.ones(n), np.arange(n, dtype=np.int32))


def test_a_pair_has_one_error_a_slot_which_follows_the_one_before() -> None:
    found = lasting_errors(
        measurements_of([(0, 1, 0.1), (0, 1, 0.9), (0, 1, 1.1), (0, 1, 3.5), (0, 2, 0.2), (0, 2, 1.2)]), MODEL
    )
    assert found.of_range.tolist() == [0, 0, 1, 2, 3, 4]
    assert found.follows.tolist() == [-1, 0, 1, -1, 3]
    assert found.first_range.tolist() == [0, 2, 3, 4, 5]
    np.testing.assert_allclose(found.decay, [0.0, np.exp(-1 / 3), np.exp(-2 / 3), 0.0, np.exp(-1 / 3)])


def test_after_a_long_gap_it_is_another_error() -> None:
    found = lasting_errors(measurements_of([(0, 1, 0.5), (0, 1, 3.5), (0, 1, 7.5)]), MODEL)
    assert found.follows.tolist() == [-1, 0, -1]


def test_where_there_is_no_range_there_is_no_error() -> None:
    assert len(lasting_errors(measurements_of([]), MODEL)) == 0
