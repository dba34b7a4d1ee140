from __future__ import annotations

from itertools import product

import gtsam
import pytest

from synchronizar.graph import keys


@pytest.mark.parametrize("key", [keys.slot_pose, keys.slot_height, keys.slot_calibration])
def test_slots_before_the_first_one_have_keys_like_all_others(key) -> None:
    made = [key(user, slot) for slot, user in product((-3, -1, 0, 1, 7), (0, 1, 5))]
    assert made == sorted(set(made))
    assert {gtsam.symbolChr(one) for one in made} == {gtsam.symbolChr(key(0, 0))}
